"""What failed by itself and is kept apart, what was done to recordings by hand, and the mark of the raw store."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.quarantine import QuarantineState, SubjectKind
from fleet_db.models.base import Base, Code, Count, Digest, Name, Nanoseconds, ReasonCodeColumn, Serial, one_of
from fleet_db.receipts import ChunkState, RecordingAction


class QuarantineRow(Base):
    """One thing at which one stage failed; the row stays when it succeeds later."""

    __tablename__ = "quarantine"
    __table_args__ = (
        one_of("kind", SubjectKind),
        one_of("state", QuarantineState),
        CheckConstraint("attempts >= 1", name="tried"),
        Index(None, "stage", "state"),
        Index(None, "state", "last_ns"),
    )

    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    key: Mapped[str] = mapped_column(String(128), primary_key=True)
    stage: Mapped[str] = mapped_column(String(64), primary_key=True)
    code: Mapped[ReasonCodeColumn]
    error: Mapped[Name]
    inputs: Mapped[Name]
    first_ns: Mapped[Nanoseconds]
    last_ns: Mapped[Nanoseconds]
    due_ns: Mapped[Nanoseconds]
    attempts: Mapped[Count]
    state: Mapped[str] = mapped_column(String(16))


class RecordingChangeRow(Base):
    """What was done to a recording by hand."""

    __tablename__ = "recording_changes"
    __table_args__ = (
        one_of("action", RecordingAction),
        one_of("state_before", ChunkState),
        one_of("state_after", ChunkState),
        Index(None, "digest", "id"),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[Serial]
    digest: Mapped[Digest]
    action: Mapped[str] = mapped_column(String(16))
    recorded_ns: Mapped[Nanoseconds]
    actor: Mapped[Name]
    why: Mapped[Name]
    vehicle_before: Mapped[Code]
    state_before: Mapped[str] = mapped_column(String(16))
    vehicle_after: Mapped[Code]
    state_after: Mapped[str] = mapped_column(String(16))


class RawMarkRow(Base):
    """The mark that the folder of raw recordings of this database holds."""

    __tablename__ = "raw_marks"

    mark: Mapped[str] = mapped_column(String(64), primary_key=True)
    recorded_ns: Mapped[Nanoseconds]

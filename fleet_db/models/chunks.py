"""Receipts of recordings."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Json, Name, Nanoseconds, ReasonCodeColumn, one_of
from fleet_db.receipts import ChunkState

UNDECODED = text("reason_code = 'waits_for_decoding'")
OF_UNDECODED = ("recorded_ns", "digest", "size_bytes")
"""What is asked of recordings that wait for a worker is in the index alone, however many others there are."""


class ChunkRow(Base):
    """The receipt of one recording. ``vehicle`` is the sender's: a recording of an unknown one is kept too."""

    __tablename__ = "chunks"
    __table_args__ = (
        one_of("state", ChunkState),
        CheckConstraint("(first_ns IS NULL) = (last_ns IS NULL)", name="both_ends_or_none"),
        CheckConstraint("last_ns >= first_ns", name="ends_after_start"),
        CheckConstraint("size_bytes >= 0", name="size_counted"),
        Index(None, "vehicle", "first_ns"),
        Index(None, "state", "recorded_ns"),
        Index(None, "received_ns", "digest"),
        Index("ix_chunks_undecoded", *OF_UNDECODED, sqlite_where=UNDECODED, postgresql_where=UNDECODED),
    )

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    vehicle: Mapped[str] = mapped_column(String(64))
    suffix: Mapped[str] = mapped_column(String(16))
    size_bytes: Mapped[Count]
    state: Mapped[str] = mapped_column(String(16))
    reason: Mapped[Name]
    reason_code: Mapped[ReasonCodeColumn | None]
    first_ns: Mapped[Nanoseconds | None]
    last_ns: Mapped[Nanoseconds | None]
    frames: Mapped[Count]
    counts: Mapped[Json]
    received_ns: Mapped[Nanoseconds]
    recorded_ns: Mapped[Nanoseconds]
    purged_ns: Mapped[Nanoseconds | None]
    clock_checked_ns: Mapped[Nanoseconds | None]
    file_name: Mapped[Name | None]
    sender: Mapped[Name | None]

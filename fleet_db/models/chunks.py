"""Receipts of recordings."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Json, Name, Nanoseconds, ReasonCodeColumn, one_of
from fleet_db.receipts import ChunkState


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

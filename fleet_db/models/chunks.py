"""Receipts of recordings."""

from __future__ import annotations

from collections.abc import Iterator

from sqlalchemy import CheckConstraint, Index, String, TextClause, text
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Count, Json, Name, Nanoseconds, ReasonCodeColumn, one_of
from fleet_db.receipts import ChunkState

UNDECODED = text("reason_code = 'waits_for_decoding'")
MINUTE_NS, HOUR_NS = 60_000_000_000, 3_600_000_000_000
LENGTHS = (
    ("short", "{last} - {first} <= 60000000000", MINUTE_NS),
    ("middle", "{last} - {first} > 60000000000 AND {last} - {first} <= 3600000000000", HOUR_NS),
    ("long", "{last} - {first} > 3600000000000", None),
)
"""Decoded recordings by their length, each with an index of its own: name, condition, longest of them in ns."""

CLOCKS = (("first_ns", "last_ns"), ("recorder_first_ns", "recorder_last_ns"))
"""Ends of a recording on the clock of the vehicle, and on that of its recorder."""


def of_length(condition: str, clock: tuple[str, str]) -> TextClause:
    """Return the condition of an index of :data:`LENGTHS`; a statement that uses the index has it word for word."""
    first, last = clock
    return text(f"state = 'decoded' AND {condition.format(first=first, last=last)}")


def _by_length() -> Iterator[Index]:
    for clock in CLOCKS:
        for name, condition, _ in LENGTHS:
            where = of_length(condition, clock)
            yield Index(f"ix_chunks_{name}_{clock[0]}", "vehicle", clock[0], sqlite_where=where, postgresql_where=where)


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
        *_by_length(),
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
    recorder_first_ns: Mapped[Nanoseconds | None]
    recorder_last_ns: Mapped[Nanoseconds | None]

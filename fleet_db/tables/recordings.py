"""Chunks of recordings, what was done to them, quarantine, purges, and spans to be assembled again."""

from __future__ import annotations

from collections.abc import Iterator

from sqlalchemy import CheckConstraint, Index, String, TextClause, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.runs import QuarantineState, SubjectKind
from fleet_db.records import ChunkState, RecordingAction
from fleet_db.tables.base import Base, Code, Count, Json, Name, Nanoseconds, Serial, one_of, partial_index

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
            yield partial_index(f"ix_chunks_{name}_{clock[0]}", "vehicle", clock[0], where=where)


OF_UNDECODED = ("recorded_ns", "digest", "size_bytes")
"""What is asked of recordings that wait for a worker is in the index alone, however many others there are."""


class ChunkRow(Base, table="chunks"):
    """The receipt of one recording. ``vehicle`` is the sender's: a recording of an unknown one is kept too."""

    __table_args__ = (
        one_of("state", ChunkState),
        CheckConstraint("(first_ns IS NULL) = (last_ns IS NULL)", name="both_ends_or_none"),
        CheckConstraint("last_ns >= first_ns", name="ends_after_start"),
        CheckConstraint("size_bytes >= 0", name="size_counted"),
        *_by_length(),
        Index(None, "state", "recorded_ns"),
        Index(None, "received_ns", "digest"),
        partial_index("ix_chunks_undecoded", *OF_UNDECODED, where=UNDECODED),
    )

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    vehicle: Mapped[str] = mapped_column(String(64))
    suffix: Mapped[str] = mapped_column(String(16))
    size_bytes: Mapped[Count]
    state: Mapped[str] = mapped_column(String(16))
    reason: Mapped[Name]
    reason_code: Mapped[Code | None]
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


class QuarantineRow(Base, table="quarantine"):
    """One thing at which one stage failed; the row stays when it succeeds later."""

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
    code: Mapped[Code]
    error: Mapped[Name]
    inputs: Mapped[Name]
    first_ns: Mapped[Nanoseconds]
    last_ns: Mapped[Nanoseconds]
    due_ns: Mapped[Nanoseconds]
    attempts: Mapped[Count]
    state: Mapped[str] = mapped_column(String(16))


class RecordingChangeRow(Base, table="recording_changes", numbered=True):
    """What was done to a recording by hand."""

    __table_args__ = (
        one_of("action", RecordingAction),
        one_of("state_before", ChunkState),
        one_of("state_after", ChunkState),
        Index(None, "digest", "id"),
    )

    id: Mapped[Serial]
    digest: Mapped[Code]
    action: Mapped[str] = mapped_column(String(16))
    recorded_ns: Mapped[Nanoseconds]
    actor: Mapped[Name]
    why: Mapped[Name]
    vehicle_before: Mapped[Code]
    state_before: Mapped[str] = mapped_column(String(16))
    vehicle_after: Mapped[Code]
    state_after: Mapped[str] = mapped_column(String(16))


class RawMarkRow(Base, table="raw_marks"):
    """The mark that the folder of raw recordings of this database holds."""

    mark: Mapped[str] = mapped_column(String(64), primary_key=True)
    recorded_ns: Mapped[Nanoseconds]


class RawScrubRow(Base, table="raw_scrubs"):
    """One reading of all raw files in the order of their digests; ``finished_ns`` is None until its end."""

    scrub_id: Mapped[Serial]
    started_ns: Mapped[Nanoseconds]
    finished_ns: Mapped[Nanoseconds | None]
    after_digest: Mapped[str] = mapped_column(String(64))
    files: Mapped[Count]
    file_bytes: Mapped[Count]
    faults: Mapped[Count]


class PurgeRow(Base, table="purges", numbered=True):
    """What one purge deleted of one kind: everything of it from before ``before_ns`` is gone."""

    __table_args__ = (
        CheckConstraint("items >= 0", name="items_counted"),
        Index(None, "kind", "before_ns"),
    )

    purge_id: Mapped[Serial]
    kind: Mapped[str] = mapped_column(String(32))
    before_ns: Mapped[Nanoseconds]
    items: Mapped[Count]
    item_bytes: Mapped[Count]
    purged_ns: Mapped[Nanoseconds]


class StaleSpanRow(Base, table="stale_spans", numbered=True):
    """A span ``[from_ns, to_ns)`` and what made it stale; the row goes in the transaction that stores its windows."""

    __table_args__ = (
        CheckConstraint("to_ns > from_ns", name="ends_after_start"),
        Index(None, "vehicle", "from_ns"),
    )

    id: Mapped[Serial]
    vehicle: Mapped[Code]
    from_ns: Mapped[Nanoseconds]
    to_ns: Mapped[Nanoseconds]
    cause: Mapped[Name]

"""Chunks of recordings, what was done to them, quarantine, purges, and spans to be assembled again."""

from collections.abc import Iterator

from sqlalchemy import CheckConstraint, Index, String, TextClause, text

from estimation.values.runs import Quarantined, SubjectKind
from fleet_db.records import ChunkRecord, RawScrub, RecordingChange
from fleet_db.tables.base import Base, Code, Count, Name, Nanoseconds, Serial, column, one_of, partial_index

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


class ChunkRow(Base, table="chunks", of=ChunkRecord):
    """The receipt of one recording. ``vehicle`` is the sender's: a recording of an unknown one is kept too."""

    constraints = (
        CheckConstraint("(first_ns IS NULL) = (last_ns IS NULL)", name="both_ends_or_none"),
        CheckConstraint("last_ns >= first_ns", name="ends_after_start"),
        CheckConstraint("size_bytes >= 0", name="size_counted"),
        *_by_length(),
        Index(None, "state", "recorded_ns"),
        Index(None, "received_ns", "digest"),
        partial_index("ix_chunks_undecoded", *OF_UNDECODED, where=UNDECODED),
    )

    digest: str = column(String(64), primary_key=True)
    vehicle: str = column(String(64))
    suffix: str = column(String(16))
    recorder_first_ns: Nanoseconds | None
    recorder_last_ns: Nanoseconds | None


class QuarantineRow(Base, table="quarantine", of=Quarantined):
    """One thing at which one stage failed; the row stays when it succeeds later."""

    constraints = (
        one_of("kind", SubjectKind),
        CheckConstraint("attempts >= 1", name="tried"),
        Index(None, "stage", "state"),
        Index(None, "state", "last_ns"),
    )

    kind: str = column(String(16), primary_key=True)
    key: str = column(String(128), primary_key=True)
    stage: str = column(String(64), primary_key=True)
    code: Code


class RecordingChangeRow(Base, table="recording_changes", numbered=True, of=RecordingChange):
    """What was done to a recording by hand."""

    constraints = (Index(None, "digest", "id"),)

    id: Serial
    digest: Code
    vehicle_before: Code
    vehicle_after: Code


class RawMarkRow(Base, table="raw_marks"):
    """The mark that the folder of raw recordings of this database holds."""

    mark: str = column(String(64), primary_key=True)
    recorded_ns: Nanoseconds


class RawScrubRow(Base, table="raw_scrubs", of=RawScrub):
    """One reading of all raw files in the order of their digests; ``finished_ns`` is None until its end."""

    scrub_id: Serial
    after_digest: str = column(String(64))


class PurgeRow(Base, table="purges", numbered=True):
    """What one purge deleted of one kind: everything of it from before ``before_ns`` is gone."""

    constraints = (CheckConstraint("items >= 0", name="items_counted"), Index(None, "kind", "before_ns"))

    purge_id: Serial
    kind: str = column(String(32))
    before_ns: Nanoseconds
    items: Count
    item_bytes: Count
    purged_ns: Nanoseconds


class StaleSpanRow(Base, table="stale_spans", numbered=True):
    """A span ``[from_ns, to_ns)`` and what made it stale; the row goes in the transaction that stores its windows."""

    constraints = (CheckConstraint("to_ns > from_ns", name="ends_after_start"), Index(None, "vehicle", "from_ns"))

    id: Serial
    vehicle: Code
    from_ns: Nanoseconds
    to_ns: Nanoseconds
    cause: Name

"""Rules over times: nothing is entered before it has happened, and nothing is turned before it has run."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.values.registry import Mounting
from estimation.values.utc_text import utc_text
from ingest.registry_entry.contradiction import Contradiction, Kind, RecordName, Rule

AHEAD_NS = 86_400 * 1_000_000_000
"""By which the clock of a vehicle or of a depot may be ahead of ours."""


def in_the_future(record: RecordName, field: str, at_ns: int, now_ns: int) -> list[Contradiction]:
    """Return what is said against a record of something that has not happened yet.

    Args:
        record, field, at_ns: What is entered, the field of its time, and the time, ns UTC.
        now_ns: Our time, ns UTC.
    """
    if at_ns <= now_ns + AHEAD_NS:
        return []
    reason = f"{utc_text(at_ns)} is in the future: our clock shows {utc_text(now_ns - now_ns % 1_000_000_000)}"
    return [Contradiction(Rule.IN_THE_FUTURE, record, field, reason)]


def before_first_mounting(reprofiling: RecordName, mountings: Sequence[Mounting]) -> list[Contradiction]:
    """Return what is said against a visit to the lathe before the wheelset was first mounted.

    It would divide nothing that was measured. Nothing is said of a wheelset that no mounting is known of.

    Args:
        mountings: Of its wheelset, any order.
    """
    at_ns = reprofiling.at_ns
    if not mountings or at_ns is None:
        return []
    first = min(mountings, key=lambda one: one.from_ns)
    if at_ns >= first.from_ns:
        return []
    other = RecordName(Kind.MOUNTING, first.wheelset, first.from_ns)
    reason = f"{utc_text(at_ns)} is before the first {other}, on vehicle {first.vehicle!r}"
    return [Contradiction(Rule.BEFORE_FIRST_MOUNTING, reprofiling, "at", reason, (other,))]


def mounted_after_reprofiling(first: Mounting, reprofiled_ns: Sequence[int]) -> list[Contradiction]:
    """Return what is said against a first mounting that is later than visits to the lathe on file."""
    earlier = [RecordName(Kind.REPROFILING, first.wheelset, at_ns) for at_ns in reprofiled_ns if at_ns < first.from_ns]
    if not earlier:
        return []
    record = RecordName(Kind.MOUNTING, first.wheelset, first.from_ns)
    reason = f"{utc_text(first.from_ns)}: the first mounting is later than the {earlier[0]}"
    return [Contradiction(Rule.BEFORE_FIRST_MOUNTING, record, "from", reason, tuple(earlier))]

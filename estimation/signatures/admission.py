"""Which library entries may be learned from when one wheelset is judged, and why the others may not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.values.reasons import ReasonCode
from estimation.values.signatures import NO_PAIR, AxlePosition, DesignPair, LibraryEntry


@dataclass(frozen=True, slots=True)
class Subject:
    """The wheelset that is judged, and whose samples are in its signatures."""

    wheelset: str
    vehicle_class: str
    position: AxlePosition
    pair: DesignPair = NO_PAIR
    shares_data: frozenset[str] = frozenset()  # the other wheelset of its bogie, where both nodes give the frame's yaw


@dataclass(frozen=True, slots=True)
class Admitted:
    """Entries that may be learned from, and how many may not, by reason."""

    entries: tuple[LibraryEntry, ...]
    left_out: Mapping[ReasonCode, int]


def admitted(entries: Sequence[LibraryEntry], subject: Subject) -> Admitted:
    """Return the entries from which something may be concluded about a wheelset.

    Parameters
    ----------
    entries
        Of a library, those that were retired left out.
    subject
        Who is judged.
    """
    kept, left_out = [], Counter[ReasonCode]()
    mine = subject.shares_data | {subject.wheelset}
    for entry in entries:
        signature = entry.signature
        if (signature.vehicle_class, signature.position) != (subject.vehicle_class, subject.position):
            left_out[ReasonCode.OTHER_VEHICLE_CLASS] += 1
        elif not _alike(entry.pair, subject.pair):
            left_out[ReasonCode.OTHER_PROFILES] += 1
        elif mine & ({entry.wheelset} | set(entry.shares_data)):
            left_out[ReasonCode.SAME_WHEELSET] += 1
        else:
            kept.append(entry)
    return Admitted(tuple(kept), dict(left_out))


def _alike(entry: DesignPair, subject: DesignPair) -> bool:
    """Whether two pairs are of the same design, as far as that of the subject is known."""
    return entry.wheel == subject.wheel and subject.rail in {None, entry.rail}

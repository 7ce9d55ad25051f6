"""Which library entries may be learned from when one wheelset is judged, and why the others may not.

A library for each wheelset would hold nearly the same each time. So wheelsets are judged in folds: all of one fold by
one library, in which nothing of any of them is. While there are few wheelsets each is a fold of its own.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.signatures.families import folds, sharers
from estimation.signatures.library import Library, library
from estimation.signatures.parameters import SignatureParameters
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import NO_PAIR, AxlePosition, DesignPair, LibraryEntry

_Key = tuple[str, AxlePosition, DesignPair]


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


@dataclass(frozen=True, slots=True)
class _Alike:
    """Entries of one class, axle position and pair of profiles, newest where there are too many, with their folds."""

    entries: tuple[LibraryEntry, ...]
    folds: Sequence[frozenset[str]]
    holding: Mapping[str, frozenset[int]]  # by wheelset the entries that its data are in
    left_out: Mapping[ReasonCode, int]


@dataclass(frozen=True, slots=True)
class Libraries:
    """The libraries that some entries make, each made once.

    Attributes:
        entries: Those that were retired left out.
        parameters: What a library must hold.
    """

    entries: Sequence[LibraryEntry]
    parameters: SignatureParameters
    _alike: dict[_Key, _Alike] = field(default_factory=dict)
    _made: dict[tuple[_Key, frozenset[str]], Library | Reason] = field(default_factory=dict)

    def admitted(self, subject: Subject) -> Admitted:
        """Return the entries from which something may be concluded about a wheelset."""
        alike = self._of(subject)
        outside = _outside(alike, subject)
        own = frozenset().union(*(alike.holding.get(name, frozenset()) for name in _names(subject)))
        kept = tuple(
            one for number, one in enumerate(alike.entries) if number not in own and not outside & sharers(one)
        )
        left_out = Counter(alike.left_out)
        left_out[ReasonCode.SAME_WHEELSET] += len(own)
        left_out[ReasonCode.JUDGED_TOGETHER] += len(alike.entries) - len(own) - len(kept)
        return Admitted(kept, {code: count for code, count in left_out.items() if count})

    def library(self, subject: Subject) -> Library | Reason:
        """Return the library that a wheelset is judged by, or why there is none."""
        alike = self._of(subject)
        key = _key(subject), _outside(alike, subject)
        if key not in self._made:
            self._made[key] = library(self.admitted(subject).entries, self.parameters)
        return self._made[key]

    def _of(self, subject: Subject) -> _Alike:
        key = _key(subject)
        if key not in self._alike:
            self._alike[key] = _alike(self.entries, subject, self.parameters.most_entries)
        return self._alike[key]


def _key(subject: Subject) -> _Key:
    return subject.vehicle_class, subject.position, subject.pair


def _names(subject: Subject) -> frozenset[str]:
    return subject.shares_data | {subject.wheelset}


def _outside(alike: _Alike, subject: Subject) -> frozenset[str]:
    """Return the wheelsets that are left out: the fold of the judged one, or more where its data are in several."""
    touched = [fold for fold in alike.folds if fold & _names(subject)]
    return frozenset().union(*touched)


def _alike(entries: Sequence[LibraryEntry], subject: Subject, most: int) -> _Alike:
    kept, left_out = [], Counter[ReasonCode]()
    for entry in entries:
        signature = entry.signature
        if (signature.vehicle_class, signature.position) != (subject.vehicle_class, subject.position):
            left_out[ReasonCode.OTHER_VEHICLE_CLASS] += 1
        elif not _same_design(entry.pair, subject.pair):
            left_out[ReasonCode.OTHER_PROFILES] += 1
        else:
            kept.append(entry)
    chosen = _newest(kept, most)
    left_out[ReasonCode.NEWER_ENTRIES] += len(kept) - len(chosen)
    holding: dict[str, set[int]] = defaultdict(set)
    for number, entry in enumerate(chosen):
        for name in sharers(entry):
            holding[name].add(number)
    numbers = {name: frozenset(found) for name, found in holding.items()}
    return _Alike(tuple(chosen), folds(chosen), numbers, left_out)


def _newest(entries: Sequence[LibraryEntry], most: int) -> Sequence[LibraryEntry]:
    """Return at most so many entries: of every place the newest, as many of each."""
    if len(entries) <= most:
        return entries
    of_place: dict[object, list[LibraryEntry]] = defaultdict(list)
    for entry in sorted(entries, key=lambda one: (-one.signature.start_ns, one.wheelset, one.signature.order)):
        of_place[entry.signature.place].append(entry)
    each = 1
    while sum(min(each + 1, len(found)) for found in of_place.values()) <= most:
        each += 1
    chosen = {id(entry) for found in of_place.values() for entry in found[:each]}
    return [entry for entry in entries if id(entry) in chosen]


def _same_design(entry: DesignPair, subject: DesignPair) -> bool:
    """Whether two pairs are of the same design, as far as that of the subject is known."""
    return entry.wheel == subject.wheel and subject.rail in {None, entry.rail}

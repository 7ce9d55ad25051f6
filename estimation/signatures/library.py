"""A library: entries that may be learned from, the regression over them, and how far its answers were off.

Entries of places whose track has changed since are retired. What the track of a place adds to features is what they
have beyond the response to conicity and speed. Work on the track changes it for all that pass. So of every place each
time between two passes is tried: what came before is compared with what came after, and the largest distance decides.
Passes scatter about the mean of their side of that time: the change itself, which may be of a large part of a small
library, is not in what it is compared with.

A library for each wheelset would hold nearly the same each time. So wheelsets are judged in folds: all of one fold by
one library, in which nothing of any of them is. While there are few wheelsets each is a fold of its own.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.signatures.calibration import Calibration, OnFile, calibrated, differences, judged_by, unjudged
from estimation.signatures.mixed_model import MixedModel, Rows, fitted, levels_between, scatter_of, track_effects
from estimation.signatures.window_signatures import SignatureParameters, folds, sharers
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import NO_PAIR, AxlePosition, Basis, DesignPair, LibraryEntry, Place, Retired


@dataclass(frozen=True, slots=True)
class Library:
    """What may be said of wheelsets of one class and axle position."""

    vehicle_class: str
    position: AxlePosition
    entries: tuple[LibraryEntry, ...]
    places: Mapping[Place, int]  # numbers in the model
    sections: Mapping[str, int]
    model: MixedModel
    conicity: tuple[float, float]  # least and largest
    speed: tuple[float, float]  # m/s
    calibration: Mapping[Basis, Calibration | Reason]
    on_file: OnFile

    @property
    def wheelsets(self) -> int:
        """Number of wheelsets."""
        return len({entry.wheelset for entry in self.entries})

    def levels(self, places: int) -> tuple[float, float]:
        """Return between which levels the mean of some places is where their section is like those of the library."""
        # it may be as far outside as the outermost section is from the next: so far the calibration has gone, too
        section = np.array([self.sections[place.section] for place in sorted(self.places, key=self.places.__getitem__)])
        return levels_between(self.model, section, places)


def library(entries: Sequence[LibraryEntry], parameters: SignatureParameters) -> Library | Reason:
    """Return the library of some entries of one class and axle position, or why they make none."""
    ordered = sorted(
        (entry for entry in entries if entry.signature.place is not None),
        key=lambda entry: (entry.wheelset, entry.signature.start_ns, entry.signature.order, _place(entry)),
    )
    wheelsets = {entry.wheelset: entry for entry in ordered}
    if len(wheelsets) < parameters.least_wheelsets:
        return Reason(
            ReasonCode.LIBRARY_TOO_SMALL,
            f"the library has {len(wheelsets)} wheelsets of known conicity, {parameters.least_wheelsets} are needed",
        )
    spread = float(np.std([entry.conicity for entry in wheelsets.values()]))
    if spread < parameters.least_spread:
        return Reason(
            ReasonCode.LIBRARY_ALIKE,
            f"the conicities of the library have a standard deviation of {spread:.3f},"
            f" {parameters.least_spread:g} is needed",
        )
    groups = [sharers(entry) for entry in ordered]
    before = unjudged(ordered)
    on_file = judged_by(
        before, differences(rows_of(ordered, 0.0 * before.own), before, groups, parameters.margin), parameters
    )
    rows = rows_of(ordered, on_file.alone)
    places = {place: number for number, place in enumerate(sorted({_place(entry) for entry in ordered}))}
    sections = {code: number for number, code in enumerate(sorted({place.section for place in places}))}
    speeds = [entry.signature.speed for entry in ordered]
    known = [entry.conicity for entry in ordered]
    return Library(
        vehicle_class=ordered[0].signature.vehicle_class,
        position=ordered[0].signature.position,
        entries=tuple(ordered),
        places=places,
        sections=sections,
        model=fitted(rows),
        conicity=(min(known), max(known)),
        speed=(min(speeds), max(speeds)),
        calibration=calibrated(rows, on_file, groups, parameters),
        on_file=on_file,
    )


def rows_of(entries: Sequence[LibraryEntry], own: FloatArray) -> Rows:
    """Return entries as arrays, their conicities shrunk by what their errors of std ``own`` (n,) add to their spread.

    A regressor with errors flattens a regression; what is expected of the true conicity, given the known one, does not
    (R. J. Carroll and others, "Measurement Error in Nonlinear Models", 2006, chapter 4).
    """
    names = sorted({entry.wheelset for entry in entries})
    places = sorted({_place(entry) for entry in entries})
    sections = sorted({place.section for place in places})
    conicity = np.array([entry.conicity for entry in entries])
    spread = max(float(np.var(conicity) - np.mean(own**2)), 1e-6)
    mean = float(np.mean(conicity))
    share = spread / (spread + own**2)
    expected, variance = np.asarray(mean + (conicity - mean) * share), np.asarray(share * own**2)
    return Rows(
        powers=np.stack([entry.signature.powers for entry in entries]),
        conicity=expected,
        on_file=conicity,
        speed=np.array([entry.signature.speed for entry in entries]),
        place=_numbers([_place(entry) for entry in entries], places),
        section=_numbers([_place(entry).section for entry in entries], sections),
        wheelset=_numbers([entry.wheelset for entry in entries], names),
        variance=variance / expected**2,
    )


def _numbers(values: Sequence[Hashable], known: Sequence[Hashable]) -> IntArray:
    numbers = {value: number for number, value in enumerate(known)}
    return np.array([numbers[value] for value in values], dtype=np.int64)


def _place(entry: LibraryEntry) -> Place:
    assert entry.signature.place is not None
    return entry.signature.place


@dataclass(frozen=True, slots=True)
class Change:
    """When the track of a place changed."""

    place: Place
    after_ns: int  # last pass of the old track
    before_ns: int  # first pass of the new one
    distance: float  # squared, over the number of features
    passes: int  # of the old track


@dataclass(frozen=True, slots=True)
class Current:
    """Entries of the track as it is now, and those that are of an earlier one."""

    entries: tuple[LibraryEntry, ...]
    retired: tuple[Retired, ...]
    changes: tuple[Change, ...]


def current(entries: Sequence[LibraryEntry], parameters: SignatureParameters) -> Current:
    """Return the entries of the present track of every place."""
    if not entries:
        return Current((), (), ())
    rows = rows_of(entries, np.zeros(len(entries)))
    tracks = track_effects(rows)
    by_place: dict[Place, list[int]] = defaultdict(list)
    for number, entry in sorted(enumerate(entries), key=lambda item: item[1].signature.start_ns):
        assert entry.signature.place is not None
        by_place[entry.signature.place].append(number)
    spans = [[entries[at] for at in members] for _, members in sorted(by_place.items())]
    of_places = [tracks[members] for _, members in sorted(by_place.items())]
    wheelset = np.unique(rows.wheelset, return_inverse=True)[1]
    scatter = np.eye(tracks.shape[1]), np.eye(tracks.shape[1])
    order = np.concatenate([members for _, members in sorted(by_place.items())])
    for _ in range(parameters.library_rounds):
        found = [_change(span, track, scatter, parameters) for span, track in zip(spans, of_places, strict=True)]
        sides = [_from_sides(track, change) for track, change in zip(of_places, found, strict=True)]
        means = len(found) + sum(change is not None for change in found)
        scatter = scatter_of(np.concatenate(sides), wheelset[order], means)
    found = [_change(span, track, scatter, parameters) for span, track in zip(spans, of_places, strict=True)]
    most = parameters.largest_distance
    changes = {change.place: change for change in found if change is not None and change.distance > most}
    kept, retired = [], []
    for entry in entries:
        change = changes.get(entry.signature.place) if entry.signature.place else None
        if change is not None and entry.signature.start_ns <= change.after_ns:
            where = f"section {change.place.section}, stretch {change.place.cell}"
            text = f"the track of {where} has changed since: its features differ from later ones"
            retired.append(Retired(entry, Reason(ReasonCode.SECTION_CHANGED, text)))
        else:
            kept.append(entry)
    return Current(tuple(kept), tuple(retired), tuple(changes.values()))


def _change(
    entries: Sequence[LibraryEntry],
    tracks: FloatArray,
    scatter: tuple[FloatArray, FloatArray],
    parameters: SignatureParameters,
) -> Change | None:
    of_wheelset, rest = scatter
    best: Change | None = None
    for at in range(parameters.least_passes, len(entries) - parameters.least_passes + 1):
        before, after = entries[at - 1].signature, entries[at].signature
        if before.start_ns == after.start_ns:
            continue
        shares = []
        for part in (entries[:at], entries[at:]):
            counts = np.unique([entry.wheelset for entry in part], return_counts=True)[1] / len(part)
            shares.append(float(np.sum(counts**2)))
        covariance = rest * (1 / at + 1 / (len(entries) - at)) + of_wheelset * sum(shares)
        difference = tracks[at:].mean(axis=0) - tracks[:at].mean(axis=0)
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), difference)
        distance = float(whitened @ whitened) / len(difference)
        if before.place is not None and (best is None or distance > best.distance):
            best = Change(before.place, before.start_ns, after.start_ns, distance, at)
    return best


def _from_sides(tracks: FloatArray, change: Change | None) -> FloatArray:
    if change is None:
        return np.asarray(tracks - tracks.mean(axis=0))
    sides = (tracks[: change.passes], tracks[change.passes :])
    return np.concatenate([side - side.mean(axis=0) for side in sides])


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
    """The libraries that some entries make, each made once."""

    entries: Sequence[LibraryEntry]  # those that were retired left out
    parameters: SignatureParameters  # what a library must hold
    _alike: dict[_Key, _Alike] = field(default_factory=dict)
    _made: dict[tuple[_Key, frozenset[str]], Library | Reason] = field(default_factory=dict)

    def admitted(self, subject: Subject) -> Admitted:
        """Return the entries from which something may be concluded about a wheelset."""
        alike = self._of(subject)
        outside = _outside(alike, subject)
        its_own = frozenset().union(*(alike.holding.get(name, frozenset()) for name in _names(subject)))
        others = (entry for number, entry in enumerate(alike.entries) if number not in its_own)
        kept = tuple(entry for entry in others if not outside & sharers(entry))
        left_out = Counter(alike.left_out)
        left_out[ReasonCode.SAME_WHEELSET] += len(its_own)
        left_out[ReasonCode.JUDGED_TOGETHER] += len(alike.entries) - len(its_own) - len(kept)
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
            self._alike[key] = _alike(self.entries, subject, self.parameters.most_entries, self.parameters)
        return self._alike[key]


def _key(subject: Subject) -> _Key:
    return subject.vehicle_class, subject.position, subject.pair


def _names(subject: Subject) -> frozenset[str]:
    return subject.shares_data | {subject.wheelset}


def _outside(alike: _Alike, subject: Subject) -> frozenset[str]:
    """Return the wheelsets that are left out: the fold of the judged one, or more where its data are in several."""
    touched = [fold for fold in alike.folds if fold & _names(subject)]
    return frozenset().union(*touched)


def _alike(entries: Sequence[LibraryEntry], subject: Subject, most: int, parameters: SignatureParameters) -> _Alike:
    kept, left_out = [], Counter[ReasonCode]()
    for entry in entries:
        signature = entry.signature
        if (signature.vehicle_class, signature.position) != (subject.vehicle_class, subject.position):
            left_out[ReasonCode.OTHER_VEHICLE_CLASS] += 1
        elif entry.pair.wheel != subject.pair.wheel or subject.pair.rail not in {None, entry.pair.rail}:
            left_out[ReasonCode.OTHER_PROFILES] += 1
        else:
            kept.append(entry)
    chosen = _newest(kept, most)
    left_out[ReasonCode.NEWER_ENTRIES] += len(kept) - len(chosen)
    holding: dict[str, set[int]] = defaultdict(set)
    for number, entry in enumerate(chosen):
        for name in sharers(entry):
            holding[name].add(number)
    numbers = {name: frozenset(of_name) for name, of_name in holding.items()}
    return _Alike(tuple(chosen), folds(chosen, parameters), numbers, left_out)


def _newest(entries: Sequence[LibraryEntry], most: int) -> Sequence[LibraryEntry]:
    if len(entries) <= most:
        return entries
    of_place: dict[object, list[LibraryEntry]] = defaultdict(list)
    for entry in sorted(entries, key=lambda item: (-item.signature.start_ns, item.wheelset, item.signature.order)):
        of_place[entry.signature.place].append(entry)
    each = 1
    while sum(min(each + 1, len(entries_there)) for entries_there in of_place.values()) <= most:
        each += 1
    chosen = {id(entry) for entries_there in of_place.values() for entry in entries_there[:each]}
    return [entry for entry in entries if id(entry) in chosen]

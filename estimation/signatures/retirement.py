"""Entries of places whose track has changed since: found by their features, and retired with the reason.

What the track of a place adds to features is what they have beyond the response to conicity and speed. Work on the
track changes it for all that pass. So of every place each time between two passes is tried: what came before is
compared with what came after, and the largest distance decides. Passes scatter about the mean of their side of that
time: the change itself, which may be of a large part of a small library, is not in what it is compared with.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.signatures.library import rows_of
from estimation.signatures.mixed_model import Scatter, scatter_of, track_effects
from estimation.values.arrays import FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import LibraryEntry, Place, Retired

LEAST_PASSES = 3  # on either side of a change
ROUNDS = 2  # in which the times of changes and the scatter about them are found
LARGEST = 5.5  # squared distance over the number of features, from which on a place has changed


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
    tried: tuple[Change, ...]  # the largest of every place, whether its track has changed or not


def current(entries: Sequence[LibraryEntry]) -> Current:
    """Return the entries of the present track of every place."""
    if not entries:
        return Current((), (), (), ())
    rows = rows_of(entries, np.zeros(len(entries)))
    tracks = track_effects(rows)
    by_place: dict[Place, list[int]] = defaultdict(list)
    for number, entry in sorted(enumerate(entries), key=lambda item: item[1].signature.start_ns):
        assert entry.signature.place is not None
        by_place[entry.signature.place].append(number)
    spans = [[entries[at] for at in members] for _, members in sorted(by_place.items())]
    of_places = [tracks[members] for _, members in sorted(by_place.items())]
    wheelset = np.unique(rows.wheelset, return_inverse=True)[1]
    scatter = Scatter(*2 * (np.eye(tracks.shape[1]),))
    for _ in range(ROUNDS):
        found = [_change(span, track, scatter) for span, track in zip(spans, of_places, strict=True)]
        sides = [_from_sides(track, change) for track, change in zip(of_places, found, strict=True)]
        order = np.concatenate([members for _, members in sorted(by_place.items())])
        means = len(found) + sum(change is not None for change in found)
        scatter = scatter_of(np.concatenate(sides), wheelset[order], means)
    found = [_change(span, track, scatter) for span, track in zip(spans, of_places, strict=True)]
    tried = tuple(change for change in found if change is not None)
    changes = {change.place: change for change in tried if change.distance > LARGEST}
    kept, retired = [], []
    for entry in entries:
        change = changes.get(entry.signature.place) if entry.signature.place else None
        if change is not None and entry.signature.start_ns <= change.after_ns:
            text = f"the track of {place_name(change.place)} has changed since: its features differ from later ones"
            retired.append(Retired(entry, Reason(ReasonCode.SECTION_CHANGED, text)))
        else:
            kept.append(entry)
    return Current(tuple(kept), tuple(retired), tuple(changes.values()), tried)


def place_name(place: Place) -> str:
    """Return a place in words."""
    return f"section {place.section}, stretch {place.cell}"


def _change(entries: Sequence[LibraryEntry], tracks: FloatArray, scatter: Scatter) -> Change | None:
    """Return the largest change of a place, by its passes in order of time; None where there are too few."""
    best: Change | None = None
    for at in range(LEAST_PASSES, len(entries) - LEAST_PASSES + 1):
        before, after = entries[at - 1].signature, entries[at].signature
        if before.start_ns == after.start_ns:
            continue
        distance = _distance(tracks, entries, at, scatter)
        if before.place is not None and (best is None or distance > best.distance):
            best = Change(before.place, before.start_ns, after.start_ns, distance, at)
    return best


def _from_sides(tracks: FloatArray, change: Change | None) -> FloatArray:
    """Return tracks less the mean of their side of a change."""
    if change is None:
        return np.asarray(tracks - tracks.mean(axis=0))
    sides = (tracks[: change.passes], tracks[change.passes :])
    return np.concatenate([side - side.mean(axis=0) for side in sides])


def _distance(tracks: FloatArray, entries: Sequence[LibraryEntry], at: int, scatter: Scatter) -> float:
    shares = []
    for part in (entries[:at], entries[at:]):
        counts = np.unique([entry.wheelset for entry in part], return_counts=True)[1] / len(part)
        shares.append(float(np.sum(counts**2)))
    covariance = scatter.rest * (1 / at + 1 / (len(entries) - at)) + scatter.of_wheelset * sum(shares)
    difference = tracks[at:].mean(axis=0) - tracks[:at].mean(axis=0)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), difference)
    return float(whitened @ whitened) / len(difference)

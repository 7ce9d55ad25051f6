"""Entries of places whose track has changed since: found by their features, and retired with the reason.

What the track of a place adds to features is what they have beyond the response to conicity and speed. Work on the
track changes it for all that pass. So of every place each time between two passes is tried: what came before is
compared with what came after, and the largest distance decides.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.signatures.library import rows_of
from estimation.signatures.mixed_model import MixedModel, fitted, track_effects
from estimation.values.arrays import FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import LibraryEntry, Place, Retired

LEAST_PASSES = 3  # on either side of a change
LARGEST = 2.5  # squared distance over the number of features, from which on a place has changed


@dataclass(frozen=True, slots=True)
class Change:
    """When the track of a place changed."""

    place: Place
    after_ns: int  # last pass of the old track
    before_ns: int  # first pass of the new one
    distance: float  # squared, over the number of features


@dataclass(frozen=True, slots=True)
class Current:
    """Entries of the track as it is now, and those that are of an earlier one."""

    entries: tuple[LibraryEntry, ...]
    retired: tuple[Retired, ...]
    changes: tuple[Change, ...]


def current(entries: Sequence[LibraryEntry]) -> Current:
    """Return the entries of the present track of every place.

    Parameters
    ----------
    entries
        Of one class and axle position, with places.
    """
    if not entries:
        return Current((), (), ())
    rows = rows_of(entries, np.zeros(len(entries)))
    model, tracks = fitted(rows), track_effects(rows)
    by_place: dict[Place, list[int]] = defaultdict(list)
    for number, entry in enumerate(entries):
        assert entry.signature.place is not None
        by_place[entry.signature.place].append(number)
    changes = {}
    for place, members in sorted(by_place.items()):
        ordered = sorted(members, key=lambda at: entries[at].signature.start_ns)
        change = _change(place, [entries[at] for at in ordered], tracks[ordered], model)
        if change is not None:
            changes[place] = change
    kept, retired = [], []
    for entry in entries:
        change = changes.get(entry.signature.place) if entry.signature.place else None
        if change is not None and entry.signature.start_ns <= change.after_ns:
            text = f"the track of {place_name(change.place)} has changed since: its features differ from later ones"
            retired.append(Retired(entry, Reason(ReasonCode.SECTION_CHANGED, text)))
        else:
            kept.append(entry)
    return Current(tuple(kept), tuple(retired), tuple(changes.values()))


def place_name(place: Place) -> str:
    """Return a place in words.

    Parameters
    ----------
    place
        The place.
    """
    return f"section {place.section}, stretch {place.cell}"


def _change(place: Place, entries: Sequence[LibraryEntry], tracks: FloatArray, model: MixedModel) -> Change | None:
    """Return the last change of a place, by its passes in order of time."""
    best: Change | None = None
    for at in range(LEAST_PASSES, len(entries) - LEAST_PASSES + 1):
        before, after = entries[at - 1].signature.start_ns, entries[at].signature.start_ns
        if before == after:
            continue
        distance = _distance(tracks, entries, at, model)
        if distance > LARGEST and (best is None or distance > best.distance):
            best = Change(place, before, after, distance)
    return best


def _distance(tracks: FloatArray, entries: Sequence[LibraryEntry], at: int, model: MixedModel) -> float:
    shares = []
    for part in (entries[:at], entries[at:]):
        counts = np.unique([entry.wheelset for entry in part], return_counts=True)[1] / len(part)
        shares.append(float(np.sum(counts**2)))
    covariance = model.rest * (1 / at + 1 / (len(entries) - at)) + model.of_wheelset * sum(shares)
    difference = tracks[at:].mean(axis=0) - tracks[:at].mean(axis=0)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), difference)
    return float(whitened @ whitened) / len(difference)

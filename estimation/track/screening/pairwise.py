"""Passes of one section compared with each other: who agrees, and who stands alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.track.screening.agreement import FilteredPass, agreement
from estimation.track.screening.disagreement import disagreement
from estimation.track.screening.parameters import ScreeningParameters
from estimation.track.screening.position_jumps import Link
from estimation.values.arrays import IntArray
from estimation.values.reasons import Reason

OVERLAP_RESOLUTION = 20  # grid points: overlaps that differ less count as equal
MIN_CHAIN_OVERLAP = 10  # of these, of overlap with a pass that continues along the section
CHAIN_NEIGHBOURS = 2  # passes that continue along the section


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two passes by index; they agree where there is no reason against it."""

    first: int
    second: int
    reason: Reason | None
    link: Link

    @property
    def agrees(self) -> bool:
        """Whether both may be of one place."""
        return self.reason is None


def compare_pairs(
    filtered: Mapping[int, FilteredPass], journey_of: IntArray, p: ScreeningParameters
) -> list[Comparison]:
    """Return the comparisons of every pass with up to ``p.peers`` that overlap it most, of as many other journeys.

    Args:
        filtered: Passes by index.
        journey_of: (n,) number of each pass's journey; those of one journey share their errors and are not compared.
        p: Limits, and how many peers; the cost is linear in the number of passes.
    """
    pairs = {(min(i, j), max(i, j)) for i in filtered for j in _peers(i, filtered, journey_of, p.peers)}
    comparisons = (_compare(i, j, filtered, p) for i, j in sorted(pairs))
    return [one for one in comparisons if one is not None]


def _compare(i: int, j: int, filtered: Mapping[int, FilteredPass], p: ScreeningParameters) -> Comparison | None:
    """Return why two passes contradict each other, or where they agree; None where they share too little."""
    found = agreement(filtered[i], filtered[j], p.positions.largest_offset, p.cutoff_wavelength)
    if found.samples < p.least_samples and found.log10_chance > p.log10_chance:
        return None
    return Comparison(i, j, disagreement(found, 1.0, p, "other passes of the place"), Link(i, j, found.shift))


def _peers(i: int, filtered: Mapping[int, FilteredPass], journey_of: IntArray, wanted: int) -> list[int]:
    """Return the passes to compare ``i`` with: of each other journey the one that overlaps it most, those that do best.

    Wheelsets of one vehicle overlap alike; ``i`` decides among them, so that not all are compared with the same one.
    Besides, a few that overlap less and continue along the section, so that comparisons do not end where windows do.
    """
    others = np.array(list(filtered), dtype=np.int64)
    first = np.array([one.first for one in filtered.values()])
    last = np.array([one.last for one in filtered.values()])
    shared = (np.minimum(last, filtered[i].last) - np.maximum(first, filtered[i].first)) // OVERLAP_RESOLUTION
    order = np.lexsort(((others - i) % len(journey_of), -shared))
    chosen: dict[int, int] = {}  # by journey
    for k in order[shared[order] > 0]:
        chosen.setdefault(int(journey_of[others[k]]), int(others[k]))
    chosen.pop(int(journey_of[i]), None)
    best = list(chosen.values())[:wanted]
    beyond = np.where(
        (journey_of[others] != journey_of[i]) & (shared >= MIN_CHAIN_OVERLAP),
        last - filtered[i].last,
        0,
    )
    following = [int(others[k]) for k in np.argsort(-beyond, kind="stable")[:CHAIN_NEIGHBOURS] if beyond[k] > 0]
    return list(dict.fromkeys([*best, *following]))


def minority(
    comparisons: Sequence[Comparison], journey_of: IntArray, confirmed: frozenset[int] = frozenset()
) -> dict[int, Reason]:
    """Return the passes that are contradicted by at least as many journeys as stand with them, with the reason.

    Args:
        journey_of: (n,) number of each pass's journey.
        confirmed: Passes that a known alignment agrees with: they are not refused, and whom they contradict is.
    """
    camp = _camps(comparisons, len(journey_of))
    members: dict[int, set[int]] = {}
    for c in comparisons:
        for i in (c.first, c.second):
            members.setdefault(int(camp[i]), set()).add(int(journey_of[i]))
    known = {int(camp[i]) for i in confirmed}
    found: dict[int, Reason] = {}
    for c in comparisons:
        if c.reason is None or camp[c.first] == camp[c.second]:
            continue
        for i, j in ((c.first, c.second), (c.second, c.first)):
            own, theirs = int(camp[i]), int(camp[j])
            weaker = len(members[own]) <= len(members[theirs]) if own not in known else False
            if (weaker or theirs in known) and i not in confirmed:
                both = len(members[own] | members[theirs])
                found[i] = replace(
                    c.reason, text=f"{c.reason}; {len(members[own])} of {both} journeys of the place agree with it"
                )
    return found


def _camps(comparisons: Sequence[Comparison], count: int) -> IntArray:
    """Return for every pass (count,) the number of the camp that agreements join it to."""
    camp = np.arange(count)

    def head(i: int) -> int:
        while camp[i] != i:
            i = int(camp[i])
        return i

    for c in comparisons:
        if c.agrees:
            first, second = sorted((head(c.first), head(c.second)))
            camp[second] = first
    return np.array([head(i) for i in range(count)], dtype=np.int64)

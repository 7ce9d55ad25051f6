"""Passes of one section compared with each other: who agrees, and who stands alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.track.screening.agreement import Felt
from estimation.track.screening.position_jumps import Link
from estimation.values.arrays import IntArray
from estimation.values.reasons import Reason

ALIKE = 20  # grid points: overlaps that differ less are alike
LEADING_ON = 200  # grid points that one which leads on must share
ONWARD = 2  # of them
Compare = Callable[[Felt, Felt], tuple[Reason | None, Link | None] | None]


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


def compared(heard: Mapping[int, Felt], journey_of: IntArray, peers: int, compare: Compare) -> list[Comparison]:
    """Return the comparisons of every pass with up to ``peers`` that overlap it most, of as many other journeys.

    Parameters
    ----------
    heard
        Passes by index.
    journey_of
        (n,) number of each pass's journey; those of one journey share their errors and are not compared.
    peers
        How many; the cost is linear in the number of passes.
    compare
        Why two contradict each other, or where they agree; None where nothing can be said.
    """
    pairs = {(min(i, j), max(i, j)) for i in heard for j in _peers(i, heard, journey_of, peers)}
    found = []
    for i, j in sorted(pairs):
        said = compare(heard[i], heard[j])
        if said is not None:
            reason, link = said
            found.append(Comparison(i, j, reason, replace(link or Link(0, 0, 0.0), first=i, second=j)))
    return found


def _peers(i: int, heard: Mapping[int, Felt], journey_of: IntArray, wanted: int) -> list[int]:
    """Return the passes to compare ``i`` with: of each other journey the one that overlaps it most, those that do best.

    Wheelsets of one vehicle overlap alike; ``i`` decides among them, so that not all are compared with the same one.
    Besides, a few that overlap less and lead on along the section, so that comparisons do not end where windows do.
    """
    others = np.array(list(heard), dtype=np.int64)
    first = np.array([one.first for one in heard.values()])
    last = np.array([one.last for one in heard.values()])
    shared = (np.minimum(last, heard[i].last) - np.maximum(first, heard[i].first)) // ALIKE
    order = np.lexsort(((others - i) % len(journey_of), -shared))
    chosen: dict[int, int] = {}  # by journey
    for k in order[shared[order] > 0]:
        chosen.setdefault(int(journey_of[others[k]]), int(others[k]))
    chosen.pop(int(journey_of[i]), None)
    best = list(chosen.values())[:wanted]
    beyond = np.where((journey_of[others] != journey_of[i]) & (shared * ALIKE >= LEADING_ON), last - heard[i].last, 0)
    onward = [int(others[k]) for k in np.argsort(-beyond, kind="stable")[:ONWARD] if beyond[k] > 0]
    return list(dict.fromkeys([*best, *onward]))


def contradicted(
    comparisons: Sequence[Comparison], journey_of: IntArray, believed: frozenset[int] = frozenset()
) -> dict[int, Reason]:
    """Return the passes that are contradicted by at least as many journeys as stand with them, with the reason.

    Parameters
    ----------
    comparisons
        Of the passes.
    journey_of
        (n,) number of each pass's journey.
    believed
        Passes that a known alignment agrees with: they are not refused, and whom they contradict is.
    """
    camp = _camps(comparisons, len(journey_of))
    members: dict[int, set[int]] = {}
    for c in comparisons:
        for i in (c.first, c.second):
            members.setdefault(int(camp[i]), set()).add(int(journey_of[i]))
    known = {int(camp[i]) for i in believed}
    found: dict[int, Reason] = {}
    for c in comparisons:
        if c.reason is None or camp[c.first] == camp[c.second]:
            continue
        for i, j in ((c.first, c.second), (c.second, c.first)):
            mine, theirs = int(camp[i]), int(camp[j])
            weaker = len(members[mine]) <= len(members[theirs]) if mine not in known else False
            if (weaker or theirs in known) and i not in believed:
                both = len(members[mine] | members[theirs])
                found[i] = replace(
                    c.reason, text=f"{c.reason}; {len(members[mine])} of {both} journeys of the place agree with it"
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

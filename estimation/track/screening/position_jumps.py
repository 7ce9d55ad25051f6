"""Relative positions of passes, from the shifts at which they agree; and which are displaced within their journey.

The passes of a journey share one odometer, whose error grows slowly. Where the position of a vehicle jumped, the passes
behind the jump are displaced against those before it; the longer part is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import spsolve

from estimation.values.arrays import FloatArray, IntArray

ROUNDS = 12
SCALE = 1.2e-3  # by which an odometer may differ from the fleet's
RESOLUTION = 0.3  # m: shifts that fit better than this fit
LOOSE = 1e-6  # weight of keeping every pass where it is: what links leave open


@dataclass(frozen=True, slots=True)
class Link:
    """Two passes, by index, that agree where the first is displaced by ``shift`` m against the second."""

    first: int
    second: int
    shift: float  # m


def misplaced(links: Sequence[Link], journey_of: IntArray, middle: FloatArray, tolerance: float) -> Mapping[int, float]:
    """Return by pass how far it is from the rest of its journey, m, where its position jumped.

    Args:
        journey_of: (n,) number of each pass's journey.
        middle: (n,) m along the section.
        tolerance: m by which neighbours in a journey may differ, besides the scale of an odometer.
    """
    if not links:
        return {}
    offset, group = _offsets(links, len(journey_of))
    linked = np.unique([(link.first, link.second) for link in links])
    found: dict[int, float] = {}
    for journey, together in sorted({(int(journey_of[i]), int(group[i])) for i in linked}):
        members = [int(i) for i in linked if journey_of[i] == journey and group[i] == together]
        parts = _parts(sorted(members, key=lambda i: (middle[i], i)), offset, middle, tolerance)
        main = max(parts, key=len)
        for part in parts:
            if part is not main:
                found |= {i: float(offset[i] - np.median(offset[main])) for i in part}
    return found


def _offsets(links: Sequence[Link], count: int) -> tuple[FloatArray, IntArray]:
    """Return the displacement of each pass (count,) along the section, m, and its group.

    Fitted by least absolute values. Groups are what links join; offsets of different groups cannot be compared.
    """
    rows = np.arange(len(links))
    first, second = np.array([link.first for link in links]), np.array([link.second for link in links])
    shift = np.array([link.shift for link in links])
    ones = np.ones(len(links))
    design = sparse.csr_matrix(
        (np.concatenate([ones, -ones]), (np.concatenate([rows, rows]), np.concatenate([first, second]))),
        shape=(len(links), count),
    )
    joined = sparse.csr_matrix((ones, (first, second)), shape=(count, count))
    group = np.asarray(csgraph.connected_components(joined)[1], dtype=np.int64)
    weights = ones
    offset = np.zeros(count)
    for _ in range(ROUNDS):
        weighted = sparse.diags(weights) @ design
        normal = (weighted.T @ design + LOOSE * sparse.identity(count)).tocsc()
        offset = np.asarray(spsolve(normal, weighted.T @ shift))
        weights = np.reciprocal(np.maximum(np.abs(shift - design @ offset), RESOLUTION))
    return offset, group


def _parts(ordered: Sequence[int], offset: FloatArray, middle: FloatArray, tolerance: float) -> list[list[int]]:
    """Return the passes of a journey, in order along the section, in parts within which nothing jumps."""
    parts: list[list[int]] = []
    for i in ordered:
        for part in reversed(parts):
            allowed = tolerance + SCALE * abs(middle[i] - middle[part[-1]])
            if abs(offset[i] - float(np.median(offset[part[-5:]]))) <= allowed:
                part.append(i)
                break
        else:
            parts.append([i])
    return parts

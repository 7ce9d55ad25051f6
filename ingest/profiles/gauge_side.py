"""Which side of a rail is its gauge side, from the shape of the head.

- Only one side reaches 14 mm below the crown, or neither does and one ends 3 mm deeper: the gauge is measured there.
- Both reach deep enough and the head leans: a rail leans towards the track centre, so the middle between its sides
  moves to the field side with depth. Below 14.5 mm no wheel wears a side.
- The two sides are alike to 0.05 mm: either will do.
- Else the shape does not show it, because wear of one side and inclination look alike.
"""

from __future__ import annotations

import numpy as np

from estimation.contact.surface import GAUGE_DEPTH
from estimation.values.arrays import FloatArray

_GAUGE_DEPTH = GAUGE_DEPTH * 1e3  # mm
_DEPTHS = np.arange(14.5, 30.1, 0.5)  # mm below the crown, where sides are straight and not worn
_FEWEST_DEPTHS = 9
LEAST_LEAN = 0.012
"""Tangent from which a head counts as leaning; rails are inclined by 1:40 to 1:20."""

_MOST_LEAN = 0.07
_MOST_DIVERGENCE = 0.15  # of the sides, whose own slopes are 1:20 at most; a worn gauge face exceeds it
_ALIKE = 0.05  # mm, root mean square
_MEASURED_DEEPER = 3.0  # mm, by which the side is followed deeper that matters to who measured it


def gauge_side_is_positive(y: FloatArray, depth: FloatArray) -> bool | None:
    """Return whether the gauge side of a rail is at positive y; None if its shape does not show it.

    Args:
        y, depth: (n,) mm, in order of the profile with y increasing on the whole; depth below the crown.
    """
    crown = int(np.argmin(depth))
    deepest = [float(part.max()) for part in (depth[: crown + 1], depth[crown:])]
    reaches = [side >= _GAUGE_DEPTH for side in deepest]
    if reaches[0] != reaches[1] or (not reaches[0] and abs(deepest[1] - deepest[0]) > _MEASURED_DEEPER):
        return deepest[1] > deepest[0]
    leaning = lean(y, depth)
    if LEAST_LEAN <= abs(leaning) <= _MOST_LEAN:
        return leaning < 0.0
    if _sides_alike(y, depth, min(_GAUGE_DEPTH, *deepest)):
        return False
    return None


def lean(y: FloatArray, depth: FloatArray) -> float:
    """Return the tangent by which the head leans towards negative y, from its sides; NaN if these are short or worn.

    Args:
        y, depth: (n,) mm, in order of the profile with y increasing on the whole; depth below the crown.
    """
    crown = int(np.argmin(depth))
    left = _side(y[crown::-1], depth[crown::-1])
    right = _side(y[crown:], depth[crown:])
    middle = 0.5 * (left + right)
    usable = np.isfinite(middle)
    if np.count_nonzero(usable) < _FEWEST_DEPTHS:
        return float("nan")
    divergence = float(np.polyfit(_DEPTHS[usable], (right - left)[usable], 1)[0])
    leaning = float(np.polyfit(_DEPTHS[usable], middle[usable], 1)[0])
    return leaning if abs(divergence) <= _MOST_DIVERGENCE else float("nan")


def _side(y: FloatArray, depth: FloatArray) -> FloatArray:
    """Return y at the depths, as the mean of the points around each; NaN below the deepest point of the way down."""
    turn = int(np.argmax(depth))
    y, depth = y[: turn + 1], depth[: turn + 1]
    result = np.full(len(_DEPTHS), np.nan)
    if depth[-1] < _DEPTHS[0]:
        return result
    rising = np.maximum.accumulate(depth)
    inside = depth[-1] >= _DEPTHS
    result[inside] = np.interp(_DEPTHS[inside], rising, y)
    return result


def _sides_alike(y: FloatArray, depth: FloatArray, level: float) -> bool:
    """Return whether the head is the same seen from either of its faces at ``level`` below the crown, mm."""
    crown = int(np.argmin(depth))
    left = float(np.interp(level, np.maximum.accumulate(depth[crown::-1]), y[crown::-1]))
    right = float(np.interp(level, np.maximum.accumulate(depth[crown:]), y[crown:]))
    inwards = np.linspace(2.0, 0.5 * (right - left), 60)
    order = np.argsort(y, kind="stable")
    from_left = np.interp(left + inwards, y[order], depth[order])
    from_right = np.interp(right - inwards, y[order], depth[order])
    return float(np.sqrt(np.mean((from_left - from_right) ** 2))) < _ALIKE

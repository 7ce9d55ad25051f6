"""What of a window is on rails of low friction: creep is not linear there, and the geometry would be wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.values.opinions import CELL_LENGTH, WindowAdhesion
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction
from estimation.values.windows import Window

MARGIN = 25.0  # m kept from a stretch of low friction: half a place
MOST_LEFT_OUT = 0.25  # share of the samples from which low friction is why too few are left
TOO_LITTLE = frozenset({ReasonCode.NO_USABLE_SAMPLE, ReasonCode.INTERRUPTED, ReasonCode.TOO_FEW_USABLE})


def away_from_low_adhesion(
    window: Window, stretches: Sequence[tuple[float, float]], correction: Correction | None = None
) -> Window | Reason:
    """Return the window with its samples on low friction not valid, or that none is left."""
    if not stretches:
        return window
    distance = window.distance if correction is None else correction.at(window.distance)
    low = np.zeros(len(window.valid), np.bool_)
    for begin, end in stretches:
        low |= (distance >= begin - MARGIN) & (distance <= end + MARGIN)
    left = window.valid & ~low
    if not left.any() and window.valid.any():
        return Reason(ReasonCode.LOW_ADHESION, "all of the window is on rails of low friction")
    return replace(window, valid=left)


def refused_for_low_adhesion(reason: Reason, window: Window, kept: Window) -> Reason:
    """Return why a window is refused: low friction, where that took most of its samples and too few are left."""
    share = 1.0 - float(kept.valid.sum()) / max(int(window.valid.sum()), 1)
    if share < MOST_LEFT_OUT or reason.code not in TOO_LITTLE:
        return reason
    text = f"{share:.0%} of its samples are on rails of low friction; of the rest: {reason.text}"
    return Reason(ReasonCode.LOW_ADHESION, text)


def touched(one: WindowAdhesion, stretches: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Return the stretches of low friction that a window was on."""
    if one.sums is None or not len(one.sums.cells):
        return ()
    first, behind = CELL_LENGTH * one.sums.cells[0], CELL_LENGTH * (one.sums.cells[-1] + 1)
    return tuple((begin, end) for begin, end in stretches if begin < behind + MARGIN and end > first - MARGIN)

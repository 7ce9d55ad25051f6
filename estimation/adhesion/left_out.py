"""What of a window is on rails of low friction: creep is not linear there, and the geometry would be wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window

MARGIN = 25.0  # m kept from a stretch of low friction: half a place


def away_from_low_adhesion(window: Window, stretches: Sequence[tuple[float, float]]) -> Window | Reason:
    """Return the window with its samples on low friction not valid, or that none is left.

    Parameters
    ----------
    window
        Samples, at positions along its section.
    stretches
        Begin and end of where friction is low, m.
    """
    if not stretches:
        return window
    low = np.zeros(len(window.valid), np.bool_)
    with np.errstate(invalid="ignore"):
        for begin, end in stretches:
            low |= (window.distance >= begin - MARGIN) & (window.distance <= end + MARGIN)
    left = window.valid & ~low
    if not left.any() and window.valid.any():
        return Reason(ReasonCode.LOW_ADHESION, "all of the window is on rails of low friction")
    return replace(window, valid=left)

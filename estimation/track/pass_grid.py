"""Passes of an epoch on one grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.track.passes import Pass, gridded
from estimation.track.profile_life import ProfileLife


def resampled(item: Pass, life: ProfileLife, step: float) -> Pass:
    """Return a pass on a grid, under the life of its wheelset's profile.

    Args:
        step: Grid spacing, m.
    """
    first, displacement, difference = gridded(item, step)
    at = (first + np.arange(len(displacement))) * step
    return replace(
        item,
        life=life,
        at=np.asarray(at, dtype=np.float64),
        displacement=displacement,
        difference=difference,
        stiffness_term=None if item.stiffness_term is None else np.interp(at, item.at, item.stiffness_term),
    )

"""The yaw of a bogie frame, from the lateral accelerations that the two nodes of the bogie measure on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.values.windows import Window


def with_frame_yaw(window: Window, partner: Window, ahead: float) -> Window:
    """Return ``window`` with the yaw acceleration of the frame, valid where both nodes are.

    Gravity is in both sensors alike, for a frame rolls as one piece, and drops out.

    Parameters
    ----------
    window
        Of one node; its mass sensor is on the frame above its axle.
    partner
        Of the other node of the bogie, over the same time.
    ahead
        By how much the node of ``window`` is ahead of the other, m: the wheelbase, negative at the rear axle.

    Raises
    ------
    ValueError
        The windows are not of one time.
    """
    if partner.start_ns != window.start_ns or len(partner.valid) != len(window.valid):
        raise ValueError(f"windows from {window.start_ns} and {partner.start_ns} are not of one time")
    valid = window.valid & partner.valid
    difference = window.mass_lateral_acceleration - partner.mass_lateral_acceleration
    return replace(window, valid=valid, frame_yaw_acceleration=np.where(valid, difference / ahead, np.nan))

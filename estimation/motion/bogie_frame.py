"""The yaw of a bogie frame, from the lateral accelerations that the two nodes of the bogie measure on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window

LEAST_SHARE = 0.2  # of what the frame moves above the other axle: right nodes have a half and more


def check_frame_sensors(window: Window, partner: Window) -> Reason | None:
    """Return that one of the two frame sensors of a bogie measures nothing; None where both do.

    A frame moves above both its axles. A sensor that is dead gives one value, or its noise.
    """
    known = window.valid & partner.valid
    if not known.any():
        return None
    nodes = (window, partner)
    moved = [float(np.std(node.mass_lateral_acceleration[known])) for node in nodes]
    least, most = sorted(range(len(nodes)), key=moved.__getitem__)
    if moved[least] >= LEAST_SHARE * moved[most] > 0.0:
        return None
    return Reason(
        ReasonCode.FRAME_UNKNOWN,
        f"the frame sensor above axle {nodes[least].axle} measures {moved[least]:.3f} m/s2 rms, the one above axle"
        f" {nodes[most].axle} {moved[most]:.3f}; check the sensor of axle {nodes[least].axle}",
    )


def with_frame_yaw(window: Window, partner: Window, ahead: float) -> Window:
    """Return ``window`` with the yaw acceleration of the frame, valid where both nodes are.

    Gravity is in both sensors alike, for a frame rolls as one piece, and drops out.

    Args:
        ahead: By how much the node of ``window`` is ahead of the other, m: the wheelbase, negative at the rear axle.
    """
    if partner.start_ns != window.start_ns or len(partner.valid) != len(window.valid):
        raise ValueError(f"windows from {window.start_ns} and {partner.start_ns} are not of one time")
    valid = window.valid & partner.valid
    difference = window.mass_lateral_acceleration - partner.mass_lateral_acceleration
    return replace(window, valid=valid, frame_yaw_acceleration=np.where(valid, difference / ahead, np.nan))

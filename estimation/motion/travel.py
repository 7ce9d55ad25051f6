"""Which end of a vehicle goes first, by what its nodes measure: trains run either way without being turned.

An axle that rolls forward with a yaw to the left moves to the left, y' = V psi; with its rear end first a vehicle moves
to the right. Looked at in a mirror across the track it runs forward: its yaw has the other sign, left remains left,
and what is in front is behind. So a window of such a journey is turned over once, when it is loaded, and ordinary then.
"""

from __future__ import annotations

from dataclasses import replace

from estimation.motion.axle_distance import axle_distance
from estimation.motion.checks import BACKWARDS, direction, lateral_yaw_correlation
from estimation.motion.integration import integrate
from estimation.motion.parameters import SignalParameters
from estimation.motion.usable_samples import moving_samples
from estimation.values.windows import Window


def runs_backwards(window: Window) -> bool | None:
    """Return whether the axes of a node point against the direction of travel; None where it does not say.

    Args:
        window: Measured accelerations and speed, (n,) each.
    """
    signals = SignalParameters()
    correlation = lateral_yaw_correlation(integrate(window, moving_samples(window, signals), signals))
    if correlation is None or abs(correlation) < abs(BACKWARDS):
        return None
    return correlation < 0.0


def bogie_runs_backwards(window: Window, partner: Window, ahead: float) -> bool | None:
    """Return whether a bogie runs with its rear axle first; None where its nodes do not say.

    Where they say both, one of them is the wrong way round, and which axle meets the track first decides.

    Args:
        window, partner: Of the two nodes of a bogie, over the same time, with as many samples.
        ahead: By how much the node of ``window`` is ahead of the other, m, by the registry; negative at the rear axle.
    """
    said = {runs_backwards(window), runs_backwards(partner)} - {None}
    if len(said) <= 1:
        return next(iter(said), None)
    rolls = axle_distance(window, partner, ahead)
    return None if rolls is None or rolls.leads is None else not rolls.leads


def turned_over(window: Window, behind: float = 0.0) -> Window:
    """Return the window of a vehicle that runs with its rear end first as one of a vehicle that runs forward.

    Args:
        behind: m, by which its axle is behind the reference of the vehicle's position by the registry. It is ahead of
            it now.
    """
    frame = window.frame_yaw_acceleration
    return replace(
        window,
        yaw_acceleration=-window.yaw_acceleration,
        frame_yaw_acceleration=None if frame is None else -frame,
        distance=window.distance + 2.0 * behind * (direction(window) or 1),
        backwards=not window.backwards,
    )

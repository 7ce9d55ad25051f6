"""One window to its motion relative to the track, or the reason why not: gates, checks, axes, position, gauge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.motion.checks import (
    check_axis_signs,
    check_moving,
    direction,
    jumps_reason,
    position_jumps,
    to_wheelset_axes,
)
from estimation.motion.gates import WindowParameters, gate
from estimation.motion.gauge_shift import gauge_shift
from estimation.motion.integration import IntegratedWindow, integrate
from estimation.motion.track_relative import motion
from estimation.motion.usable_samples import moving_samples
from estimation.values.motion import Motion
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Window

NO_ALIGNMENT = Reason(ReasonCode.ALIGNMENT_UNKNOWN, "the alignment of the track section is not known yet")


def window_motion(
    window: Window,
    track: TrackAlignment | None,
    parameters: WindowParameters,
    correction: Correction | None = None,
    misplaced: Reason | None = None,
    *,
    mounted_reversed: bool = False,
    layout: TrackLayout | None = None,
) -> Motion | Reason:
    """Return the motion of ``window`` relative to ``track``, or why the window is refused.

    Parameters
    ----------
    window
        Measured accelerations of one wheelset, (n,) each.
    track
        Alignment of its track section; None where none is on file, all NaN where that is of the gauge alone.
    parameters
        Gates, vehicle and filters.
    correction
        From the measured positions to the true ones; None where the measured ones are used.
    misplaced
        Why the position is not certain; None where it is.
    mounted_reversed
        The wheelset's left wheel is on the vehicle's right-hand side.
    layout
        Curves of the section, which are left out; None where none is on file.

    Returns
    -------
    (n,) samples of band-limited motion in the axes of the wheelset, or the refusal.
    """
    refused = gate(window.quality, window.track_section, parameters.gates)
    if refused is not None:
        return refused
    if track is None or not np.isfinite(track.alignment).any():
        return NO_ALIGNMENT
    if misplaced is not None:
        return misplaced
    integrated = _checked(window, parameters)
    if isinstance(integrated, Reason):
        return integrated
    integrated, track = to_wheelset_axes(integrated, track, direction(window), mounted_reversed=mounted_reversed)
    window = integrated.window
    if correction is not None:
        window = replace(window, distance=correction.at(window.distance))
    shift = gauge_shift(window, track, parameters.vehicle, parameters.signals, integrated)
    return motion(window, track, parameters.signals, layout, shift, integrated)


def _checked(window: Window, parameters: WindowParameters) -> IntegratedWindow | Reason:
    """Return the window integrated, or what of it contradicts the rest."""
    reason = check_moving(window, parameters.signals)
    if reason is None and direction(window) == 0:
        reason = Reason(ReasonCode.BOTH_DIRECTIONS, "the vehicle runs both ways along the section")
    if reason is not None:
        return reason
    integrated = integrate(window, moving_samples(window, parameters.signals), parameters.signals)
    return jumps_reason(position_jumps(integrated)) or check_axis_signs(integrated) or integrated

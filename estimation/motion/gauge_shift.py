"""By how much the gauge moves a wheelset along a window, from its rolling radius difference there."""

from __future__ import annotations

import numpy as np

from estimation.filters.local_cubic import local_cubic_kernel
from estimation.filters.smoothing_spline import remove_wander
from estimation.motion.integration import IntegratedWindow, integrate
from estimation.motion.parameters import SignalParameters
from estimation.motion.rolling_radius_difference import FusionParameters, fuse, motion_signals
from estimation.values.arrays import FloatArray
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window
from estimation.vehicle.equations_of_motion import VehicleParameters

CUTOFF_WAVELENGTH = 120.0  # m, wavelength of rL - rR; what is longer is small: -2 l r0 d''


def gauge_shift(
    window: Window,
    track: TrackAlignment,
    vehicle: VehicleParameters,
    parameters: SignalParameters,
    earlier: IntegratedWindow | None = None,
) -> FloatArray | None:
    """Return by how much the gauge moves the wheelset (n,), m, NaN where that is not known.

    None where nothing is known of it: on constant gauge, or of a wheelset of which the section has no findings.

    Parameters
    ----------
    window
        In the axes of the wheelset, at true positions.
    track
        Alignment with the gauge deviation and what was found of wheelsets.
    vehicle
        Parameters of Eq. 1 and Eq. 2, which turn motion into rL - rR.
    parameters
        Gates on gaps, length and speed.
    earlier
        The same accelerations and speeds, integrated before.
    """
    table = None if track.findings is None else track.findings.gauge_shifts.get(window.wheelset)
    if track.findings is None or table is None:
        return None
    fusion = FusionParameters()
    ends = fusion.step * (len(local_cubic_kernel(fusion.crossover, fusion.step)) // 2)
    more = track.findings.stiffness_ratio.get(window.vehicle, 1.0) - 1.0
    e = np.interp(window.distance, track.s, track.gauge_deviation, left=np.nan, right=np.nan)
    shift = np.full(len(window.valid), np.nan)
    with np.errstate(invalid="ignore"):
        usable = np.asarray(window.valid & np.isfinite(e) & (window.speed >= parameters.least_speed_m_s))
    for segment in integrate(window, usable, parameters, earlier=earlier).segments:
        part, run = segment.part, segment.run
        grid = fuse(motion_signals(segment, vehicle), vehicle, fusion)
        certain = (grid.run >= grid.run[0] + ends) & (grid.run <= grid.run[-1] - ends)
        if not certain.any():
            continue
        whole = (grid.difference + more * grid.stiffness_term)[None, :]
        (fast,) = remove_wander(np.where(certain, whole, 0.0), grid.run - grid.run[0], certain, CUTOFF_WAVELENGTH)
        known = segment.known & (run >= grid.run[0] + ends) & (run <= grid.run[-1] - ends)
        shift[part][known] = table.at(np.interp(run[known], grid.run, fast), e[part][known])
    return shift

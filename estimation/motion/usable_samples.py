"""Which samples of a window can be used, and what became of the others; curves, which are left out, among them.

In a curve the lateral accelerometers of wheelset and mass measure V^2 kappa - g theta, the acceleration that the cant
leaves uncompensated. An offset of the sensor looks the same, but does not change within a minute. What cannot be
detected: a window within a single curve, and a curve whose cant is that of the speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from estimation.motion.parameters import CurveLimits, SignalParameters
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackLayout
from estimation.values.windows import Window
from estimation.vehicle.equations_of_motion import GRAVITY

GRID_STEP = 1.0  # m, to which a layout is refined before it is looked at


def straight(distance: FloatArray, layout: TrackLayout, limits: CurveLimits) -> BoolArray:
    """Return which places (n,) are on track that is straight within ``limits``; places off the layout do not."""
    grid = np.union1d(np.arange(layout.s[0], layout.s[-1], GRID_STEP), layout.s)
    bent = (np.abs(np.interp(grid, layout.s, layout.curvature)) > limits.curvature) | (
        np.abs(np.interp(grid, layout.s, layout.cant)) > limits.cant
    )
    near = np.concatenate([[0], np.cumsum(bent)])
    on_layout = (distance >= layout.s[0]) & (distance <= layout.s[-1])
    at = np.where(np.isfinite(distance), distance, layout.s[0])
    first = np.searchsorted(grid, at - limits.margin, side="left")
    last = np.searchsorted(grid, at + limits.margin, side="right")
    return np.asarray(on_layout & (near[last] == near[first]))


MOST_AT_REST = 1.4  # m/s2, of a lateral accelerometer on straight track: its offset, and g times its angle


def check_upright(window: Window, usable: BoolArray) -> Reason | None:
    """Return that a lateral accelerometer is turned about the longitudinal axis; None where it is not.

    It then measures a part of gravity at rest: of 8 degrees 1.4 m/s2. Vertical motion is in its signal too, and cannot
    be taken out. Only sensors that measure constant accelerations show it.

    Args:
        usable: (n,) samples on straight track.
    """
    if not (window.measures_gravity and usable.any()):
        return None
    places = {"axle box": window.lateral_acceleration, "mass or frame": window.mass_lateral_acceleration}
    means = {name: float(np.mean(values[usable])) for name, values in places.items()}
    name = max(means, key=lambda place: abs(means[place]))
    if abs(means[name]) <= MOST_AT_REST:
        return None
    angle = np.degrees(np.arcsin(min(abs(means[name]) / GRAVITY, 1.0)))
    return Reason(
        ReasonCode.SENSOR_TURNED,
        f"the lateral accelerometer of the {name} measures {means[name]:+.1f} m/s2 on average, like one that is turned"
        f" by {angle:.0f} degrees; at most {MOST_AT_REST:g} m/s2 may be its offset; check its mounting, and its offset"
        " in the mapping of the bus",
    )


MEAN_S = 5.0  # over which the motion of the wheelset averages out

LEAST_SHARE = 0.5  # of the samples that a mean needs


def detect_uncompensated_acceleration(
    window: Window, usable: BoolArray, max_cant_deficiency_change: float
) -> Reason | None:
    """Return that the window shows a curve; None where it does not."""
    spread = cant_deficiency_acceleration_range(window, usable)
    if spread <= max_cant_deficiency_change:
        return None
    return Reason(
        ReasonCode.CURVE_DETECTED,
        f"a curve is detected and no layout is stored: the slow lateral acceleration changes by {spread:.2f} m/s2,"
        f" at most {max_cant_deficiency_change:g} may be drift; register the layout of the section",
    )


def cant_deficiency_acceleration_range(window: Window, usable: BoolArray) -> float:
    """Return by how much the slow lateral acceleration of wheelset and mass together changes in a window, m/s2."""
    size = round(MEAN_S / window.sample_interval_s)
    count = len(usable) // size
    known = usable[: count * size].reshape(count, size)
    lateral = 0.5 * (window.lateral_acceleration + window.mass_lateral_acceleration)[: count * size].reshape(
        count, size
    )
    enough = known.mean(axis=1) >= LEAST_SHARE
    if not enough.any():
        return 0.0
    means = np.where(known, lateral, 0.0).sum(axis=1)[enough] / known.sum(axis=1)[enough]
    return float(np.ptp(means))


def straight_part(window: Window, layout: TrackLayout | None, parameters: SignalParameters) -> Window | Reason:
    """Return the window with the samples in curves not valid, or why nothing is left.

    Args:
        layout: Curves of the section; None where none is on file: then a window that shows a curve is refused.
    """
    if layout is None:
        running = window.valid & fast_enough(window, parameters)
        curve = detect_uncompensated_acceleration(window, running, parameters.max_cant_deficiency_change)
        return check_upright(window, running) or curve or window
    left = window.valid & straight(window.distance, layout, parameters.curve_limits)
    if not left.any() and window.valid.any():
        return Reason(ReasonCode.IN_CURVES, "all of the window is in curves")
    return check_upright(window, left) or replace(window, valid=left)


def fast_enough(window: Window, parameters: SignalParameters) -> BoolArray:
    """Return the samples (n,) of known speed at which the vehicle runs fast enough to be measured."""
    return np.asarray(window.speed >= parameters.least_speed_m_s)


def moving_samples(window: Window, parameters: SignalParameters) -> BoolArray:
    """Return the valid samples (n,) at known positions at which the vehicle runs fast enough."""
    return window.valid & np.isfinite(window.distance) & fast_enough(window, parameters)


@dataclass(frozen=True, slots=True)
class Usable(FrozenArrays):
    """Samples that can be used (n,), and the share of all samples that was lost by each cause, counted once."""

    samples: Annotated[BoolArray, "n"]
    lost: Mapping[str, float]

    @property
    def causes(self) -> str:
        """What was lost and why, the largest share first."""
        ordered = sorted(self.lost.items(), key=lambda item: -item[1])
        return ", ".join(f"{share:.0%} {cause}" for cause, share in ordered if share > 0)


def usable_samples(
    window: Window, known: BoolArray, layout: TrackLayout | None, parameters: SignalParameters
) -> Usable:
    """Return the samples of ``window`` that can be used.

    Args:
        known: (n,) samples at places of known alignment.
        layout: Curves of its section; None where none is on file: then every place counts as straight.
    """
    tests = {
        "missing, clipped or invalid": window.valid,
        "off the known part of the section": known,
        f"slower than {parameters.least_speed_m_s:g} m/s": fast_enough(window, parameters),
    }
    if layout is not None:
        tests["in curves"] = straight(window.distance, layout, parameters.curve_limits)
    left, lost = np.ones(len(window.valid), dtype=np.bool_), {}
    for cause, passed in tests.items():
        lost[cause] = float((left & ~passed).mean())
        left &= passed
    return Usable(left, lost)

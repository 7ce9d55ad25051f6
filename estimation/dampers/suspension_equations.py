"""How what is above the wheelsets moves with them: a linear system of the deflections of the suspension.

The mean of the lateral accelerations of the wheelsets is the input u, that above them what follows. In a bogie the
frame's yaw drops out of the means. With d = y_f - mean y_i and e = y_b - y_f::

    m_f y_f'' = -a (ky d + fy d') + ks e + cs e'      a wheelsets, frame (f) and body (b), cs the damper looked for
    d'' = y_f'' - u,      e'' = -(ks e + cs e')/m_b - y_f''

and of a single wheelset mm ym'' = -(ky d + fy d') with d = ym - y, fy the damper looked for (Eq. 3 and 4 of
``estimation.vehicle.regressors``). No creep force, contact geometry, track or speed is in these equations.

The low-pass that accelerations get before the filters, and how they are thinned out.

What bodies and bogie frames do as stiff bodies is below some 8 Hz, and the vibration of axle boxes above. Wheelsets and
what is above them get the same filter, which the equations do not notice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import numpy as np

from estimation.dampers.parameters import DAMPING
from estimation.values.arrays import FloatArray, FrozenArrays, frozen_array
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, BogieParameters, VehicleClass, VehicleParameters

SINGLE_UNCERTAIN = {"lateral_stiffness": "suspended_mass"}
BOGIE_UNCERTAIN = {
    "lateral_stiffness": "frame_mass",
    "lateral_damping": "frame_mass",
    "secondary_lateral_stiffness": "body_mass",
    "body_mass": "frame_mass",
}
"""Parameters beside the damper, each over the mass that accelerations show it with."""


@dataclass(frozen=True, slots=True)
class SuspensionEquations(FrozenArrays):
    """Rates of n deflections and their rates by themselves and by u; the acceleration above; SI."""

    rates: Annotated[FloatArray, "n", "n"]
    by_input: Annotated[FloatArray, "n"]
    measured: Annotated[FloatArray, "n"]  # acceleration above by the states


def uncertain_parameters(vehicle_class: VehicleClass) -> Mapping[str, float]:
    """Return the relative standard deviation of each parameter but the damper, over a mass, by the name of its field.

    Accelerations show ratios alone, and each mode follows from one of them: that of the body from its spring over its
    mass, whatever that is over the frame's.
    """
    ratios = SINGLE_UNCERTAIN if vehicle_class.bogie is None else BOGIE_UNCERTAIN
    return {
        name: float(np.hypot(vehicle_class.std_of(name), vehicle_class.std_of(mass))) for name, mass in ratios.items()
    }


def nominal_damping(vehicle_class: VehicleClass) -> float:
    """Return the damping on file of the damper that is looked for, N s/m."""
    bogie = vehicle_class.bogie
    return vehicle_class.parameters.lateral_damping if bogie is None else bogie.secondary_lateral_damping


def mass_std(vehicle_class: VehicleClass) -> float:
    """Return the relative std of the mass that follows the wheelsets: accelerations show damping over mass."""
    return vehicle_class.std_of("suspended_mass" if vehicle_class.bogie is None else "frame_mass")


def suspension_equations(
    vehicle_class: VehicleClass, share: float, factors: Mapping[str, float]
) -> SuspensionEquations:
    """Return the equations of a running gear whose damper has a share of the damping on file.

    Args:
        factors: By which other parameters differ from the class, by the names of their fields; with the mass of the
            body its spring does too.
    """
    p, bogie = vehicle_class.parameters, vehicle_class.bogie
    p = replace(p, **{name: value * getattr(p, name) for name, value in factors.items() if hasattr(p, name)})
    if bogie is None:
        above = -np.array([p.lateral_stiffness, share * p.lateral_damping]) / p.suspended_mass
        return SuspensionEquations(np.array([[0.0, 1.0], above]), np.array([0.0, -1.0]), above)
    body = factors.get("body_mass", 1.0)
    spring = body * factors.get("secondary_lateral_stiffness", 1.0) * bogie.secondary_lateral_stiffness
    changed = replace(bogie, body_mass=body * bogie.body_mass, secondary_lateral_stiffness=spring)
    return _bogie(p, changed, share)


def _bogie(p: VehicleParameters, bogie: BogieParameters, share: float) -> SuspensionEquations:
    secondary = np.array([0.0, 0.0, bogie.secondary_lateral_stiffness, share * bogie.secondary_lateral_damping])
    primary = -AXLES_OF_A_BOGIE * np.array([p.lateral_stiffness, p.lateral_damping, 0.0, 0.0])
    frame = (primary + secondary) / bogie.frame_mass
    rates = np.zeros((4, 4))
    rates[0, 1] = rates[2, 3] = 1.0
    rates[1], rates[3] = frame, -secondary / bogie.body_mass - frame
    return SuspensionEquations(rates, np.array([0.0, -1.0, 0.0, 0.0]), frame)


def stride_of(sample_interval_s: float) -> int:
    """Return of how many samples one is kept."""
    return max(round(DAMPING.step_s / sample_interval_s), 1)


@lru_cache(maxsize=4)
def low_pass(sample_interval_s: float) -> FloatArray:
    """Return the taps (k,) of the low-pass, odd in number and symmetric."""
    from scipy.signal import firwin, kaiserord  # noqa: PLC0415 - slow to import, and few need it

    count, beta = kaiserord(DAMPING.stop_db, 2.0 * sample_interval_s * (DAMPING.stop_hz - DAMPING.pass_hz))
    corner = 0.5 * (DAMPING.pass_hz + DAMPING.stop_hz)
    taps = firwin(count | 1, corner, window=("kaiser", beta), fs=1.0 / sample_interval_s)
    return frozen_array(taps, (None,), name="taps")


def thinned(values: FloatArray, sample_interval_s: float) -> FloatArray:
    """Return the low-passed samples (s,) at which the filter sees measured values alone."""
    from scipy.signal import oaconvolve  # noqa: PLC0415 - slow to import, and few need it

    passed = oaconvolve(values, low_pass(sample_interval_s), mode="valid")
    return np.asarray(passed[:: stride_of(sample_interval_s)])


def between_samples(values: FloatArray) -> FloatArray:
    """Return what, run straight from sample to sample, is the signal: a straight line takes (pi f dt)^2/3 of it."""
    raised = values.copy()
    raised[1:-1] -= np.diff(values, 2) / 12.0
    return raised

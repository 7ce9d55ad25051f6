"""The rolling radius difference down to long wavelengths, from the yaw sensor and from the lateral motion.

The yaw sensor gives R = rL - rR by Eq. 2, but its offset and noise, integrated twice, drown it beyond some 20 m of
wavelength. There a wheelset rolls where it points: by Eq. 1 the yaw angle is

    psi = (y' + r0 phi') / V + (m y'' + (2 f23/V) psi' + W phi + mm ym'') / (2 f22) + g R

where g R stands for the gravitational stiffness, (W/2 - f23/r0) D / (2 f22), with the contact angle difference D in
proportion to R. The lateral sensors are integrated once for it instead of twice, and the correction is small, so its
uncertain parameters hardly matter. g is estimated from wavelengths at which both are good.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.filters.local_cubic import smoother, without_slow_part
from estimation.motion.integration import running_integrals
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.windows import Window
from estimation.vehicle.equations_of_motion import VehicleParameters


@dataclass(frozen=True, slots=True)
class FusionParameters:
    """Where the two meet; wavelengths in m."""

    step: float = 0.25
    crossover: float = 15.0  # longer wavelengths come from the lateral motion
    compared: tuple[float, float] = (8.0, 40.0)  # in which g is estimated
    margin: float = 45.0  # m at each end that is not compared
    gravity: float = -0.2  # g known beforehand, 1/m
    gravity_weight: float = 1.6e-4  # m2: squares of the regressor that the knowledge beforehand is worth


@dataclass(frozen=True, slots=True)
class Felt:
    """Of one stretch of one wheelset, sample by sample (n,), in order of running; slow parts meaningless."""

    run: FloatArray  # m, increasing
    speed: FloatArray  # V, m/s
    displacement: FloatArray  # y, m
    difference: FloatArray  # R by Eq. 2, m
    elastic: FloatArray  # its part that scales with yaw stiffness over creep coefficient, m
    yaw: FloatArray  # psi by Eq. 1 without g R, rad


@dataclass(frozen=True, slots=True)
class Fused:
    """The same on a uniform grid of distance."""

    run: FloatArray  # (m,) m
    displacement: FloatArray  # (m,) m
    difference: FloatArray  # (m,) m
    elastic: FloatArray  # (m,) m


def fused(felt: Felt, vehicle: VehicleParameters, parameters: FusionParameters) -> Fused:
    """Return y, R and the elastic part of R on a grid; short waves of R from the yaw sensor, long ones from Eq. 1."""
    step = parameters.step
    run = np.arange(np.ceil(felt.run[0] / step), np.floor(felt.run[-1] / step) + 1) * step
    V, y, R, elastic, ψ = (
        np.interp(run, felt.run, values)
        for values in (felt.speed, felt.displacement, felt.difference, felt.elastic, felt.yaw)
    )
    gravity = _gravity(R, ψ, V, vehicle, parameters)
    for_two_rounds = ψ
    for _ in range(2):
        for_two_rounds = ψ + gravity * _difference(for_two_rounds, V, vehicle, step)
    slow = for_two_rounds
    weights = smoother(parameters.crossover, step)
    return Fused(
        run=np.asarray(run, dtype=np.float64),
        displacement=y,
        difference=_joined(R, _difference(slow, V, vehicle, step), weights),
        elastic=_joined(elastic, _elastic(slow, V, vehicle, step), weights),
    )


def _joined(fast: FloatArray, slow: FloatArray, weights: FloatArray) -> FloatArray:
    return np.asarray(without_slow_part(fast, weights) + slow - without_slow_part(slow, weights))


def _elastic(yaw: FloatArray, V: FloatArray, p: VehicleParameters, step: float) -> FloatArray:
    bend = np.gradient(np.gradient(yaw, step), step)
    moment = p.yaw_inertia * V * V * bend + p.yaw_stiffness * yaw
    return np.asarray(-moment * p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient))


def _difference(yaw: FloatArray, V: FloatArray, p: VehicleParameters, step: float) -> FloatArray:
    """Return R (m,) of a yaw angle over distance by Eq. 2, its small terms left out."""
    rolling = -2 * p.half_contact_distance * p.nominal_radius * np.gradient(yaw, step)
    return np.asarray(rolling + _elastic(yaw, V, p, step))


def _gravity(
    R: FloatArray, ψ: FloatArray, V: FloatArray, vehicle: VehicleParameters, parameters: FusionParameters
) -> float:
    """Return g, 1/m, that brings R of the lateral motion to R of the yaw sensor where both are good."""
    step = parameters.step
    margin = int(parameters.margin / step)
    if len(R) <= 3 * margin:
        return parameters.gravity
    short, long = (smoother(wavelength, step) for wavelength in parameters.compared)
    lateral = _difference(ψ, V, vehicle, step)
    both = np.stack([_difference(lateral, V, vehicle, step), R - lateral])
    regressor, target = (without_slow_part(both, long) - without_slow_part(both, short))[:, margin:-margin]
    known = parameters.gravity_weight
    return float((regressor @ target + known * parameters.gravity) / (regressor @ regressor + known))


def felt_along(window: Window, known: BoolArray, part: slice, p: VehicleParameters, run: FloatArray) -> Felt:
    """Return y, the measured R (Eq. 2 solved for rL - rR with S = 2 r0, the contact angle terms left out) and psi.

    Parameters
    ----------
    window
        Measured accelerations and speed.
    known
        (m,) which samples of the stretch are usable.
    part
        The stretch.
    p
        Parameters of Eq. 1 and Eq. 2.
    run
        (m,) m, increasing.
    """
    accelerations, rates, displacements = running_integrals(window, known, part)
    V = np.interp(np.arange(len(known)), np.flatnonzero(known), window.speed[part][known])
    y, ψ, φ = displacements[:3]
    dy, dψ, dφ = rates[:3]
    f11, f23, l = p.longitudinal_creep_coefficient, p.lateral_spin_creep_coefficient, p.half_contact_distance  # noqa: E741 - the paper's l
    rolling_velocity = dy + p.nominal_radius * dφ
    elastic = p.yaw_inertia * accelerations[1] + p.yaw_stiffness * ψ + p.yaw_damping * dψ
    moment = (
        elastic
        + (p.pitch_inertia * V / p.nominal_radius) * dφ
        + (2 * l**2 * f11 / V) * dψ
        - (2 * f23 / V) * (rolling_velocity - V * ψ)
    )
    force = (
        p.wheelset_mass * accelerations[0]
        + (2 * f23 / V) * dψ
        + p.load * φ
        + p.suspended_mass * accelerations[3]  # what the suspension takes up
    )
    per_moment = -p.nominal_radius / (l * f11)
    return Felt(
        run=run,
        speed=V,
        displacement=y,
        difference=np.asarray(per_moment * moment),
        elastic=np.asarray(per_moment * elastic),
        yaw=np.asarray(rolling_velocity / V + force / (2 * p.lateral_creep_coefficient)),
    )

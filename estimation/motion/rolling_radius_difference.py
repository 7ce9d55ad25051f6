"""The rolling radius difference down to long wavelengths, from the yaw sensor and from the lateral motion.

The yaw sensor gives R = rL - rR by Eq. 2, but its offset and noise, integrated twice, drown it beyond some 20 m of
wavelength. There a wheelset rolls where it points: by Eq. 1 the yaw angle is

    psi = (y' + r0 phi') / V + (m y'' + (2 f23/V) psi' + W phi + mm ym'') / (2 f22) + g R

where g R stands for the gravitational stiffness, (W/2 - f23/r0) D / (2 f22), with the contact angle difference D in
proportion to R. The lateral sensors are integrated once for it instead of twice, and the correction is small, so its
uncertain parameters hardly matter. g is estimated from wavelengths at which both are good. In a bogie the yaw spring
makes g R as large as R: see :func:`long_waves_in_bogie`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.compiled import compiled
from estimation.filters import high_pass, local_cubic_kernel
from estimation.motion.integration import IntegratedSegment, observed_displacement
from estimation.values.arrays import FloatArray
from estimation.vehicle.regressors import angle_difference_factor
from estimation.vehicle.vehicle_class import VehicleParameters


@compiled(nogil=True)
def sample_smoothed(
    signals: FloatArray, at: FloatArray, first: int, count: int, finer: int, step: float, weights: FloatArray
) -> FloatArray:
    """Return signals (m, count) at every ``finer``-th point, from ``first``, of a grid of ``step`` m, smoothed on it.

    Between samples signals are straight, beyond their ends as at these.
    """
    m, n = signals.shape
    taps = len(weights)
    points = finer * (count - 1) + taps
    found = np.empty((m, count))
    fine = np.empty((m, points))
    below = 0
    for k in range(points):
        x = (first - taps // 2 + k) * step
        while below < n - 2 and at[below + 1] <= x:
            below += 1
        if x <= at[0]:
            fine[:, k] = signals[:, 0]
        elif x >= at[n - 1]:
            fine[:, k] = signals[:, n - 1]
        else:
            share = (x - at[below]) / (at[below + 1] - at[below])
            for a in range(m):
                fine[a, k] = signals[a, below] + share * (signals[a, below + 1] - signals[a, below])
    for a in range(m):
        row = fine[a]
        for j in range(count):
            start = finer * j
            even, odd = 0.0, 0.0  # two sums: each addition need not wait for the one before
            for w in range(0, taps - 1, 2):
                even += weights[w] * row[start + w]
                odd += weights[w + 1] * row[start + w + 1]
            found[a, j] = even + odd + weights[taps - 1] * row[start + taps - 1]
    return found


@dataclass(frozen=True, slots=True)
class FusionParameters:
    """How roll and yaw become one rolling radius difference."""

    # where the two meet
    grid_step: float = 0.25  # m, of the grid
    oversampling: int = 5  # samples per step before short waves are taken out
    shortest_waves: tuple[float, float] = (0.5, 2.0)  # m, half remains: quiet axle boxes, vibrating ones
    vibration_angle: float = 0.08e-3  # rad of (y' + r0 phi')/V in waves shorter than 2 m; quiet axle boxes have half
    crossover_wavelength: float = 15.0  # m: longer wavelengths come from the lateral motion
    compared_waves: tuple[float, float] = (8.0, 40.0)  # m, in which g is estimated
    end_margin: float = 45.0  # m at each end that is not compared
    prior_gravity: float = -0.2  # g known beforehand, 1/m
    prior_weight: float = 1.6e-4  # m2: squares of the regressor that the knowledge beforehand is worth
    angle_per_radius: float = 112.0  # 1/m: contact angle difference over rolling radius difference of usual pairs
    least_divisor: float = 0.5  # of the factors known beforehand


FUSED = FusionParameters()


def long_waves_in_bogie(
    R: FloatArray, rolling: FloatArray, creep: FloatArray, frame: FloatArray, V: FloatArray, p: VehicleParameters
) -> tuple[FloatArray, FloatArray]:
    """Return R and its stiffness term (m,), m, of the lateral motion of a wheelset in a bogie.

    Args:
        R: (m,) by the yaw sensor.
        rolling, creep, frame: (m,) rad: (y' + r0 phi') / V, what the lateral creep adds without g R, yaw of the frame.
    """
    per_moment = -p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
    per_slope = -2 * p.half_contact_distance * p.nominal_radius
    inertia = p.yaw_inertia * V * V * _bend(rolling)
    terms = np.stack(
        [
            per_slope * np.gradient(rolling, FUSED.grid_step),
            per_moment * (p.yaw_stiffness * (rolling - frame) + inertia),
            per_moment * p.yaw_stiffness * creep,
        ]
    )
    slow = np.asarray(_factors(R, terms, per_moment, p) @ terms)
    return slow, np.asarray(slow - per_slope * np.gradient(rolling + creep, FUSED.grid_step))


def _factors(R: FloatArray, terms: FloatArray, per_moment: float, p: VehicleParameters) -> FloatArray:
    """Return the factors (3,) of the terms (3, m) that bring them to R (m,) where both are good."""
    gravity = -0.5 * FUSED.angle_per_radius * angle_difference_factor(p) / p.lateral_creep_coefficient
    expected = np.full(len(terms), 1.0 / max(1.0 - per_moment * p.yaw_stiffness * gravity, FUSED.least_divisor))
    band = _compared(np.concatenate([terms, R[None, :]]))
    if band is None:
        return expected
    design, target = band[:-1], band[-1]
    normal = design @ design.T + FUSED.prior_weight * np.eye(len(terms))
    return np.asarray(np.linalg.solve(normal, design @ target + FUSED.prior_weight * expected))


def _compared(rows: FloatArray) -> FloatArray | None:
    """Return rows (k, m) in the wavelengths at which both are good; None where the pass is too short."""
    margin = int(FUSED.end_margin / FUSED.grid_step)
    if rows.shape[1] <= 3 * margin:
        return None
    short, long = (local_cubic_kernel(wavelength, FUSED.grid_step) for wavelength in FUSED.compared_waves)
    return np.asarray((high_pass(rows, long) - high_pass(rows, short))[:, margin:-margin])


def _bend(yaw: FloatArray) -> FloatArray:
    return np.asarray(np.gradient(np.gradient(yaw, FUSED.grid_step), FUSED.grid_step))


@dataclass(frozen=True, slots=True)
class MotionSignals:
    """Signals of one segment of one wheelset, sample by sample (n,), in order of running; slow parts meaningless."""

    run: FloatArray  # m, increasing
    speed: FloatArray  # V, m/s
    displacement: FloatArray  # y, m: at rail level where the track may roll, else of the axle
    difference: FloatArray  # R by Eq. 2, m
    stiffness_term: FloatArray  # its part that scales with yaw stiffness over creep coefficient, m
    rolling_yaw: FloatArray  # (y' + r0 phi') / V, rad: psi of a wheelset without lateral creep
    creep_yaw: FloatArray  # rad: what the lateral creep of Eq. 1 adds, without g R
    frame_yaw: FloatArray | None = None  # rad, of the bogie frame; None without a bogie


@dataclass(frozen=True, slots=True)
class FusedSignals:
    """The same on a uniform grid of distance."""

    run: FloatArray  # (m,) m
    displacement: FloatArray  # (m,) m
    difference: FloatArray  # (m,) m
    stiffness_term: FloatArray  # (m,) m


def fuse(signals: MotionSignals, vehicle: VehicleParameters) -> FusedSignals:
    """Return y, R and its stiffness term on a grid; short waves of R from the yaw sensor, long ones from Eq. 1."""
    step = FUSED.grid_step
    run = np.arange(np.ceil(signals.run[0] / step), np.floor(signals.run[-1] / step) + 1) * step
    shortest = _shortest(signals, run)
    sampled = [
        signals.speed,
        signals.displacement,
        signals.difference,
        signals.stiffness_term,
        signals.rolling_yaw,
        signals.creep_yaw,
        *(() if signals.frame_yaw is None else (signals.frame_yaw,)),
    ]
    V, y, R, stiffness_term, *yaws = _sampled(np.stack(sampled), signals.run, run, shortest)
    if signals.frame_yaw is None:
        slow = _long_waves(R, np.asarray(yaws[0] + yaws[1]), V, vehicle)
    else:
        slow = long_waves_in_bogie(R, yaws[0], yaws[1], yaws[2], V, vehicle)
    weights = local_cubic_kernel(FUSED.crossover_wavelength, FUSED.grid_step)
    return FusedSignals(
        run=np.asarray(run, dtype=np.float64),
        displacement=y,
        difference=_joined(R, slow[0], weights),
        stiffness_term=_joined(stiffness_term, slow[1], weights),
    )


def _shortest(signals: MotionSignals, run: FloatArray) -> float:
    """Return the shortest wavelength, m, that is left in the signals of a pass."""
    # An axle box vibrates at tens of hertz. Sampled as it is, its vibration would look like waves of some metres. Where
    # it does not vibrate the short waves of R are those of contact jumps, which the curves need.
    quiet, vibrating = FUSED.shortest_waves
    (smooth,) = _sampled(signals.rolling_yaw[None], signals.run, run, vibrating)
    rest = np.interp(run, signals.run, signals.rolling_yaw) - smooth
    return vibrating if float(np.std(rest)) > FUSED.vibration_angle else quiet


def _sampled(values: FloatArray, at: FloatArray, run: FloatArray, shortest: float) -> FloatArray:
    """Return values (s, n) at distances (n,) on the grid (s, m), waves shorter than ``shortest`` (m) taken out."""
    step, first = FUSED.grid_step / FUSED.oversampling, FUSED.oversampling * round(run[0] / FUSED.grid_step)
    weights = local_cubic_kernel(shortest, step)
    return sample_smoothed(values, np.asarray(at, dtype=np.float64), first, len(run), FUSED.oversampling, step, weights)


def _long_waves(
    R: FloatArray, ψ: FloatArray, V: FloatArray, vehicle: VehicleParameters
) -> tuple[FloatArray, FloatArray]:
    gravity = _gravity(R, ψ, V, vehicle)
    slow = ψ
    for _ in range(2):
        slow = ψ + gravity * _difference(slow, V, vehicle)
    return _difference(slow, V, vehicle), _stiffness_term(slow, V, vehicle)


def _joined(fast: FloatArray, slow: FloatArray, weights: FloatArray) -> FloatArray:
    return np.asarray(high_pass(fast, weights) + slow - high_pass(slow, weights))


def _stiffness_term(yaw: FloatArray, V: FloatArray, p: VehicleParameters) -> FloatArray:
    moment = p.yaw_inertia * V * V * _bend(yaw) + p.yaw_stiffness * yaw
    return np.asarray(-moment * p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient))


def _difference(yaw: FloatArray, V: FloatArray, p: VehicleParameters) -> FloatArray:
    """Return R (m,) of a yaw angle over distance by Eq. 2, its small terms left out."""
    rolling = -2 * p.half_contact_distance * p.nominal_radius * np.gradient(yaw, FUSED.grid_step)
    return np.asarray(rolling + _stiffness_term(yaw, V, p))


def _gravity(R: FloatArray, ψ: FloatArray, V: FloatArray, vehicle: VehicleParameters) -> float:
    """Return g, 1/m, that brings R of the lateral motion to R of the yaw sensor where both are good."""
    lateral = _difference(ψ, V, vehicle)
    band = _compared(np.stack([_difference(lateral, V, vehicle), R - lateral]))
    if band is None:
        return FUSED.prior_gravity
    regressor, target = band
    weight = FUSED.prior_weight
    return float((regressor @ target + weight * FUSED.prior_gravity) / (regressor @ regressor + weight))


def motion_signals(segment: IntegratedSegment, p: VehicleParameters, run: FloatArray | None = None) -> MotionSignals:
    """Return y, the measured R (Eq. 2 solved for rL - rR with S = 2 r0, the contact angle terms left out) and psi.

    The suspension of a bogie acts between wheelset and frame, whose motion the mass sensor and the frame's yaw give.

    Args:
        run: (m,) m, increasing: by default the distance run since the start of the segment.
    """
    accelerations, V = segment.accelerations, segment.speed
    y, ψ, φ = segment.displacements[:3]
    dy, dψ, dφ = segment.rates[:3]
    f11, f23, l = p.longitudinal_creep_coefficient, p.lateral_spin_creep_coefficient, p.half_contact_distance  # noqa: E741 - the paper's l
    rolling_velocity = dy + p.nominal_radius * dφ
    deflection, deflection_rate = ψ, dψ
    suspension_force = -p.suspended_mass * accelerations[3]
    if segment.frame_yaw is not None:
        deflection, deflection_rate = ψ - segment.frame_yaw[2], dψ - segment.frame_yaw[1]
        suspension_force = p.lateral_stiffness * (segment.displacements[3] - y)
        suspension_force = suspension_force + p.lateral_damping * (segment.rates[3] - dy)
    stiffness_term = p.yaw_inertia * accelerations[1] + p.yaw_stiffness * deflection + p.yaw_damping * deflection_rate
    moment = (
        stiffness_term
        + (p.pitch_inertia * V / p.nominal_radius) * dφ
        + (2 * l**2 * f11 / V) * dψ
        - (2 * f23 / V) * (rolling_velocity - V * ψ)
    )
    force = p.wheelset_mass * accelerations[0] + (2 * f23 / V) * dψ + p.load * φ - suspension_force
    per_moment = -p.nominal_radius / (l * f11)
    return MotionSignals(
        run=segment.run if run is None else run,
        speed=V,
        # without roll of the track y needs no roll, which is measured with more noise: a curve h(R) is turned round in
        # the displacement that it was found in, and d is the same
        displacement=observed_displacement(y, φ, p.nominal_radius, level=True) if segment.level else y,
        difference=np.asarray(per_moment * moment),
        stiffness_term=np.asarray(per_moment * stiffness_term),
        rolling_yaw=np.asarray(rolling_velocity / V),
        creep_yaw=np.asarray(force / (2 * p.lateral_creep_coefficient)),
        frame_yaw=None if segment.frame_yaw is None else segment.frame_yaw[2],
    )

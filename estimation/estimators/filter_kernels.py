"""Compiled filters of one block: extended Kalman-Bucy with augmented state, and Rao-Blackwellised particles.

Both have the kinematics of a wheelset whose fast creep modes have died out (Eq. 1 and 2 solved for the rates)::

    psi' = -V R(y - d) / (2 l r0) + known_rate          known_rate: what the measured moments make
    (y - d)' = V psi + lateral_rate - d'                d' is white noise

and measure psi and y - d. A step takes psi first, then y - d with the new psi, which keeps an oscillation as it is.
"""

from __future__ import annotations

import math

import numpy as np

from estimation.compiled import compiled
from estimation.estimators.parameters import RIVALS
from estimation.values.arrays import FloatArray
from estimation.values.units import MILLIMETRE

ALIGNMENT = RIVALS.alignment_intensity
YAW_RATE = RIVALS.yaw_rate_intensity
YAW = RIVALS.yaw_std
RENEWED = RIVALS.renewed_stds
MOVED = RIVALS.moved_share
COOLING = RIVALS.least_spread_share


@compiled(nogil=True, error_model="numpy")
def renew(mean: FloatArray, P: FloatArray, displacement: float, yaw: float) -> None:
    """Begin y - d and psi, the first of a state (k,) and (k, k), again from what is measured, and keep the rest."""
    mean[0], mean[1] = displacement, yaw
    for row in range(2):
        P[row, :] = 0.0
        P[:, row] = 0.0
        P[row, row] = RENEWED[row] ** 2


@compiled(nogil=True, error_model="numpy")
def correct(mean: FloatArray, P: FloatArray, part: int, measured: float, variance: float) -> tuple[float, float]:
    """Correct a state (k,) and (k, k) by a measured part of it; return the innovation and its variance."""
    innovation, total = measured - mean[part], P[part, part] + variance
    size = len(mean)
    for a in range(size):
        mean[a] += P[a, part] / total * innovation
    for a in range(size):
        for b in range(size if a != part else 0):
            if b != part:
                P[a, b] -= P[a, part] * P[part, b] / total
    left = variance / total
    for a in range(size):
        P[a, part] *= left
        if a != part:
            P[part, a] *= left
    return innovation, total


@compiled(nogil=True, error_model="numpy")
def extended(
    step_s: FloatArray, speed: FloatArray, displacement: FloatArray, yaw: FloatArray, known_rate: FloatArray,
    lateral_rate: FloatArray, noise: float, lever: float, mean: FloatArray, P: FloatArray,
) -> float:  # fmt: skip
    """Filter a block; R is a polynomial of y - d in mm, whose coefficients (m) are the state behind y - d and psi.

    Args:
        step_s, speed, displacement, yaw, known_rate, lateral_rate: (n,) each, as ``block_filters.Inputs`` has them.
        noise, lever: Std of y - d, m; 2 l r0, m2.
        mean, P: (2 + m,) and (2 + m, 2 + m), the prior; changed to the posterior.
    """
    squares, count, size = 0.0, 0, len(mean)
    for i in range(len(step_s)):
        dt = step_s[i]
        if dt == 0.0:
            renew(mean, P, displacement[i], yaw[i])
            continue
        V, u = 0.5 * (speed[i] + speed[i - 1]), mean[0] / MILLIMETRE
        R, slope, power = 0.0, 0.0, 1.0
        turn = -dt * V / lever
        for j in range(2, size):
            R += mean[j] * power
            if j + 1 < size:
                slope += (j - 1) * power * mean[j + 1] / MILLIMETRE
            power *= u
        for b in range(size):
            P[1, b] += turn * slope * P[0, b]
            power = turn
            for j in range(2, size):
                P[1, b] += power * P[j, b]
                power *= u
        for b in range(size):
            P[b, 1] += turn * slope * P[b, 0]
            power = turn
            for j in range(2, size):
                P[b, 1] += power * P[b, j]
                power *= u
        P[1, 1] += YAW_RATE * dt
        mean[1] += turn * R + dt * 0.5 * (known_rate[i] + known_rate[i - 1])
        run_on(mean, P, dt, V, 0.5 * (lateral_rate[i] + lateral_rate[i - 1]))
        innovation, total = correct(mean, P, 1, yaw[i], YAW * YAW)
        squares += innovation * innovation / total
        count += 1
        correct(mean, P, 0, displacement[i], noise * noise)
    return squares / max(count, 1)


@compiled(nogil=True, error_model="numpy")
def run_on(mean: FloatArray, P: FloatArray, dt: float, V: float, lateral_rate: float) -> None:
    """Let y - d run on by a step of ``dt`` s with psi as it is now."""
    mean[0] += dt * (V * mean[1] + lateral_rate)
    for b in range(len(mean)):
        P[0, b] += dt * V * P[1, b]
    for b in range(len(mean)):
        P[b, 0] += dt * V * P[b, 1]
    P[0, 0] += ALIGNMENT * V * dt


@compiled(nogil=True, error_model="numpy")
def particles(
    step_s: FloatArray, speed: FloatArray, displacement: FloatArray, yaw: FloatArray, known_rate: FloatArray,
    lateral_rate: FloatArray, noise: float, lever: float, slope: FloatArray, mean: FloatArray, P: FloatArray,
    draws: FloatArray,
) -> float:  # fmt: skip
    """Filter a block with particles over the slope of R; y - d, psi and the offset of R have a Kalman filter in each.

    Particles that have become unlikely are replaced by copies of likely ones, each moved by some of their spread.

    Args:
        slope: (q,) R per y - d, changed.
        mean, P: (q, 3) and (q, 3, 3), changed.
        draws: (r, 1 + q) one number between 0 and 1, then normal ones: used row by row, in turn.
    """
    q, squares, count, resampled = len(slope), 0.0, 0, 0
    weight, likelihood = np.full(q, 1.0 / q), np.empty(q)
    square, apart = np.empty(q), slope[1] - slope[0] if q > 1 else 0.0
    for i in range(len(step_s)):
        dt = step_s[i]
        if dt == 0.0:
            for j in range(q):
                renew(mean[j], P[j], displacement[i], yaw[i])
            continue
        V = 0.5 * (speed[i] + speed[i - 1])
        turn, known = -dt * V / lever, dt * 0.5 * (known_rate[i] + known_rate[i - 1])
        lateral = 0.5 * (lateral_rate[i] + lateral_rate[i - 1])
        for j in range(q):
            likelihood[j], square[j] = one_particle(
                mean[j], P[j], slope[j], turn, known, dt, V, lateral, displacement[i], yaw[i], noise
            )
        weight *= np.exp(likelihood - likelihood.max())
        weight /= weight.sum()
        squares += (weight * square).sum()
        count += 1
        if (weight * weight).sum() * q > 2.0:  # fewer than half of them count  # noqa: PLR2004 - the usual half
            resample(weight, slope, mean, P, draws[resampled % len(draws)], apart / (1.0 + COOLING * resampled))
            resampled += 1
    resample(weight, slope, mean, P, draws[resampled % len(draws)], 0.0)
    return squares / max(count, 1)


@compiled(nogil=True, error_model="numpy")
def one_particle(
    mean: FloatArray, P: FloatArray, slope: float, turn: float, known: float, dt: float, V: float, lateral: float,
    displacement: float, yaw: float, noise: float,
) -> tuple[float, float]:  # fmt: skip
    """Take one particle on by a step; return the logarithm of its likelihood and the squared innovation of psi.

    Args:
        mean, P: (3,) and (3, 3), changed: y - d, psi, offset of R.
        slope, turn, known: Of R; -dt V / (2 l r0); what psi grows by beside R.
        dt, V, lateral: s, m/s, m/s.
        displacement, yaw, noise: As measured, and the std of y - d.
    """
    for b in range(len(mean)):
        P[1, b] += turn * (slope * P[0, b] + P[2, b])
    for b in range(len(mean)):
        P[b, 1] += turn * (slope * P[b, 0] + P[b, 2])
    P[1, 1] += YAW_RATE * dt
    mean[1] += turn * (slope * mean[0] + mean[2]) + known
    run_on(mean, P, dt, V, lateral)
    of_yaw, total_yaw = correct(mean, P, 1, yaw, YAW * YAW)
    of_place, total_place = correct(mean, P, 0, displacement, noise * noise)
    square = of_yaw * of_yaw / total_yaw
    return -0.5 * (square + math.log(total_yaw) + of_place * of_place / total_place + math.log(total_place)), square


@compiled(nogil=True, error_model="numpy")
def resample(
    weight: FloatArray, slope: FloatArray, mean: FloatArray, P: FloatArray, draw: FloatArray, least: float
) -> None:
    """Replace particles by copies as their weights say, all of one weight then.

    Args:
        weight, slope, mean, P: (q,), (q,), (q, 3), (q, 3, 3), changed.
        draw: (1 + q,) a number between 0 and 1, and normal ones.
        least: Spread of the slope that copies have at least, which otherwise would stay at one that is not quite right.
    """
    q = len(weight)
    middle = (weight * slope).sum()
    spread = max(math.sqrt((weight * (slope - middle) ** 2).sum()), least)
    old_slope, old_mean, old_P = slope.copy(), mean.copy(), P.copy()
    total, source = weight[0], 0
    for j in range(q):
        while (j + draw[0]) / q > total and source + 1 < q:
            source += 1
            total += weight[source]
        slope[j] = middle + KEPT * (old_slope[source] - middle) + MOVED * spread * draw[1 + j]
        mean[j], P[j] = old_mean[source], old_P[source]
    weight[:] = 1.0 / q


KEPT = math.sqrt(1.0 - MOVED * MOVED)  # so that the spread stays what it is (Liu and West 2001)

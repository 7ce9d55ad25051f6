"""The rolling radius of a wheelset from its motion, against the one on file.

rL - rR follows from the data in proportion to the nominal radius, and says nothing of it. The motion at the rails does:
the radius is the coefficient of the roll in what moves the wheelset sideways there (``motion/rolling_sums.py``). Sensor
noise in a regressor pulls its coefficient towards zero; the sums that it makes are taken off first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.motion.rolling_sums import BANDS, UNKNOWNS
from estimation.values.arrays import FloatArray
from estimation.values.geometry import Contradiction
from estimation.values.quantities import jackknife_std, normal_equivalent
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollingSums

EXPECTED = np.array([1.0, 0.0, 1.0, 1.0, 1.0, 0.0])  # of the unknowns; nothing is expected of the radius
EXPECTED_STD = np.array([0.01, 10.0, 0.1, 0.1, 300.0, 300.0])  # gravity and curve stand for dL - dR, 100 times as large
ROUNDS = 4  # of weights that follow from what is left
OUTLYING = 2.0  # times the median of what is left in the bands, over the noise: a band with more is left out
SHORT_BANDS = 2  # those of the shortest wavelengths, in which vibration shows
MODEL_STD = 5e-3  # m: without noise right radii are found 1 % too small
NOISE_DOUBT = 0.1  # of what taking off the noise changes
NOISE_DOUBT_LEFT = 0.6  # the same, per noise that is left in all bands beyond that on file
NOISE_DOUBT_VIBRATING = 0.4  # the same on axle boxes that vibrate
FRICTION_SHARE = 0.3  # of the radius, per share by which the suspension moves the wheelset more than on dry rails
SCALE_SHARE = 0.5  # of the radius, per scale of yaw against lateral sensor: more than sensors have is what is missing
MOST_UNEXPLAINED = 0.2  # of the power of what the roll moves: beyond, contact jumps move the wheelset
FEWEST_PARTS = 8
DOUBTED = 2.0  # stds beyond which the radius on file is in doubt: right ones have 0.6 rms, at most 2.5
MISTAKE = 0.10  # of the radius on file: what the motion has to exclude, as wheels worn out on file as new ones
CERTAIN = 4.0  # beyond which it is another: hundreds of wheelsets are looked at every 15 minutes

_SCALE, _RADIUS, _SUSPENSION, _CURVE = (UNKNOWNS.index(name) for name in ("scale", "radius", "suspension", "curve"))


@dataclass(frozen=True, slots=True)
class RollingRadius:
    """Rolling radius from the motion of a wheelset."""

    value: float  # m
    std: float  # m
    bound: float  # m, of its std: what the noise of the sensors alone leaves (Cramer and Rao)


def check_radius(
    parts: Sequence[RollingSums], on_file: float, relative_std: float = 0.0, *, measured: bool = False
) -> Contradiction | None:
    """Return that the motion contradicts the nominal radius on file, or leaves it open; None where it confirms it.

    A radius that nobody measured and that the motion does not tell from one off by ``MISTAKE`` stands beside the
    number as a doubt. Few data say nothing.

    Args:
        on_file: Nominal radius, m, with which the sums were made.
        measured: Whether that std is on file: the radius was measured, and one measurement against another is a doubt.
    """
    if len(parts) < FEWEST_PARTS:
        return None
    found = rolling_radius(parts)
    if found is None:
        return None if measured else _open(on_file, "the motion does not show the radius on which the wheelset rolls")
    std = math.hypot(found.std, relative_std * on_file)
    stds = abs(found.value - on_file) / std
    if stds <= DOUBTED:
        if measured or stds + DOUBTED <= MISTAKE * on_file / std:
            return None
        by_motion = f"{1e3 * found.value:.0f} mm (std {1e3 * found.std:.0f} mm)"
        return _open(on_file, f"the motion shows the radius on which the wheelset rolls as {by_motion}")
    certain = stds > CERTAIN and not measured
    reason = Reason(
        ReasonCode.ROLLING_RADIUS_DIFFERS,
        f"the wheelset rolls as on wheels of {1e3 * found.value:.0f} mm radius (std {1e3 * found.std:.0f} mm),"
        f" on file are {1e3 * on_file:.0f} mm; {'check' if certain else 'in doubt, so measure'} the radius,"
        " and the height of the lateral sensor",
    )
    return Contradiction(reason, certain, abs(found.value - on_file) / on_file)


def _open(on_file: float, shown: str) -> Contradiction:
    """Return that the number rests on a radius on file that neither the motion nor a measurement confirms."""
    text = (
        f"{shown}, which does not confirm the {1e3 * on_file:.0f} mm on file: a radius {MISTAKE:.0%} off moves the"
        f" conicity by {MISTAKE:.0%}; put its std on file, as measured or as wheels wear"
    )
    return Contradiction(Reason(ReasonCode.ROLLING_RADIUS_OPEN, text), certain=False, relative=0.0)


def rolling_radius(parts: Sequence[RollingSums]) -> RollingRadius | None:
    """Return the radius on which a wheelset rolls; None where the data do not determine it."""
    if len(parts) < FEWEST_PARTS:
        return None
    products = np.array([one.products for one in parts])
    noise = np.array([one.noise for one in parts])
    try:
        return _solved(products, noise)
    except np.linalg.LinAlgError:
        return None


def _solved(products: FloatArray, noise: FloatArray) -> RollingRadius | None:
    total, of_noise = products.sum(axis=0), noise.sum(axis=0)
    taken_off = noise.copy()
    # curve and gravity are one where contact is straight: its noise is what keeps them apart there
    taken_off[..., 1 + _CURVE, 1 + _CURVE] = 0.0
    with_noise = _solution(_weighted(np.ones(BANDS), total))
    share = min(1.0, float(np.min(_left(total, of_noise, with_noise))))  # sensors may be better than on file
    weights = np.ones(BANDS)
    left = np.ones(BANDS)
    without_noise = products - share * taken_off
    by_band = without_noise.sum(axis=0)
    for _ in range(ROUNDS):
        left = _left(total, of_noise, _solution(_weighted(weights, by_band)))
        weights = (left <= OUTLYING * np.median(left)) / np.maximum(left, 1.0)
    sums = np.einsum("b,pbij->pij", weights, without_noise)
    whole = sums.sum(axis=0)
    information = whole[1:, 1:] + np.diag(1.0 / EXPECTED_STD**2)
    if np.linalg.eigvalsh(information)[0] <= 0.0:
        return None
    best = _solution(whole)
    if best[_RADIUS] <= 0.0 or _unexplained(whole, best) > MOST_UNEXPLAINED:
        return None
    replicates = np.array([best, *(_solution(whole - one) for one in sums)])
    bound = math.sqrt(float(np.linalg.inv(information)[_RADIUS, _RADIUS]))
    corrected = best[_RADIUS] - _solution(_weighted(weights, total))[_RADIUS]
    sampling = float(normal_equivalent(jackknife_std(replicates), len(sums))[_RADIUS])
    vibrating = bool((left[-SHORT_BANDS:] > OUTLYING * np.median(left)).any())
    doubt = NOISE_DOUBT_VIBRATING if vibrating else NOISE_DOUBT
    stds = [
        max(sampling, bound, _std_of_bands(weights, by_band)),
        MODEL_STD,
        (doubt + NOISE_DOUBT_LEFT * max(float(left.min()) - 1.0, 0.0)) * corrected,
        FRICTION_SHARE * best[_RADIUS] * max(best[_SUSPENSION] - 1.0, 0.0),
        SCALE_SHARE * best[_RADIUS] * abs(best[_SCALE] - 1.0),
    ]
    return RollingRadius(float(best[_RADIUS]), float(np.linalg.norm(stds)), bound)


def _std_of_bands(weights: FloatArray, by_band: FloatArray) -> float:
    """Return the std of the radius, m, by what of the equation varies from wavelength to wavelength.

    More data do not lessen it, but each band has its own share of it: the jackknife leaves out one band at a time. What
    the bands have of sampling is in it too.
    """
    of_bands = weights[:, None, None] * by_band
    whole = of_bands.sum(axis=0)
    return float(jackknife_std(np.array([_solution(whole), *(_solution(whole - one) for one in of_bands)]))[_RADIUS])


def _unexplained(sums: FloatArray, unknowns: FloatArray) -> float:
    """Return what is left of the equation over what the roll moves, both squared and without noise."""
    equation = np.concatenate([[-1.0], unknowns])
    of_roll = unknowns[_RADIUS] ** 2 * sums[1 + _RADIUS, 1 + _RADIUS]
    return float(equation @ sums @ equation / max(of_roll, np.finfo(np.float64).tiny))


def _weighted(weights: FloatArray, by_band: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("b,bij->ij", weights, by_band))


def _solution(sums: FloatArray) -> FloatArray:
    """Return the unknowns from sums of products (TERMS, TERMS) and what is expected of them."""
    precision = 1.0 / EXPECTED_STD**2
    return np.asarray(np.linalg.solve(sums[1:, 1:] + np.diag(precision), sums[1:, 0] + precision * EXPECTED))


def _left(products: FloatArray, noise: FloatArray, unknowns: FloatArray) -> FloatArray:
    """Return what is left of the equation in each band over what the noise leaves of it (BANDS,)."""
    equation = np.concatenate([[-1.0], unknowns])
    left, expected = (np.einsum("i,bij,j->b", equation, sums, equation) for sums in (products, noise))
    return np.asarray(left / np.maximum(expected, np.finfo(np.float64).tiny))

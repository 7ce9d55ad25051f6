"""The rolling radius against the one on file, and the scale of yaw against lateral sensor.

rL - rR follows in proportion to the nominal radius, and says nothing of it. The motion at the rails does: the radius is
the coefficient of the roll in what moves the wheelset sideways there (``motion/rolling_sums.py``), the scale that of
the yaw. Noise in a regressor pulls its coefficient towards zero; its sums are taken off first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.motion.parameters import MOTION
from estimation.motion.rolling_sums import UNKNOWNS
from estimation.values.arrays import FloatArray
from estimation.values.geometry import Contradiction
from estimation.values.quantities import jackknife_std, normal_equivalent
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollingSums


@dataclass(frozen=True, slots=True)
class RollingFitParameters:
    """When the motion contradicts a rolling radius on file."""

    weight_rounds: int = 4  # of weights that follow from what is left
    outlying_factor: float = 2.0  # times the median of the bands' rest over the noise: a band with more is left out
    short_bands: int = 2  # those of the shortest wavelengths, in which vibration shows
    model_radius_std: float = 5e-3  # m: without noise right radii are found 1 % too small
    radius_noise_doubt: float = 0.1  # of what taking off the noise changes
    noise_doubt_left: float = 0.6  # the same, per noise that is left in all bands beyond that on file
    noise_doubt_vibrating: float = 0.4  # the same on axle boxes that vibrate
    friction_share: float = 0.3  # of the radius, per share by which the suspension moves more than on dry rails
    scale_share: float = 0.5  # of the radius, per scale of yaw against lateral sensor that sensors do not have
    inertia_share: float = 0.15  # of the radius, per share of inertia that the wheelset lacks or has too much of
    scale_doubted_stds: float = 2.5  # of yaw against lateral sensor: sensors within their std have at most 2
    most_unexplained_share: float = 0.2  # of the power of what the roll moves: beyond, contact jumps move the wheelset
    fewest_parts: int = 8
    doubted_stds: float = 2.0  # stds beyond which the radius on file is in doubt: right ones have 0.6 rms, at most 2.5
    radius_mistake: float = 0.10  # of the radius on file, that the motion excludes: worn wheels on file as new ones
    certain_stds: float = 4.0  # beyond which it is another: hundreds of wheelsets are looked at every 15 minutes
    expected_unknowns: tuple[float, ...] = (1.0, 0.0, 1.0, 1.0, 1.0, 0.0)  # of the unknowns; nothing of the radius
    # gravity and curve stand for dL - dR, 100 times as large
    expected_unknown_stds: tuple[float, ...] = (0.01, 10.0, 0.1, 0.1, 300.0, 300.0)


ROLLING = RollingFitParameters()
EXPECTED, EXPECTED_STD = np.array(ROLLING.expected_unknowns), np.array(ROLLING.expected_unknown_stds)


_SCALE, _RADIUS, _INERTIA, _SUSPENSION, _CURVE = (
    UNKNOWNS.index(name) for name in ("scale", "radius", "inertia", "suspension", "curve")
)


@dataclass(frozen=True, slots=True)
class RollingRadius:
    """Rolling radius from the motion of a wheelset."""

    value: float  # m
    std: float  # m
    bound: float  # m, of its std: what the noise of the sensors alone leaves (Cramer and Rao)
    scale: float  # of the yaw sensor against the lateral one


def check_rolling(
    parts: Sequence[RollingSums],
    on_file: float,
    relative_std: float = 0.0,
    *,
    measured: bool = False,
    scale_std: float | None = None,
) -> Contradiction | None:
    """Return what the rolling motion has against the nominal radius or the scales of the sensors, or leaves open.

    Args:
        scale_std: Of yaw against lateral sensor, on file; None where creep that saturates looks like another scale.
    """
    radius = check_radius(parts, on_file, relative_std, measured=measured)
    scale = None if scale_std is None or len(parts) < ROLLING.fewest_parts else _scale_differs(parts, scale_std)
    if scale is None or (radius is not None and (radius.certain or radius.relative > scale.relative)):
        return radius
    return scale


def _scale_differs(parts: Sequence[RollingSums], scale_std: float) -> Contradiction | None:
    found, std = rolling_radius(parts), math.hypot(EXPECTED_STD[_SCALE], scale_std)
    off = 0.0 if found is None else abs(found.scale - 1.0)
    if found is None or off <= ROLLING.scale_doubted_stds * std:
        return None
    text = (
        f"the yaw sensor measures {found.scale:.3f} times what the lateral one does,"
        f" {ROLLING.scale_doubted_stds * std:.1%} more or less may be; calibrate both, or put their std on file"
    )
    return Contradiction(Reason(ReasonCode.SCALE_DIFFERS, text), certain=False, relative=off)


def check_radius(
    parts: Sequence[RollingSums], on_file: float, relative_std: float = 0.0, *, measured: bool = False
) -> Contradiction | None:
    """Return that the motion contradicts the nominal radius on file, or leaves it open; None where it confirms it.

    A radius that nobody measured and that the motion does not tell from one off by ``radius_mistake`` stands beside the
    number as a doubt; one that was ``measured`` stands against another measurement, a doubt too. Few data say nothing.
    """
    if len(parts) < ROLLING.fewest_parts:
        return None
    found = rolling_radius(parts)
    if found is None:
        return None if measured else _open(on_file, "the motion does not show the radius on which the wheelset rolls")
    std = math.hypot(found.std, relative_std * on_file)
    stds = abs(found.value - on_file) / std
    if stds <= ROLLING.doubted_stds:
        if measured or stds + ROLLING.doubted_stds <= ROLLING.radius_mistake * on_file / std:
            return None
        by_motion = f"{1e3 * found.value:.0f} mm (std {1e3 * found.std:.0f} mm)"
        return _open(on_file, f"the motion shows the radius on which the wheelset rolls as {by_motion}")
    certain = stds > ROLLING.certain_stds and not measured
    reason = Reason(
        ReasonCode.ROLLING_RADIUS_DIFFERS,
        f"the wheelset rolls as on wheels of {1e3 * found.value:.0f} mm radius (std {1e3 * found.std:.0f} mm),"
        f" on file are {1e3 * on_file:.0f} mm; {'check' if certain else 'in doubt, so measure'} the radius,"
        " and the height of the lateral sensor",
    )
    return Contradiction(reason, certain, abs(found.value - on_file) / on_file)


def _open(on_file: float, shown: str) -> Contradiction:
    text = (
        f"{shown}, which does not confirm the {1e3 * on_file:.0f} mm on file: a radius"
        f" {ROLLING.radius_mistake:.0%} off moves the conicity by {ROLLING.radius_mistake:.0%};"
        " put its std on file, as measured or as wheels wear"
    )
    return Contradiction(Reason(ReasonCode.ROLLING_RADIUS_OPEN, text), certain=False, relative=0.0)


def rolling_radius(parts: Sequence[RollingSums]) -> RollingRadius | None:
    """Return the radius on which a wheelset rolls; None where the data do not determine it."""
    if len(parts) < ROLLING.fewest_parts:
        return None
    products = np.array([part.products for part in parts])
    noise = np.array([part.noise for part in parts])
    try:
        return _solved(products, noise)
    except np.linalg.LinAlgError:
        return None


def _solved(products: FloatArray, noise: FloatArray) -> RollingRadius | None:
    total, of_noise = products.sum(axis=0), noise.sum(axis=0)
    taken_off = noise.copy()
    # curve and gravity are one where contact is straight: its noise is what keeps them apart there
    taken_off[..., 1 + _CURVE, 1 + _CURVE] = 0.0
    with_noise = _solution(_weighted(np.ones(MOTION.wavelength_bands), total))
    share = min(1.0, float(np.min(_left(total, of_noise, with_noise))))  # sensors may be better than on file
    weights = np.ones(MOTION.wavelength_bands)
    left = np.ones(MOTION.wavelength_bands)
    without_noise = products - share * taken_off
    by_band = without_noise.sum(axis=0)
    for _ in range(ROLLING.weight_rounds):
        left = _left(total, of_noise, _solution(_weighted(weights, by_band)))
        weights = (left <= ROLLING.outlying_factor * np.median(left)) / np.maximum(left, 1.0)
    sums = np.einsum("b,pbij->pij", weights, without_noise)
    whole = sums.sum(axis=0)
    information = whole[1:, 1:] + np.diag(1.0 / EXPECTED_STD**2)
    if np.linalg.eigvalsh(information)[0] <= 0.0:
        return None
    best = _solution(whole)
    if best[_RADIUS] <= 0.0 or _unexplained_share(whole, best) > ROLLING.most_unexplained_share:
        return None
    replicates = np.array([best, *(_solution(whole - group) for group in sums)])
    bound = math.sqrt(float(np.linalg.inv(information)[_RADIUS, _RADIUS]))
    corrected = best[_RADIUS] - _solution(_weighted(weights, total))[_RADIUS]
    sampling = float(normal_equivalent(jackknife_std(replicates), len(sums))[_RADIUS])
    vibrating = bool((left[-ROLLING.short_bands :] > ROLLING.outlying_factor * np.median(left)).any())
    doubt = ROLLING.noise_doubt_vibrating if vibrating else ROLLING.radius_noise_doubt
    stds = [
        max(sampling, bound, _std_of_bands(weights, by_band)),
        ROLLING.model_radius_std,
        (doubt + ROLLING.noise_doubt_left * max(float(left.min()) - 1.0, 0.0)) * corrected,
        ROLLING.friction_share * best[_RADIUS] * max(best[_SUSPENSION] - 1.0, 0.0),
        ROLLING.scale_share * best[_RADIUS] * abs(best[_SCALE] - 1.0),
        ROLLING.inertia_share * best[_RADIUS] * abs(best[_INERTIA] - 1.0),
    ]
    return RollingRadius(float(best[_RADIUS]), float(np.linalg.norm(stds)), bound, float(best[_SCALE]))


def _std_of_bands(weights: FloatArray, by_band: FloatArray) -> float:
    """Return the std of the radius, m, by what of the equation varies from wavelength to wavelength."""
    # More data do not lessen it, but each band has its own share of it: the jackknife leaves out one band at a time.
    # What the bands have of sampling is in it too.
    of_bands = weights[:, None, None] * by_band
    whole = of_bands.sum(axis=0)
    return float(jackknife_std(np.array([_solution(whole), *(_solution(whole - band) for band in of_bands)]))[_RADIUS])


def _unexplained_share(sums: FloatArray, unknowns: FloatArray) -> float:
    equation = np.concatenate([[-1.0], unknowns])
    of_roll = unknowns[_RADIUS] ** 2 * sums[1 + _RADIUS, 1 + _RADIUS]
    return float(equation @ sums @ equation / max(of_roll, np.finfo(np.float64).tiny))


def _weighted(weights: FloatArray, by_band: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("b,bij->ij", weights, by_band))


def _solution(sums: FloatArray) -> FloatArray:
    precision = 1.0 / EXPECTED_STD**2
    return np.asarray(np.linalg.solve(sums[1:, 1:] + np.diag(precision), sums[1:, 0] + precision * EXPECTED))


def _left(products: FloatArray, noise: FloatArray, unknowns: FloatArray) -> FloatArray:
    """Return what is left of the equation in each band over what the noise leaves of it (BANDS,)."""
    equation = np.concatenate([[-1.0], unknowns])
    left, expected = (np.einsum("i,bij,j->b", equation, sums, equation) for sums in (products, noise))
    return np.asarray(left / np.maximum(expected, np.finfo(np.float64).tiny))

"""The conicity of a wheelset at the amplitude of its limit: as estimated where it moves as far, else extrapolated.

A limit belongs to an amplitude (EN 15302 quotes 3 mm). Where the motion does not cover it, the worn design pairs of
``estimation.contact.worn_family`` say how conicity goes on: of those whose conicity is like the wheelset's at the
largest amplitude covered and half a millimetre below, the change up to 3 mm is fitted as linear in both, and what is
left over is the spread. Where few of them are like the wheelset, or the spread is large, it is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.contact.worn_family import WornFamily, worn_family
from estimation.values.arrays import FloatArray
from estimation.values.geometry import WheelsetGeometry
from estimation.values.interval_conicities import KnownConicity, known_conicities
from estimation.values.intervals import with_interval
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode

LIMIT_AMPLITUDE = 3e-3  # m, of every conicity limit (EN 15302, TSI)
SAME_AMPLITUDE = 1e-6  # m
LEAST_AMPLITUDE = 2e-3  # m, from which anything is extrapolated; from less, intervals of known pairs do not cover
SLOPE_STEP = 0.5e-3  # m, from the largest amplitude covered to the one that shows the slope
ALIKE = 0.06  # relative difference of conicities that are alike
LEAST_ALIKE = 0.012  # and the least difference that counts
SLOPE_ALIKE = 0.7  # of that, for the difference between the two amplitudes
SHARED = 0.5  # correlation of the errors at two amplitudes
RIDGE = 2.0  # members' weight with which the fit is held flat
LEAST_MEMBERS = 10.0  # weight of members that are like the wheelset
SPREAD_FACTOR = 1.3  # real shapes differ more than the family
LARGEST_STD = 0.1  # of an extrapolated conicity, as of any that is published


@dataclass(frozen=True, slots=True)
class Extrapolation:
    """A conicity at the limit's amplitude, extrapolated."""

    value: float
    measured_std: float  # from the error of what was estimated
    spread: float  # std of what wheelsets like it do beyond

    @property
    def std(self) -> float:
        """Standard deviation of both together."""
        return float(np.hypot(self.measured_std, self.spread))


def _estimates(geometry: WheelsetGeometry) -> list[tuple[float, Estimate]]:
    """Return the amplitudes (m) of a geometry with the conicity at each, where that is estimated; increasing."""
    pairs = list(zip((float(a) for a in geometry.amplitude), geometry.conicity, strict=True))
    if np.isfinite(geometry.reported_amplitude):
        pairs.append((geometry.reported_amplitude, geometry.equivalent_conicity))
    return sorted(((a, e) for a, e in pairs if e.status is Status.ESTIMATED), key=lambda pair: pair[0])


def conicity_at_limit_amplitude(geometry: WheelsetGeometry) -> Estimate:
    """Return the conicity that a limit is compared with: that at 3 mm.

    Parameters
    ----------
    geometry
        Of one wheelset.

    Returns
    -------
    Estimate
        As the geometry has it; where the motion does not cover 3 mm extrapolated, with the reason
        ``amplitude_extrapolated``; unknown where neither is possible.
    """
    known = _estimates(geometry)
    covered = [e for a, e in known if abs(a - LIMIT_AMPLITUDE) < SAME_AMPLITUDE]
    if covered:
        return covered[-1]
    below = [one for one in known_conicities(geometry) if one.amplitude < LIMIT_AMPLITUDE]
    if not known:
        return geometry.equivalent_conicity
    if not below:
        return Estimate.unknown(not_comparable(known[0][0]), known[0][1].count)
    amplitude, count = below[-1].amplitude, known[len(below) - 1][1].count
    found = extrapolated(below)
    if found is None:
        return Estimate.unknown(not_comparable(amplitude), count)
    return marked(with_interval(found.value, found.measured_std, found.spread, count=count), amplitude)


def marked(estimate: Estimate, amplitude: float) -> Estimate:
    """Return an estimate with the reason that it is extrapolated.

    Parameters
    ----------
    estimate
        At the limit's amplitude.
    amplitude
        From which it is extrapolated, m.
    """
    return Estimate(
        estimate.value,
        estimate.std,
        estimate.low,
        estimate.high,
        estimate.count,
        estimate.status,
        extrapolated_from(amplitude),
    )


def extrapolated_from(amplitude: float) -> Reason:
    """Return that a conicity is extrapolated from an amplitude (m)."""
    text = f"at {1e3 * LIMIT_AMPLITUDE:g} mm, extrapolated from {1e3 * amplitude:g} mm, the largest amplitude covered"
    return Reason(ReasonCode.AMPLITUDE_EXTRAPOLATED, text)


def not_comparable(amplitude: float) -> Reason:
    """Return that a conicity at an amplitude (m) cannot be compared with a limit."""
    text = f"the limit is for {1e3 * LIMIT_AMPLITUDE:g} mm, the conicity is known at {1e3 * amplitude:g} mm"
    return Reason(ReasonCode.AMPLITUDE_NOT_COMPARABLE, text)


def extrapolated(known: Sequence[KnownConicity], family: WornFamily | None = None) -> Extrapolation | None:
    """Return the conicity at the limit's amplitude from those at smaller ones; None where it cannot be known.

    Parameters
    ----------
    known
        At amplitudes below the limit's, increasing.
    family
        Curves of wheelsets like it; by default the worn design pairs.
    """
    family = family or worn_family()
    largest = known[-1]
    if largest.amplitude < LEAST_AMPLITUDE - SAME_AMPLITUDE:
        return None
    wanted = largest.amplitude - SLOPE_STEP
    lower = min(known[:-1], key=lambda one: abs(one.amplitude - wanted), default=None)
    if lower is None or lower.amplitude < family.amplitude[0]:
        return None
    at_largest, at_lower = _at(family, largest.amplitude), _at(family, lower.amplitude)
    own = np.array([largest.value, largest.value - lower.value])
    error = np.column_stack([at_largest, at_largest - at_lower]) - own
    found = _local_fit(error, _covariance(largest.std, lower.std), _width(largest.value), family, at_largest)
    if found is None:
        return None
    change, measured_std, spread = found
    result = Extrapolation(largest.value + change, measured_std, spread)
    return result if result.std <= LARGEST_STD and result.value > 0.0 else None


def _at(family: WornFamily, amplitude: float) -> FloatArray:
    """Return the conicity (m,) of the members at an amplitude, straight between those that are kept."""
    upper = min(max(int(np.searchsorted(family.amplitude, amplitude)), 1), len(family.amplitude) - 1)
    low, high = family.amplitude[upper - 1], family.amplitude[upper]
    share = (amplitude - low) / (high - low)
    return np.asarray((1.0 - share) * family.conicity[:, upper - 1] + share * family.conicity[:, upper])


def _width(conicity: float) -> FloatArray:
    """Return by how much level and slope (2,) of a member may differ."""
    level = max(LEAST_ALIKE, ALIKE * conicity)
    return np.array([level, SLOPE_ALIKE * level])


def _covariance(level_std: float, lower_std: float) -> FloatArray:
    """Return the covariance (2, 2) of the errors of level and slope."""
    shared = SHARED * level_std * lower_std
    both = level_std**2 - shared
    return np.array([[level_std**2, both], [both, level_std**2 + lower_std**2 - 2.0 * shared]])


def _local_fit(
    error: FloatArray, covariance: FloatArray, width: FloatArray, family: WornFamily, at_largest: FloatArray
) -> tuple[float, float, float] | None:
    """Return the change up to the limit's amplitude, its std from the estimate's error, and the spread of the members.

    Members count by how far level and slope (m, 2) are from the wheelset's, in the errors of the estimate and the
    width of what is alike.
    """
    distance = np.einsum("mi,ij,mj->m", error, np.linalg.inv(covariance + np.diag(width**2)), error)
    weight = np.exp(-0.5 * distance)
    if weight.sum() < LEAST_MEMBERS:
        return None
    change = _at(family, LIMIT_AMPLITUDE) - at_largest
    design = np.column_stack([np.ones(len(error)), error / width])
    normal = (design * weight[:, np.newaxis]).T @ design + np.diag([0.0, RIDGE, RIDGE])
    level, *slopes = np.linalg.solve(normal, design.T @ (weight * change))
    left = change - design @ np.array([level, *slopes])
    gradient = np.array(slopes) / width + np.array([1.0, 0.0])
    spread = SPREAD_FACTOR * np.sqrt(weight @ left**2 / weight.sum())
    return float(level), float(np.sqrt(gradient @ covariance @ gradient)), float(spread)

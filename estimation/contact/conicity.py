"""Equivalent conicity from the rolling radius difference, after EN 15302.

The integration (EN 15302:2021 Annex B): with S(y) the integral of Delta r from its zero crossing, a free wheelset
moves such that psi^2 = 2 (C - S(y)) / (e r0); its wavelength over the travel between the two points where S = C,
put into Klingel's formula, gives tan(gamma_e) = pi^2 / I^2 with I = integral dy / sqrt(C - S(y)); e and r0 cancel.
Curves that a measurement gives: ``docs/decisions/contact-conicity-rules.md``.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from estimation.compiled import compiled
from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.method import ContactMethod
from estimation.contact.parameters import PROFILES
from estimation.contact.smoothed_profile import SmoothedProfile
from estimation.errors import ContactError, ParameterError
from estimation.values.arrays import FloatArray

_ANGLES, _HALVINGS, _REST = PROFILES.conicity_angles, PROFILES.halvings, PROFILES.rest_share
_PLACES = [math.pi * ((j + 0.5) / _ANGLES - 0.5) for j in range(_ANGLES)]
_SINES, _COSINES = np.array([math.sin(x) for x in _PLACES]), np.array([math.cos(x) for x in _PLACES])


def equivalent_conicity(
    lateral_displacement: npt.ArrayLike, rolling_radius_difference: npt.ArrayLike, amplitudes: npt.ArrayLike
) -> FloatArray:
    """Return tan(gamma_e) (k,) at each amplitude (k,), m, by EN 15302; NaN where the curve does not cover it.

    Args:
        lateral_displacement: (n,) m, strictly increasing, positive to the left.
        rolling_radius_difference: (n,) m, left minus right.
    """
    y, difference = _curve(lateral_displacement, rolling_radius_difference)
    return np.asarray(_integrate(y, difference, _amplitudes(amplitudes)))


def zero_crossing(lateral_displacement: npt.ArrayLike, rolling_radius_difference: npt.ArrayLike) -> float:
    """Return the lateral displacement where the radii are equal (of several, the deepest equilibrium), m, or NaN."""
    y, difference = _curve(lateral_displacement, rolling_radius_difference)
    return float(_equilibrium(y, difference)[0])


def middle_of_travel(
    lateral_displacement: npt.ArrayLike, rolling_radius_difference: npt.ArrayLike, amplitude: float
) -> float:
    """Return the middle between the turning points at an amplitude, m; NaN where the curve does not cover it."""
    y, difference = _curve(lateral_displacement, rolling_radius_difference)
    (a,) = _amplitudes(amplitude)
    crossing = _equilibrium(y, difference)[0]
    if math.isnan(crossing):
        return math.nan
    points, values, potential, k = _potentials(y, difference, crossing)
    highest = _peaks(points, values, potential, k)
    return float(_turn(a, crossing, points, values, potential, highest, k) - a)


def nonlinearity_parameter(lateral_displacement: npt.ArrayLike, rolling_radius_difference: npt.ArrayLike) -> float:
    """Return NP = (tan gamma_e(4 mm) - tan gamma_e(2 mm)) / 2, in 1/mm as EN 15302 gives it; NaN if not covered."""
    low, high = equivalent_conicity(lateral_displacement, rolling_radius_difference, (2e-3, 4e-3))
    return float((high - low) / 2.0)


def _curve(displacement: npt.ArrayLike, difference: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    y = np.asarray(displacement, dtype=np.float64)
    values = np.asarray(difference, dtype=np.float64)
    if y.ndim != 1 or y.shape != values.shape:
        raise ParameterError(
            f"shape {values.shape} does not match the displacements' {y.shape}", field="rolling_radius_difference"
        )
    usable = np.isfinite(y) & np.isfinite(values)
    y, values = y[usable], values[usable]
    if (np.diff(y) <= 0).any():
        raise ParameterError("must increase strictly", field="lateral_displacement")
    return y, values


def _amplitudes(amplitudes: npt.ArrayLike) -> FloatArray:
    wanted = np.array(amplitudes, dtype=np.float64, ndmin=1)
    if not (np.isfinite(wanted) & (wanted > 0)).all():
        raise ParameterError("must be positive lengths", field="amplitudes")
    return wanted


@compiled()
def _equilibrium(y, difference):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """Return the deepest upward zero crossing (NaN if none) and the integral of the difference from y[0] to it."""
    crossing, depth, energy = math.nan, math.inf, 0.0
    zero_from, zero_energy = math.nan, 0.0
    for i in range(len(y) - 1):
        a, b, width = difference[i], difference[i + 1], y[i + 1] - y[i]
        if a < 0.0 <= b:
            share = a / (a - b)
            zero_from, zero_energy = y[i] + share * width, energy + 0.5 * a * share * width
        if b > 0.0 >= a and not math.isnan(zero_from):
            zero_to = y[i] if a == 0.0 else zero_from
            if zero_energy < depth:
                crossing, depth = 0.5 * (zero_from + zero_to), zero_energy
            zero_from = math.nan
        elif b < 0.0:
            zero_from = math.nan
        energy += 0.5 * (a + b) * width
    return crossing, depth


@compiled()
def _potentials(y, difference, crossing):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    k = np.searchsorted(y, crossing)
    n = len(y) + 1
    points, values, potential = np.empty(n), np.empty(n), np.zeros(n)
    points[:k], points[k], points[k + 1 :] = y[:k], crossing, y[k:]
    values[:k], values[k], values[k + 1 :] = difference[:k], 0.0, difference[k:]
    for i in range(k + 1, n):
        potential[i] = potential[i - 1] + 0.5 * (values[i] + values[i - 1]) * (points[i] - points[i - 1])
    for i in range(k - 1, -1, -1):
        potential[i] = potential[i + 1] - 0.5 * (values[i] + values[i + 1]) * (points[i + 1] - points[i])
    return points, values, potential, k


@compiled()
def _potential_at(x, points, values, potential):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    i = min(max(np.searchsorted(points, x, side="right") - 1, 0), len(points) - 2)
    width = points[i + 1] - points[i]
    if width <= 0.0:
        return potential[i]
    t = x - points[i]
    return potential[i] + t * (values[i] + 0.5 * t * (values[i + 1] - values[i]) / width)


@compiled()
def _peaks(points, values, potential, k):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    n = len(points)
    highest = np.zeros(n)
    for i in range(k + 1, n):
        highest[i] = max(highest[i - 1], potential[i])
        if values[i - 1] > 0.0 > values[i]:
            share = values[i - 1] / (values[i - 1] - values[i])
            top = potential[i - 1] + 0.5 * values[i - 1] * share * (points[i] - points[i - 1])
            highest[i] = max(highest[i], top)
    for i in range(k - 1, -1, -1):
        highest[i] = max(highest[i + 1], potential[i])
        if values[i] > 0.0 > values[i + 1]:
            share = values[i] / (values[i] - values[i + 1])
            top = potential[i] + 0.5 * values[i] * share * (points[i + 1] - points[i])
            highest[i] = max(highest[i], top)
    return highest


@compiled()
def _highest_at(x, points, values, potential, highest, k):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    here = _potential_at(x, points, values, potential)
    i = min(max(np.searchsorted(points, x, side="right") - 1, 0), len(points) - 2)
    inner, outer = (i, i + 1) if x >= points[k] else (i + 1, i)
    passed_peak = (values[inner] > 0.0 > values[outer]) if inner < outer else (values[inner] < 0.0 < values[outer])
    if passed_peak:
        share = values[inner] / (values[inner] - values[outer])
        peak = points[inner] + share * (points[outer] - points[inner])
        if abs(x - points[k]) > abs(peak - points[k]):
            return highest[outer]
    return max(here, highest[inner])


@compiled()
def _turn(a, crossing, points, values, potential, highest, k):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Return the outer turning point of the travel of amplitude a; NaN where it leaves the curve."""
    low, high = max(crossing, points[0] + 2.0 * a), min(points[-1], crossing + 2.0 * a)
    if low > high:
        return math.nan
    at_low = _highest_at(low, points, values, potential, highest, k)
    at_low -= _highest_at(low - 2.0 * a, points, values, potential, highest, k)
    at_high = _highest_at(high, points, values, potential, highest, k)
    at_high -= _highest_at(high - 2.0 * a, points, values, potential, highest, k)
    if at_low > 0.0 or at_high < 0.0:
        return math.nan
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        right = _highest_at(middle, points, values, potential, highest, k)
        if right < _highest_at(middle - 2.0 * a, points, values, potential, highest, k):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@compiled()
def _integrate(y, difference, amplitudes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    result = np.full(len(amplitudes), np.nan)
    crossing, _ = _equilibrium(y, difference)
    if math.isnan(crossing):
        return result
    points, values, potential, k = _potentials(y, difference, crossing)
    highest = _peaks(points, values, potential, k)
    for m in range(len(amplitudes)):
        a = amplitudes[m]
        turn = _turn(a, crossing, points, values, potential, highest, k)
        if math.isnan(turn):
            continue
        energy = _highest_at(turn, points, values, potential, highest, k)
        left_energy = _highest_at(turn - 2.0 * a, points, values, potential, highest, k)
        rests = _potential_at(turn, points, values, potential) < energy * (1.0 - _REST)
        rests |= _potential_at(turn - 2.0 * a, points, values, potential) < left_energy * (1.0 - _REST)
        energy = min(energy, left_energy)
        result[m] = 0.0 if rests else _from_travel(turn - a, a, energy, points, values, potential)
    return result


@compiled()
def _from_travel(middle, amplitude, energy, points, values, potential):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    total, i, last = 0.0, 0, len(points) - 2
    for j in range(_ANGLES):
        x = middle + amplitude * _SINES[j]
        while i < last and points[i + 1] <= x:  # the places come in their order
            i += 1
        width, t = points[i + 1] - points[i], x - points[i]
        here = potential[i]
        if width > 0.0:
            here += t * (values[i] + 0.5 * t * (values[i + 1] - values[i]) / width)
        left = energy - here
        if left <= 0.0:
            return 0.0
        total += amplitude * _COSINES[j] / math.sqrt(left)
    return (_ANGLES / total) ** 2


class MeasuredShapes(NamedTuple):
    """The four profiles of a wheelset on a track with their uncertainty; one that is used twice errs alike."""

    left_wheel: SmoothedProfile
    right_wheel: SmoothedProfile
    left_rail: SmoothedProfile
    right_rail: SmoothedProfile

    @property
    def exact(self) -> bool:
        """Whether all four shapes are known."""
        return all(shape.spline is None for shape in self)

    def draw(self, wheelset: WheelsetOnTrack, random: np.random.Generator) -> WheelsetOnTrack:
        """Return the wheelset with profiles that the measurements allow."""
        drawn = {key: shape.draw(random) for key, shape in {id(shape): shape for shape in self}.items()}
        left_wheel, right_wheel, left_rail, right_rail = (drawn[id(shape)] for shape in self)
        return replace(
            wheelset, left_wheel=left_wheel, right_wheel=right_wheel, left_rail=left_rail, right_rail=right_rail
        )


def conicity_std(
    wheelset: WheelsetOnTrack,
    shapes: MeasuredShapes,
    lateral_displacement: npt.ArrayLike,
    amplitudes: npt.ArrayLike,
    *,
    method: ContactMethod = ContactMethod.EN15302,
    draws: int = PROFILES.conicity_draws,
) -> FloatArray:
    """Return the standard deviation (k,) of tan(gamma_e) that follows from the noise of the profiles.

    Profiles are drawn from what the measurements allow, and the contact search is done for each: contact jumps move,
    appear and vanish with them. 0 for profiles that are known; NaN for an amplitude that fewer than 80 % of the draws
    cover. Errors of an instrument that are alike along the whole profile (scale, tilt) are not in it.

    Args:
        lateral_displacement, amplitudes: (n,) m, strictly increasing; (k,) m.
    """
    wanted = np.array(amplitudes, dtype=np.float64, ndmin=1)
    if shapes.exact:
        return np.zeros(len(wanted))
    random = np.random.default_rng(PROFILES.draw_seed)
    expected = _conicity(wheelset, lateral_displacement, wanted, method)
    values = np.full((draws, len(wanted)), np.nan)
    for row in range(draws):
        try:
            drawn = shapes.draw(wheelset, random)
            values[row] = _conicity(drawn, lateral_displacement, wanted, method)
        except ContactError:
            continue
    covered = np.isfinite(values)
    squares = np.where(covered, (values - expected) ** 2, 0.0).sum(axis=0) / np.maximum(covered.sum(axis=0), 1)
    return np.where(covered.mean(axis=0) >= PROFILES.least_draw_share, np.sqrt(squares), np.nan)


def _conicity(
    wheelset: WheelsetOnTrack, displacement: npt.ArrayLike, amplitudes: FloatArray, method: ContactMethod
) -> FloatArray:
    curve = radius_difference_curve(wheelset, displacement, method=method)
    return equivalent_conicity(curve.displacement, curve.difference, amplitudes)

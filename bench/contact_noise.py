"""Noise on every design profile: error of the equivalent conicity of the smoothed profile, and its stated std."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from bench.report import BenchRow
from estimation.contact.conicity import MeasuredShapes, conicity_std, equivalent_conicity
from estimation.contact.geometry import ContactMethod, WheelsetOnTrack, contact_table, radius_difference_curve
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import exact, smoothed_profile
from estimation.values.arrays import BoolArray, FloatArray

NOISE = 0.02  # mm of height at each point
SPACING = 0.1  # mm of arc between points, as profile gauges have it
SHARED_NOISE, SHARED_OVER, SHARED_ON = 0.01, 0.4, (0, 1, 5, 9)  # mm, mm, of PAIRS
SEEDS = 10
AMPLITUDES = np.arange(2, 13) * 0.5e-3  # m
DISPLACEMENT = np.linspace(-8e-3, 8e-3, 161)
NEAR = 0.3e-3  # m around the end of an amplitude within which a contact moves ...
MOVES = 2e-3  # ... by more than this: a jump, or as good as one
REACH, LOW, HIGH = 0.01, 0.92, 0.98


@dataclass(frozen=True, slots=True)
class _Pair:
    wheel: str
    rail: str
    inclination: float
    noisy: str  # "wheel" or "rail"
    worn: float = 0.0  # mm, by which it is off its design 5 mm outside the datum or the crown


PAIRS = (
    _Pair("P8", "56E1", 1 / 20, "wheel"),
    _Pair("S1002", "60E1", 1 / 40, "wheel"),
    _Pair("EN13715-S1002/h30/e30", "60E1", 1 / 40, "wheel"),
    _Pair("EN13715-1/40/h28/e32.5", "60E1", 1 / 40, "wheel"),
    _Pair("EN15302-A", "60E1", 1 / 40, "wheel"),
    _Pair("EN15302-B", "60E1", 1 / 40, "wheel"),
    _Pair("EN15302-H", "60E1", 1 / 40, "wheel"),
    _Pair("EN15302-I", "60E1", 1 / 40, "wheel"),
    _Pair("P8", "56E1", 1 / 20, "rail"),
    _Pair("S1002", "60E1", 1 / 40, "rail"),
    _Pair("S1002", "60E2", 1 / 40, "rail"),
    _Pair("S1002", "54E1", 1 / 40, "rail"),
    _Pair("S1002", "UIC60", 1 / 40, "rail"),
)
WORN_PAIRS = (
    _Pair("S1002", "60E1", 1 / 40, "wheel", 0.01),
    _Pair("S1002", "60E1", 1 / 40, "rail", 0.01),
    _Pair("S1002", "60E1", 1 / 40, "wheel", 0.1),
    _Pair("P8", "60E1", 1 / 40, "wheel", 0.3),
    _Pair("S1002", "60E1", 1 / 40, "rail", 0.2),
)
WORN_AT, WORN_OVER = 5e-3, 8e-3  # m


@dataclass(frozen=True, slots=True)
class _Outcome:
    amplitude: FloatArray  # (k,) m
    error: FloatArray  # (seeds, k)
    std: FloatArray  # (seeds, k)
    away: BoolArray  # (k,) from jumps

    @property
    def covered(self) -> BoolArray:
        return np.abs(self.error) <= 1.96 * self.std


def noise_rows() -> Iterator[BenchRow]:
    """Yield a row for each profile, and some for all of them."""
    with ProcessPoolExecutor() as pool:
        new = [pool.submit(_measure, pair, index) for index, pair in enumerate(PAIRS)]
        worn = [pool.submit(_measure, pair, len(PAIRS) + index) for index, pair in enumerate(WORN_PAIRS)]
        alike = [pool.submit(_measure, PAIRS[index], index, SHARED_NOISE, SHARED_OVER) for index in SHARED_ON]
        for pair, outcome in zip((*PAIRS, *WORN_PAIRS), (*new, *worn), strict=True):
            yield _of_pair(pair, outcome.result())
        name = f"{NOISE} mm of noise, all {len(PAIRS)} profiles"
        yield _together([outcome.result() for outcome in new], f"{name}, amplitudes 1 to 6 mm", 0.0)
        yield _together([outcome.result() for outcome in new], f"{name}, amplitudes 2 to 6 mm", 2e-3)
        name = f"{NOISE} mm of noise, the {len(WORN_PAIRS)} profiles off their design"
        yield _together([outcome.result() for outcome in worn], f"{name}, amplitudes 2 to 6 mm", 2e-3)
        name = f"{SHARED_NOISE} mm of noise that neighbours share over {SHARED_OVER} mm, {len(SHARED_ON)} profiles"
        yield _together([outcome.result() for outcome in alike], f"{name}, amplitudes 2 to 6 mm", 2e-3, (LOW, 1.0))


def _of_pair(pair: _Pair, outcome: _Outcome) -> BenchRow:
    error, covered = np.abs(outcome.error[:, outcome.away]), float(outcome.covered[:, outcome.away].mean())
    percentile = float(np.quantile(error, 0.95))
    worn = f"{pair.worn} mm off its design, " if pair.worn else ""
    return BenchRow(
        f"{NOISE} mm of noise on the {pair.noisy}, {worn}{pair.wheel} on {pair.rail}, {SEEDS} seeds, away from jumps",
        f"95th percentile {percentile:.4f}, covered {covered:.0%}",
        f"{REACH}, {LOW:.0%}",
        percentile <= REACH and covered >= LOW,
    )


def _together(
    outcomes: Sequence[_Outcome], named: str, smallest: float, reach: tuple[float, float] = (LOW, HIGH)
) -> BenchRow:
    """Return the row of several profiles at amplitudes from ``smallest``, m."""
    taken = [(one, one.amplitude >= smallest - 1e-9) for one in outcomes]
    error = np.concatenate([np.abs(one.error[:, one.away & used]).ravel() for one, used in taken])
    covered = np.concatenate([one.covered[:, one.away & used].ravel() for one, used in taken])
    near = np.concatenate([one.covered[:, ~one.away & used].ravel() for one, used in taken])
    percentile, share = float(np.quantile(error, 0.95)), float(covered.mean())
    return BenchRow(
        f"{named}, away from jumps",
        f"95th percentile {percentile:.4f}, covered {share:.1%} (next to jumps {near.mean():.1%})",
        f"{REACH}, {reach[0]:.0%} to {reach[1]:.0%}",
        percentile <= REACH and reach[0] <= share <= reach[1],
    )


def _measure(pair: _Pair, index: int, noise: float = NOISE, over: float = 0.0) -> _Outcome:
    wheel, rail = wheel_profile(pair.wheel), rail_profile(pair.rail)
    if pair.noisy == "wheel":
        wheel = _worn(wheel, pair.worn)
    else:
        rail = _worn(rail, pair.worn)
    design = WheelsetOnTrack.symmetric(wheel, rail, pair.inclination, 1.435)
    truth = _conicity(design)
    errors, stds = [], []
    for seed in range(SEEDS):
        random = np.random.default_rng((index, seed))
        points = _points(wheel if pair.noisy == "wheel" else rail)
        points[:, 1] += _noise(random, len(points), noise, over)
        if pair.noisy == "wheel":
            shapes = smoothed_profile("wheel", "measured", points), exact(rail)
        else:
            shapes = exact(wheel), smoothed_profile("rail", "measured", points)
        wheelset = WheelsetOnTrack.symmetric(shapes[0].profile, shapes[1].profile, pair.inclination, 1.435)
        measured = MeasuredShapes(shapes[0], shapes[0], shapes[1], shapes[1])
        errors.append(_conicity(wheelset) - truth)
        stds.append(conicity_std(wheelset, measured, DISPLACEMENT, AMPLITUDES))
    covered = np.isfinite(truth)
    found, std = np.array(errors)[:, covered], np.array(stds)[:, covered]
    return _Outcome(AMPLITUDES[covered], found, std, _away_from_jumps(design)[covered])


def _worn(profile: Profile, depth: float) -> Profile:
    """Return a profile worn by ``depth``, mm."""
    away = (profile.y - WORN_AT) / WORN_OVER
    removed = depth * 1e-3 * np.exp(-0.5 * away**2) * (1.0 if profile.kind == "rail" else -1.0)
    slope = profile.slope - removed * away / WORN_OVER
    return Profile(profile.kind, profile.name, profile.y, profile.z + removed, slope)


def _noise(random: np.random.Generator, count: int, std: float, over: float) -> FloatArray:
    """Return noise (count,), mm, which neighbours share with exponential correlation over ``over`` mm of arc."""
    alike = float(np.exp(-SPACING / over)) if over else 0.0
    white = random.normal(0.0, std, count)
    if not alike:
        return white
    white[1:] *= np.sqrt(1.0 - alike**2)
    return np.asarray(lfilter([1.0], [1.0, -alike], white))


def _points(profile: Profile) -> FloatArray:
    """Return points (n, 2) along a profile, mm."""
    y, z = profile.y * 1e3, profile.z * 1e3
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(y), np.diff(z)))])
    across = np.clip(np.interp(np.arange(0.0, arc[-1], SPACING), arc, y), y[0], y[-1])
    return np.column_stack([across, np.interp(across, y, z)])


def _conicity(wheelset: WheelsetOnTrack) -> FloatArray:
    curve = radius_difference_curve(wheelset, DISPLACEMENT, method=ContactMethod.EN15302)
    return equivalent_conicity(curve.displacement, curve.difference, AMPLITUDES)


def _away_from_jumps(wheelset: WheelsetOnTrack) -> BoolArray:
    """Return at which amplitudes no contact of the design jumps, or moves as fast, near the end of the travel."""
    table = contact_table(wheelset, np.linspace(-7e-3, 7e-3, 281), method=ContactMethod.EN15302, outside="hold")
    y = table.lateral_displacement
    positions = np.column_stack([table.contact_position_left[:, 0], table.contact_position_right[:, 0]])
    ends = [[np.abs(y - side * amplitude) <= NEAR for side in (-1, 1)] for amplitude in AMPLITUDES]
    return np.array([all(np.ptp(positions[near], axis=0).max() <= MOVES for near in both) for both in ends])

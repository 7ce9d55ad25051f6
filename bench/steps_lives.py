"""Simulated wheelset lives with what happens to them: conicities of intervals, and findings of a suspension.

A stated standard deviation is mostly what all intervals of a wheelset have in common (0.01 to 0.07), with sampling
noise of 0.001 to 0.01 besides. Wear is straight, saturating or accelerating; friction changes with the season and with
fallen leaves; intervals are now and then outliers, alone or two on end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.trend.change_point import StepModel
from estimation.values.arrays import FloatArray
from estimation.values.geometry import IntervalConicities, KnownConicity
from estimation.values.units import DAY_NS

HISTORIES = (3, 6, 12, 30, 60, 120, 240)  # intervals before a step
LEAST = 0.04  # conicity: an outlier is never below it
BEGIN_NS = 1_700_000_000 * 10**9
AMPLITUDES = (0.002, 0.0025, 0.003)
LIMIT = 0.4
INTERVAL_KM = (1000.0, 1000.0, 1000.0, 3000.0, 10_000.0)
SHAPES = ["straight", "saturating", "accelerating"]  # of wear; "falling" besides, where it lessens the conicity
RATES = (0.3e-6, 2e-6)  # of wear, per km
OUTLIERS = (0.03, 0.2)  # smallest and largest
MIXED = (0.2, 0.8)  # share of the step in an interval of both sides
TAILS = 3.0  # degrees of freedom
MOST_KM, MOST_WEAR = 300_000.0, 0.35  # of a profile


@dataclass(frozen=True, slots=True)
class Life:
    """Intervals of a wheelset, with the truth about its step."""

    records: tuple[IntervalConicities, ...]
    first: int | None  # of the intervals wholly behind the step; None where there is none
    size: float
    event_km: float | None
    level: FloatArray  # (k,) true conicity without season
    worn: FloatArray  # (k,) without the step, too
    weather: FloatArray  # (k,) of the season
    noise: FloatArray  # (k,) standard deviations


@dataclass(frozen=True, slots=True)
class Case:
    """What happens to a wheelset."""

    history: int  # intervals before the step, or all of them
    size: float = 0.0
    behind: int = 12  # intervals
    mixed: bool = False  # one interval is of both sides
    doubles: float = 0.0  # chance of two outliers on end
    singles: float = 0.02  # chance of an outlier
    season: bool = True
    shape: str = ""  # of wear; by chance where empty
    km: float = 0.0  # of an interval; by chance where 0
    scatter: float = 1.0  # of the noise that is not stated
    tails: bool = False  # noise of Student's t with three degrees of freedom
    understated: float = 1.0  # stated standard deviations are smaller by so much


def life(case: Case, seed: int) -> Life:
    """Return a wheelset life."""
    rng = np.random.default_rng(seed)
    mixed = int(case.mixed and case.size != 0.0)
    k = case.history + (0 if case.size == 0.0 else mixed + case.behind)
    km = case.km or float(rng.choice([one for one in INTERVAL_KM if one * k <= MOST_KM]))
    km_per_year = float(np.clip(np.exp(rng.normal(np.log(120_000.0), 0.4)), km * 8.0, 3e5))
    x = km * (np.arange(k) + rng.uniform(0.3, 0.7, k))
    start = float(rng.uniform(0.05, 0.25)) + max(0.0, -case.size)
    wear = _wear(x, case.shape or str(rng.choice(SHAPES)), rng)
    worn = start + wear - min(0.0, float(wear[-1]))
    behind = np.zeros(k)
    if case.size != 0.0:
        behind[case.history + mixed :] = 1.0
        behind[case.history : case.history + mixed] = rng.uniform(*MIXED)
    level = worn + case.size * behind
    days = x / km_per_year * 365.25
    weather = _season(days, rng) if case.season else np.zeros(k)
    value = level + weather + _outliers(k, case, rng)
    value = np.where(value < LEAST, 2.0 * LEAST - value, value)
    noise = float(np.exp(rng.uniform(np.log(0.001), np.log(0.01)))) * rng.uniform(0.7, 1.4, k)
    common = float(rng.uniform(0.01, 0.07))
    drawn = rng.standard_t(TAILS, k) / np.sqrt(TAILS / (TAILS - 2.0)) if case.tails else rng.standard_normal(k)
    value = value + min(common, LEAST) * rng.uniform(-0.5, 0.5) + case.scatter * noise * drawn
    std = np.hypot(common * rng.uniform(0.95, 1.05, k), noise) / case.understated
    stds = zip(std, noise / case.understated, strict=True)
    width = km / km_per_year * 365.25
    records = tuple(_record(i, x[i], days[i], width, value[i], *pair) for i, pair in enumerate(stds))
    stepped = case.size != 0.0
    event_km = float(km * (case.history + 0.5 * mixed)) if stepped else None
    return Life(
        records,
        case.history + mixed if stepped else None,
        case.size,
        event_km,
        level,
        worn,
        weather,
        case.scatter * noise,
    )


def _wear(x: FloatArray, shape: str, rng: np.random.Generator) -> FloatArray:
    rate, scale = rng.uniform(*RATES), rng.uniform(5e4, 3e5)
    u = x - x[0]
    wear = rate * u
    if shape == "saturating":
        wear = rate * scale * (1.0 - np.exp(-u / scale))
    elif shape == "accelerating":
        wear = rate * u * (1.0 + 0.5 * u / scale)
    elif shape == "falling":
        wear = -rate * u
    return np.asarray(wear * min(1.0, MOST_WEAR / abs(wear[-1])))


def _season(days: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return what friction does to a conicity: a wave over the year, and some weeks of fallen leaves or frost."""
    size, leaves = rng.uniform(0.0, 0.012), rng.uniform(-0.025, 0.025)
    day = (days + rng.uniform(0.0, 365.25)) % 365.25
    return np.asarray(size * np.sin(2.0 * np.pi * day / 365.25) + leaves * ((day > 280.0) & (day < 325.0)))


def _outliers(k: int, case: Case, rng: np.random.Generator) -> FloatArray:
    """Return outliers; two on end have one cause and about one size."""
    out = np.zeros(k)
    single = rng.random(k) < case.singles
    out[single] = rng.choice([-1.0, 1.0], single.sum()) * rng.uniform(*OUTLIERS, single.sum())
    for i in np.flatnonzero(rng.random(k - 1) < case.doubles):
        out[i : i + 2] = rng.choice([-1.0, 1.0]) * rng.uniform(*OUTLIERS) * rng.uniform(0.9, 1.1, 2)
    return out


def _record(
    number: int, x: float, days: float, width: float, value: float, std: float, noise: float
) -> IntervalConicities:
    middle = BEGIN_NS + round(days * DAY_NS)
    half = round(0.25 * width * DAY_NS)
    known = tuple(
        KnownConicity(a, float(value) * (0.8 + 0.2 * a / 0.003), float(std), float(noise)) for a in AMPLITUDES
    )
    return IntervalConicities(
        0, number, float(x), middle - half, middle + half, 5, f"{number:064x}", "bench", known, None
    )


NEWEST = 16  # intervals that it looks at
DOUBLES = 0.003  # chance of two outliers on end, of which there may be some everywhere
ALIKE = 0.1  # relative, by which these differ
NODES = np.linspace(-5.0, 5.0, 15)  # standard deviations about every point: a level is near some point
SLOPES = np.linspace(*RATES, 25)  # per km
TINY = float(np.finfo(np.float64).tiny)
MODEL = StepModel()


def odds(given: Life, until: int, *, wear: bool) -> float:
    """Return the log odds of a step among the newest intervals."""
    part = slice(max(0, until - NEWEST), until)
    records, noise = given.records[part], given.noise[part]
    x = np.array([one.mileage_km for one in records])
    value = np.array([one.known[-1].value for one in records]) - given.weather[part]
    if wear:
        pairs = [_evidence(value - given.worn[part], noise)]
    else:
        pairs = [_evidence(value - slope * (x - x[-1]), noise) for slope in SLOPES]
    nothing, stepped = np.array(pairs).T
    return float(np.logaddexp.reduce(stepped) - np.logaddexp.reduce(nothing))


def _evidence(value: FloatArray, noise: FloatArray) -> tuple[float, float]:
    """Return log evidence of no step and of a step of any place, in an interval or between two."""
    level = np.unique((value + np.outer(NODES, noise)).ravel())
    weight = np.gradient(level)
    off = value[:, None] - level
    before, behind = _forward(off, noise), _forward(off[::-1], noise[::-1])[::-1]
    size = level - level[:, None]
    prior = np.exp(-0.5 * (size / MODEL.step_std) ** 2) / (MODEL.step_std * np.sqrt(2.0 * np.pi))
    prior *= weight[:, None] * weight
    stepped = 0.0
    for at in range(MODEL.least_good, len(value) - MODEL.least_good + 1):
        stepped += 0.5 * float(before[at] @ prior @ behind[at])
        if at + 1 <= len(value) - MODEL.least_good:
            share = np.divide(value[at] - level[:, None], size, out=np.zeros_like(size), where=size != 0.0)
            within = (share > MIXED[0]) & (share < MIXED[1])
            density = within / np.maximum((MIXED[1] - MIXED[0]) * np.abs(size), noise[at])
            stepped += 0.5 * float(before[at] @ (prior * density) @ behind[at + 1])
    nothing = float(weight @ before[-1])
    return float(np.log(max(nothing, TINY))), float(np.log(max(MODEL.step_chance * stepped, TINY)))


def _forward(off: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the likelihood (k + 1, n) of the first points about each level, with outliers alone or two on end."""
    chance = Case(0).singles
    size = np.abs(off)
    outlier = 0.5 * ((size > OUTLIERS[0]) & (size < OUTLIERS[1])) / (OUTLIERS[1] - OUTLIERS[0])
    good = _normal(off, noise[:, None])
    found = np.ones((len(off) + 1, off.shape[1]))
    for i in range(len(off)):
        found[i + 1] = found[i] * ((1.0 - chance - DOUBLES) * good[i] + chance * outlier[i])
        if i > 0:
            apart = np.hypot(ALIKE * off[i - 1], np.hypot(noise[i], noise[i - 1]))
            found[i + 1] += found[i - 1] * DOUBLES * outlier[i - 1] * _normal(off[i] - off[i - 1], apart)
    return found


def _normal(off: FloatArray, std: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * (off / std) ** 2) / (std * np.sqrt(2.0 * np.pi)))

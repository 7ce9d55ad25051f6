"""Simulated wear of whole railways, seeded: what is on file of every wheelset, and what is true of it.

A railway has classes of vehicles, lines and positions of axles, by which wear differs; wheelsets of one fleet (class
and line) wear alike, with heavy tails, and a few leave their fleet. A published number has noise, a part common to all
numbers of its wheelset, and a scale common to all of its line; all are honestly stated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bench.forecast_scores import HORIZON_KM
from estimation.values.arrays import FloatArray

LAWS = ("straight", "running-in", "knee seen", "saturating", "accelerating", "outliers", "season")
POSITIONS = (1.0, 0.85, 1.1, 0.9)  # times the rate, by axle
RATE, RATE_SPREAD, LINE_SPREAD = 1e-6, 0.4, 0.25  # per km; of logarithms
WHEELSET_SPREAD, TAILS = 0.12, 3.0  # of logarithms; degrees of freedom
LEAVING, LEFT_SPREAD = 0.05, 0.7  # share of the wheelsets that wear on their own, and how far
CHANGE, CHANGE_SPREAD = 0.3, 0.5  # chance that the rate changes some day, where laws are mixed
STARTS, START_SPREAD = (0.05, 0.15), 0.01
SPANS = (4.5e3, 2e5)  # km, alike on a logarithmic scale: of some wheelsets little is known but their fleet
CURVED_KM, RUN_IN_KM = (5e4, 4e5), (5e3, 3e4)  # within which wear saturates or accelerates; and runs in
OUTLIERS = (0.05, 5.0, 20.0)  # share, smallest and largest in stds
SEASON = (0.004, 0.012)
MOST_MEASURED, MEASURED_STD, MEASURED_KM = 3, 0.006, 500.0  # profiles of a wheelset; off the point beside
NODES = 4001  # of the way to the horizon
STEP_KM = 1.0  # of a difference quotient

Curve = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Observed:
    """What is on file of a wheelset since its last reprofiling.

    Attributes:
        x: Mileage (k,) of the points, km.
        days: When they were measured (k,).
        std: Of each point (k,), of all its errors together.
        noise: Of these, what has nothing in common with any other point (k,).
        constant_std: What all points of the wheelset have in common.
        scale_std: Relative; what all points of the line have in common.
        measured: Mileage, value and std (m, 3) by measured profiles.
    """

    vehicle_class: str
    line: str
    position: int
    x: FloatArray
    days: FloatArray
    value: FloatArray
    std: FloatArray
    noise: FloatArray
    constant_std: float
    scale_std: float
    limit: float
    measured: FloatArray


@dataclass(frozen=True, slots=True)
class Life:
    """A wheelset, with what is true at its last point and when its limit is reached (inf: not within the horizon)."""

    observed: Observed
    law: str
    level: float
    slope: float  # per km
    distance_km: float


@dataclass(frozen=True, slots=True)
class Railway:
    """What is simulated.

    Attributes:
        law: Of all wheelsets; drawn by fleet where empty, by wheelset where mixed, which may change besides.
        points: Numbers of points of which each wheelset has one.
        noise: Smallest and largest std of it.
        ahead: Where the limit is the true level of the wheelset so far ahead, in spans; None where it is of the fleet.
        ahead_km: The same in km.
        scatter: By how much stated noise is too small.
        measured: How often the profiles of each wheelset were measured.
    """

    law: str = ""
    mixed: bool = False
    classes: int = 5
    lines: int = 5
    vehicles: int = 3
    points: tuple[int, ...] = (3, 6, 12, 25)
    spans: tuple[float, float] = SPANS
    noise: tuple[float, float] = (0.0012, 0.005)
    constant_std: float = 0.01
    scale_std: float = 0.03
    ahead: tuple[float, float] | None = None
    ahead_km: float | None = None
    scatter: float = 1.0
    measured: int = 0


ALIKE, MIXED = Railway(), Railway(mixed=True)
OF_LAWS: Mapping[str, Railway] = {
    law: Railway(
        law=law, lines=3, spans=(3e4, 2e5), noise=(0.003, 0.012), constant_std=0.0, scale_std=0.0, ahead=(0.1, 1.2)
    )
    for law in LAWS
}
DEMO = Railway(
    law="straight",
    classes=1,
    lines=1,
    points=(10,),
    spans=(297e3, 300e3),
    noise=(0.001, 0.0015),
    constant_std=0.005,
    scale_std=0.05,
    ahead_km=1e5,
)
"""As the demo: ten campaigns over 300,000 km, a class on one line."""


WIDE = replace(ALIKE, constant_std=0.03, scale_std=0.05)
"""Fleets whose levels err far more than their points scatter, as on unknown track."""


def lives(railway: Railway, seed: int) -> list[Life]:
    """Return all wheelsets of a railway, fleet by fleet."""
    rng = np.random.default_rng([seed, 3801])
    rates = RATE * np.exp(RATE_SPREAD * rng.standard_normal(railway.classes))
    lines = np.exp(LINE_SPREAD * rng.standard_normal(railway.lines))
    scales = 1.0 + railway.scale_std * rng.standard_normal(railway.lines)
    every: list[Life] = []
    for of_class, line in product(range(railway.classes), range(railway.lines)):
        names = (f"class {of_class + 1}", f"line {line + 1}")
        every += _fleet(railway, names, float(rates[of_class] * lines[line]), float(scales[line]), rng)
    return every


def _fleet(railway: Railway, names: tuple[str, str], rate: float, scale: float, rng: np.random.Generator) -> list[Life]:
    law, start = railway.law or str(rng.choice(LAWS)), float(rng.uniform(*STARTS))
    turning = float(rng.uniform(0.15, 0.4))  # mean growth up to the limit
    wear_km = float(rng.uniform(*CURVED_KM))
    found = []
    for _, position in product(range(railway.vehicles), range(len(POSITIONS))):
        own = str(rng.choice(LAWS)) if railway.mixed else law
        spread = WHEELSET_SPREAD * rng.standard_t(TAILS)
        spread += LEFT_SPREAD * rng.standard_normal() * (rng.random() < LEAVING)
        own_rate = rate * POSITIONS[position] * float(np.exp(np.clip(spread, -2.0, 2.0)))
        span = _span(railway, rng)
        level = _curve(own, start + START_SPREAD * rng.standard_normal(), own_rate, span, wear_km, rng)
        if railway.mixed and rng.random() < CHANGE:
            level = _changed(level, span * rng.uniform(0.2, 2.0), float(np.exp(CHANGE_SPREAD * rng.standard_normal())))
        found.append(_life(railway, (*names, position + 1), own, level, span, start + turning, scale, rng))
    return found


def _span(railway: Railway, rng: np.random.Generator) -> float:
    low, high = railway.spans
    return float(low * (high / low) ** rng.uniform())


def _curve(law: str, start: float, rate: float, span: float, wear_km: float, rng: np.random.Generator) -> Curve:
    """Return the true level by mileage since the last reprofiling."""
    if law == "running-in":
        first, within = float(rng.uniform(0.02, 0.08)), float(rng.uniform(*RUN_IN_KM))
        return lambda x: start + first * (1.0 - np.exp(-x / within)) + rate * x
    if law == "knee seen":
        at, factor = span * float(rng.uniform(0.3, 0.7)), float(np.exp(np.clip(0.6 * rng.standard_normal(), -1.2, 1.2)))
        return _changed(lambda x: start + rate * x, at, factor)
    if law == "saturating":
        return lambda x: start + rate * wear_km * (1.0 - np.exp(-x / wear_km))
    if law == "accelerating":
        return lambda x: start + rate * x * (1.0 + 0.5 * x / wear_km)
    return lambda x: start + rate * x


def _changed(level: Curve, at: float, factor: float) -> Curve:
    """Return a curve that grows by a factor faster from a mileage on."""
    there = level(np.array([at]))[0]
    return lambda x: np.where(x <= at, level(x), there + factor * (level(x) - there))


def _life(
    railway: Railway,
    place: tuple[str, str, int],
    law: str,
    level: Curve,
    span: float,
    limit: float,
    scale: float,
    rng: np.random.Generator,
) -> Life:
    count = int(rng.choice(railway.points))
    x = np.sort(np.concatenate([[0.0, span], rng.uniform(0.0, span, count - 2)]))
    if railway.ahead is not None:
        limit = float(level(np.array([span * (1.0 + rng.uniform(*railway.ahead))]))[0])
    elif railway.ahead_km is not None:
        limit = float(level(np.array([span + railway.ahead_km]))[0])
    days = 365.25 * x / float(np.exp(rng.normal(np.log(120_000.0), 0.3)))
    noise = rng.uniform(*railway.noise, count)
    true = level(x)
    value = scale * (true + _weather(law, days, rng)) + railway.constant_std * rng.standard_normal()
    value += railway.scatter * noise * rng.standard_normal(count)
    if law == "outliers":
        wrong = rng.random(count) < OUTLIERS[0]
        value[wrong] += rng.choice([-1.0, 1.0], wrong.sum()) * rng.uniform(*OUTLIERS[1:], wrong.sum()) * noise[wrong]
    std = np.sqrt(noise**2 + railway.constant_std**2 + (railway.scale_std * value) ** 2)
    # of a generator of its own: the same lives, measured or not
    measured = _measured(x, level, rng.spawn(1)[0])[: railway.measured]
    observed = Observed(*place, x, days, value, std, noise, railway.constant_std, railway.scale_std, limit, measured)
    now, before = level(np.array([span, span - STEP_KM]))
    return Life(observed, law, float(now), float(now - before) / STEP_KM, _reached(level, span, limit))


def _measured(x: FloatArray, level: Curve, rng: np.random.Generator) -> FloatArray:
    """Return profiles measured near some points (k,), in any order: mileage, value and std (m, 3)."""
    at = np.maximum(0.0, rng.choice(x, MOST_MEASURED) + rng.uniform(-MEASURED_KM, MEASURED_KM, MOST_MEASURED))
    value = level(at) + MEASURED_STD * rng.standard_normal(MOST_MEASURED)
    return np.column_stack([at, value, np.full(MOST_MEASURED, MEASURED_STD)])


def _weather(law: str, days: FloatArray, rng: np.random.Generator) -> FloatArray:
    size, phase = float(rng.uniform(*SEASON)), float(rng.uniform(0.0, 2.0 * np.pi))
    return np.asarray((law == "season") * size * np.sin(2.0 * np.pi * days / 365.25 + phase))


def _reached(level: Curve, span: float, limit: float) -> float:
    """Return how far ahead of the last point the limit is first reached, km; inf beyond the horizon."""
    ahead = np.linspace(0.0, HORIZON_KM, NODES)
    growth = np.maximum.accumulate(level(span + ahead))
    at = int(np.searchsorted(growth, limit))
    if at in {0, NODES}:
        return 0.0 if at == 0 else float("inf")
    return float(np.interp(limit, growth[at - 1 : at + 1], ahead[at - 1 : at + 1]))

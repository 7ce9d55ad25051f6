"""Alerts at the conicity limit: ``python -m bench limits [--shapes N] [--wheelsets N] [--seeds 31-34] ...``.

Worn wheelsets of shapes that the extrapolation does not hold run over irregular track; those that cover 1.5 to 2.25 mm
live for some intervals and are judged by the real trend and the real rules. All wheelsets of a seed run on tracks of
one shape, and those of one curve are raised, or not, together: several seeds decide.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from bench.made_values import made_geometry
from bench.report import BenchRow, row_bench, say
from bench.study import seeds_of
from bench.worn_family import AMPLITUDES, CLASSES, DISPLACEMENT, amplitude_reached, curve_of
from estimation.alerts.rule_book import RuleBook, findings
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, MeasureRule
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.contact.conicity import equivalent_conicity
from estimation.jobs.refresh_trends import trend_of
from estimation.trend.trend import TrendParameters
from estimation.values.arrays import FloatArray
from estimation.values.geometry import (
    GeometryRecord,
    WheelsetGeometry,
    interval_conicities,
)
from estimation.values.quantities import Estimate, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord

HISTORIES = (0, 6, 20)  # intervals before the last state
LAST = 3  # intervals in it
NEW_SHARE = 0.6  # of the conicity of the last state, when new
HASTE = 3.0  # of the wear: its rate grows by e to this
STDS = (0.004, 0.02)  # stated, of a conicity
COMMON, NEW = 0.85, 0.5  # of the stated std: what all intervals share, and what is new in each
NEAR = 0.5e-3  # m, within which errors are alike
INTERVAL_KM, INTERVAL_NS = 1000.0, 10**15
FROM_NS = 1_700_000_000_000_000_000
NOT_COVERED = Estimate.unknown(Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "not covered"))
BINS = 2


@dataclass(frozen=True, slots=True)
class Worn:
    """A worn wheelset: its true conicities at ``AMPLITUDES`` (a,), how far it moves (m), its vehicle's speed (m/s)."""

    kind: str
    conicity: FloatArray
    covered: float
    speed: float
    seed: int

    @property
    def above(self) -> float:
        """By how much the true conicity at 3 mm is above the limit."""
        return float(self.conicity[-1] - limit_at(self.speed))

    @property
    def above_reached(self) -> float:
        """By how much the true conicity at the amplitude covered is above the limit."""
        return float(self.conicity[_covered(self) - 1] - limit_at(self.speed))


@dataclass(frozen=True, slots=True)
class Judged:
    """What is raised of a wheelset after three intervals in its last state."""

    worn: Worn
    over: bool  # `conicity_limit`
    measure: bool


def limit_at(speed: float) -> float:
    """Return the shipped limit at a speed, m/s."""
    limit = ConicityLimitRule().limit_at("any", 3.6 * speed)
    assert limit is not None
    return limit


def judged(worn: Worn) -> Judged:
    """Return what the rules raise of a wheelset."""
    records = _records(worn)
    conicities = [interval_conicities(one) for one in records]
    trend = trend_of(conicities, limit_at(worn.speed), TrendParameters())
    mounting = Mounting("W", "V", 1, FROM_NS - 1, None, 0.0, 0.0)
    facts = WheelsetFacts(
        wheelset=WheelsetRecord("W", "F", "P8", 0.45, mounting),
        vehicle=VehicleRecord("V", "F", "any", 4, worn.speed, (0.0, 2.5, 15.0, 17.5)),
        geometry=records[-1],
        trend=TrendRecord("W", 0, trend, "d", "v", 1),
        windows=(),
        intervals=records,
        conicities=conicities,
    )
    book = RuleBook(rules=(ConicityLimitRule(), MeasureRule()))
    stands = {one.kind: bool(one.stands) for one in findings(facts, book, records[-1].to_ns)}
    return Judged(worn, stands[ConicityLimitRule.kind], stands[MeasureRule.kind])


def _records(worn: Worn) -> list[GeometryRecord]:
    random = np.random.default_rng(worn.seed)
    history = int(random.choice(HISTORIES))
    run = np.linspace(0.0, 1.0, history, endpoint=False)
    worn_off = np.concatenate([np.expm1(HASTE * run) / np.expm1(HASTE), np.ones(LAST)])
    share = NEW_SHARE + (1.0 - NEW_SHARE) * worn_off
    std = float(random.uniform(*STDS))
    near = np.exp(-np.abs(np.subtract.outer(AMPLITUDES, AMPLITUDES)) / NEAR)
    alike = np.linalg.cholesky(0.5 + 0.5 * near)
    common = COMMON * std * alike @ random.standard_normal(len(AMPLITUDES))
    records = []
    for k, part in enumerate(share):
        value = part * worn.conicity + common + NEW * std * alike @ random.standard_normal(len(AMPLITUDES))
        geometry = _geometry(np.maximum(value, 1e-3), std, _covered(worn))
        at = FROM_NS + k * INTERVAL_NS
        records.append(
            GeometryRecord(
                "W", 0, k, INTERVAL_KM * (k + 0.5), at, at + INTERVAL_NS - 1, geometry, f"{k}", {}, {}, "v", 1
            )
        )
    return records


def _covered(worn: Worn) -> int:
    return int(np.searchsorted(AMPLITUDES, worn.covered + 1e-6))


def _geometry(value: FloatArray, std: float, covered: int) -> WheelsetGeometry:
    known = [with_interval(float(one), std, count=6.0) for one in value[:covered]]
    return made_geometry(
        np.linspace(-1e-3, 1e-3, BINS + 1),
        None,
        AMPLITUDES,
        conicity=(*known, *[NOT_COVERED] * (len(AMPLITUDES) - covered)),
        reported_amplitude=float(AMPLITUDES[covered - 1]),
        equivalent_conicity=known[-1],
    )


IRREGULARITIES = (0.4e-3, 0.55e-3, 0.7e-3, 0.9e-3, 1.2e-3)  # m
YAW_SPRINGS = (0.15, 0.6)  # kappa, 1/m
SPEEDS = tuple(v / 3.6 for v in (120.0, 160.0, 200.0, 250.0, 300.0))  # with limits of 0.40 to 0.20
LEAST, MOST = 0.05, 0.8  # conicity at 3 mm
COVERED = (1.5e-3, 2.25e-3)  # m
ASKED = (1.75e-3, 2.0e-3)  # m
MARGIN = 0.03
BEYOND_SHARE = 0.7  # of the wheelsets: beyond the limit, the others below it
BANDS = ((0.03, 0.1), (0.1, 0.2), (0.2, 1.0))


def _measured(options: argparse.Namespace, _folder: Path) -> Iterator[BenchRow]:
    found = []
    for seed in seeds_of(options.seeds):
        found += [judged(worn) for worn in worn_wheelsets(options.shapes, options.wheelsets, seed)]
        say(f"seed {seed}: {len(found)} wheelsets judged")
    yield from rows(found)


def worn_wheelsets(shapes: int, most: int, seed: int) -> list[Worn]:
    """Return worn wheelsets that cover less than 3 mm, each on some track under a vehicle of some speed."""
    random = np.random.default_rng(seed)
    drawn = [(kind, curve_of(kind, random)) for _, kind in product(range(shapes), CLASSES)]
    kinds, curves = zip(*[(kind, curve) for kind, curve in drawn if curve is not None], strict=True)
    conicity = np.stack([equivalent_conicity(DISPLACEMENT, curve, AMPLITUDES) for curve in curves])
    with np.errstate(invalid="ignore"):
        usual = np.flatnonzero((conicity[:, -1] > LEAST) & (conicity[:, -1] < MOST) & np.isfinite(conicity).all(axis=1))
    of_shape, on_track = (np.array(one) for one in zip(*product(usual, IRREGULARITIES), strict=True))
    springs = random.uniform(*YAW_SPRINGS, len(of_shape))
    reached = amplitude_reached(np.stack(curves)[of_shape], on_track, springs, seed)
    covered = np.floor(reached / 0.25e-3 + 1e-9) * 0.25e-3
    kept = np.flatnonzero((covered >= COVERED[0] - 1e-9) & (covered <= COVERED[1] + 1e-9))
    every = [
        Worn(kinds[of_shape[i]], conicity[of_shape[i]], float(covered[i]), speed, int(i) * len(SPEEDS) + k)
        for i, (k, speed) in product(kept, enumerate(SPEEDS))
    ]
    beyond = [one for one in every if one.above >= MARGIN]
    below = [one for one in every if one.above <= -MARGIN]
    shares = ((beyond, round(BEYOND_SHARE * most)), (below, most - round(BEYOND_SHARE * most)))
    return [group[int(i)] for group, count in shares for i in random.permutation(len(group))[:count]]


def rows(found: Sequence[Judged]) -> Iterator[BenchRow]:
    """Yield the rows of the table."""
    asked = [one for one in found if ASKED[0] - 1e-9 <= one.worn.covered <= ASKED[1] + 1e-9]
    beyond = [one for one in asked if one.worn.above >= MARGIN]
    raised, over = _share(beyond, lambda one: one.over or one.measure), _share(beyond, lambda one: one.over)
    yield BenchRow(
        f"beyond the limit by {MARGIN:g} or more at 3 mm, 1.75 or 2 mm covered, {_size(beyond)}: raised",
        f"{raised:.1%} (`conicity_limit` {over:.1%})",
        "98 % or more",
        raised >= 0.98,
    )
    share = over / raised if raised else 0.0
    yield BenchRow("of those raised: `conicity_limit`", f"{share:.1%}", "60 % or more", share >= 0.6)
    below = [one for one in found if one.worn.above <= -MARGIN]
    quiet = [one for one in below if one.worn.above_reached <= 0.0]
    for name, group in (("at 3 mm", below), ("at 3 mm and at or below it at the amplitude reached", quiet)):
        false = _share(group, lambda one: one.over)
        yield BenchRow(
            f"below the limit by {MARGIN:g} or more {name}, {_size(group)}: `conicity_limit`",
            f"{false:.2%}",
            "1 % or less",
            false <= 0.01,
        )
    yield from _for_information(found)


def _for_information(found: Sequence[Judged]) -> Iterator[BenchRow]:
    for covered in (1.5e-3, 1.75e-3, 2e-3, 2.25e-3):
        group = [one for one in found if one.worn.above >= MARGIN and abs(one.worn.covered - covered) < 1e-6]
        yield from _counted(f"beyond by {MARGIN:g} or more, {1e3 * covered:g} mm covered", group)
    for kind in CLASSES:
        group = [one for one in found if one.worn.above >= MARGIN and one.worn.kind == kind]
        yield from _counted(f"beyond by {MARGIN:g} or more, {kind}", group)
    for low, high in BANDS:
        group = [one for one in found if low <= one.worn.above < high]
        yield from _counted(f"beyond by {low:g} to {high:g}", group)
    for low, high in BANDS:
        group = [one for one in found if low <= -one.worn.above < high]
        yield from _counted(f"below by {low:g} to {high:g}", group)
    for speed in SPEEDS:
        far = [one for one in found if one.worn.speed == speed and one.worn.conicity[-1] < 0.5 * limit_at(speed)]
        yield from _counted(f"below half of a limit of {limit_at(speed):.3f}", far)


def _counted(name: str, group: Sequence[Judged]) -> Iterator[BenchRow]:
    if group:
        text = f"`conicity_limit` {_share(group, lambda one: one.over):.1%}, `measure`"
        text += f" {_share(group, lambda one: one.measure and not one.over):.1%}"
        yield BenchRow(f"{name}, {len(group)} wheelsets", text, "for information", True)  # noqa: FBT003 - nothing to be reached


def _size(group: Sequence[Judged]) -> str:
    """Return how many wheelsets of how many shapes: those of one shape are raised, or not, together."""
    return f"{len(group)} wheelsets of {len({one.worn.conicity.tobytes() for one in group})} shapes"


def _share(group: Sequence[Judged], holds: Callable[[Judged], bool]) -> float:
    return float(np.mean([holds(one) for one in group])) if group else 0.0


main = row_bench(
    "limits",
    "Alerts at the conicity limit",
    __doc__,
    _measured,
    {
        "shapes": (300, "drawn of each class"),
        "wheelsets": (850, "of a seed that are judged, at most"),
        "seeds": ("11", "as in 31-34 or 3"),
    },
).run

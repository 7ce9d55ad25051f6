"""Lives of worn wheelsets as the rules see them: conicities of intervals with the errors that real geometries have.

A life wears faster and faster up to its last state, in which it stays for three intervals. An interval knows the
conicity up to the amplitude that the wheelset covers, with a standard deviation of which most is common to all
intervals of the wheelset (stretch, stiffness, places of jumps) and the rest is new in each; neighbouring amplitudes
share most of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.worn_family import AMPLITUDES
from estimation.alerts.rule_book import RuleBook, findings
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, MeasureRule
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.jobs.refresh_trends import trend_of
from estimation.trend.extrapolation import conicity_points
from estimation.trend.trend import TrendParameters, probability_above
from estimation.trend.wear_curve import fit_wear_curve
from estimation.values.arrays import FloatArray
from estimation.values.geometry import (
    BinStatus,
    BinValues,
    GeometryRecord,
    IntervalConicities,
    WheelsetGeometry,
    interval_conicities,
)
from estimation.values.quantities import Estimate, Status, with_interval
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
FORMER_LEAST, FORMER_STD = 2e-3, 0.1  # of the rule before: the fitted trend at 3 mm from 2 mm on, where it is sharp
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
    former: bool  # by the rule before


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
    return Judged(worn, stands[ConicityLimitRule.kind], stands[MeasureRule.kind], _former(conicities, worn))


def _former(records: Sequence[IntervalConicities], worn: Worn) -> bool:
    """Return whether the smooth curve at 3 mm alone is over the limit in any of the last three intervals."""
    chosen = conicity_points(records)
    if chosen.not_comparable is not None or worn.covered < FORMER_LEAST - 1e-9:
        return False
    x, value, std = (np.array([getattr(p, name) for p in chosen.points]) for name in ("mileage_km", "value", "std"))
    rule = ConicityLimitRule()
    for end in range(len(x) - LAST + 1, len(x) + 1):
        if end < 2:
            continue
        level = fit_wear_curve(x[:end], value[:end], std[:end]).shifted(chosen.spread).level_now().estimate(end)
        over = probability_above(level, limit_at(worn.speed)) or 0.0
        if (level.std or 0.0) <= FORMER_STD and over >= rule.raise_probability:
            return True
    return False


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
    nothing = np.full(BINS, np.nan)
    unseen = BinValues(nothing, nothing, (BinStatus.UNOBSERVABLE,) * BINS)
    return WheelsetGeometry(
        bin_edges=np.linspace(-1e-3, 1e-3, BINS + 1),
        samples=np.zeros(BINS),
        rolling_radius_sum=unseen,
        rolling_radius_difference=unseen,
        contact_angle_sum=unseen,
        contact_angle_difference=unseen,
        amplitude=AMPLITUDES,
        conicity=(*known, *[NOT_COVERED] * (len(AMPLITUDES) - covered)),
        reported_amplitude=float(AMPLITUDES[covered - 1]),
        equivalent_conicity=known[-1],
        nonlinearity=NOT_COVERED,
        zero_crossing=NOT_COVERED,
        windows=8,
        parameter_key="k",
        status=Status.ESTIMATED,
    )

"""Sudden changes: ``python -m bench steps [--lives 24] [--quiet-lives 420] [--seed 20000] [--write-docs]``.

Every life is simulated (``steps_lives``) and goes through the code that trends are made with, one interval after the
other. Constants of the conicity were chosen on lives of other seeds than those shown.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.report import BenchRow, row_bench
from bench.steps_lives import DAY_NS, HISTORIES, LIMIT, MODEL, Case, Life, life, odds
from bench.steps_others import suspension_rows, turned_rows
from estimation.jobs.refresh_trends import trend_of
from estimation.trend.extrapolation import conicity_points
from estimation.trend.trend import TrendParameters, newest_step
from estimation.trend.wear_curve import fit_wear_curve
from estimation.values.trend import TrendStep

RIVAL_LIVES, TROUBLED_LIVES = 24, 4
SIZES = (0.05, -0.05, 0.1, -0.1, 0.2, -0.2)
REACH = {0.05: None, 0.1: 4, 0.2: 3}  # intervals
WITHIN = 0.98  # of the lives
QUIET = {
    "single outliers, seasons, all laws of wear": Case(120),
    "the same with two outliers on end": Case(120, doubles=0.003),
    "accelerating wear, turned and registered": Case(120, shape="accelerating"),
    "wear that lessens the conicity": Case(120, shape="falling"),
}
TROUBLES = {
    "noise of twice the stated size": Case(120, scatter=2.0),
    "standard deviations understated five times": Case(120, understated=5.0),
    "heavy tails (Student's t, 3 degrees of freedom)": Case(120, tails=True),
}
BEHIND = 10  # intervals, after which a step counts as not found
SAME_KM = 3.0  # intervals within which two findings are of one step
TODAY_AFTER = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 80, 100)  # intervals behind
NEVER = 999


@dataclass(frozen=True, slots=True)
class Found:
    """When and how well the step of a life was found; ``after`` is ``NEVER`` where it was not."""

    given: Life
    history: int
    size: float
    after: int  # intervals behind it
    step: TrendStep | None
    holds_place: bool
    level_error: float  # of the fitted trend when it was found
    level_error_without: float  # of that over all points


def _rows(options: argparse.Namespace, _folder: Path) -> Iterator[BenchRow]:
    seed, lives = options.seed, options.lives
    found = [
        found_in(life(Case(history, size, BEHIND, mixed=bool(i % 2)), seed + 1000 * number + i), history)
        for number, (history, size) in enumerate((h, s) for h in HISTORIES for s in SIZES)
        for i in range(lives)
    ]
    yield from (row for size in REACH for row in _found_rows([one for one in found if abs(one.size) == size], size))
    yield from _missed_rows(found)
    yield from _troubled_rows(seed, min(lives, TROUBLED_LIVES))
    yield from _accuracy_rows(found)
    yield from _rival_rows(seed, min(lives, RIVAL_LIVES))
    yield from _quiet_rows(seed, options.quiet_lives)
    yield from turned_rows(seed, max(1, lives // 4))
    yield from suspension_rows(seed, lives)


def found_in(given: Life, history: int) -> Found:
    """Return when the step of a life was found, looking after every interval behind it."""
    first = given.first or 0
    for after in range(1, BEHIND + 1):
        known = given.records[: first + after]
        step = newest_step(known, TrendParameters())
        if step is None or step.after_km < given.records[history - 1].mileage_km:
            continue
        half = 0.5 * (given.records[1].mileage_km - given.records[0].mileage_km)
        holds = given.event_km is not None and step.before_km - half <= given.event_km <= step.after_km + half
        truth = given.level[first + after - 1]
        fitted = trend_of(known, LIMIT, TrendParameters()).fitted.value or np.nan
        without = _all_fitted(given, first + after)
        return Found(given, history, given.size, after, step, holds, abs(fitted - truth), abs(without - truth))
    nan = float("nan")
    return Found(given, history, given.size, NEVER, None, holds_place=False, level_error=nan, level_error_without=nan)


def _all_fitted(given: Life, until: int) -> float:
    points = conicity_points(given.records[:until]).points
    curve = fit_wear_curve(*(np.array([getattr(p, name) for p in points]) for name in ("mileage_km", "value", "std")))
    return float(curve.weight @ curve.level)


def _found_rows(found: Sequence[Found], size: float) -> Iterator[BenchRow]:
    reach = REACH[size]
    groups = [("3", (3,)), ("6", (6,)), ("12 to 240", HISTORIES[2:])]
    for name, histories in [("3 to 240", HISTORIES), *groups]:
        after = np.array([one.after for one in found if one.history in histories])
        within = float(np.mean(after <= (reach or 4)))
        median, late = (_count(np.quantile(after, q, method="higher")) for q in (0.5, 0.95))
        measured = f"{within:.1%} within {reach or 4} intervals; median {median}, 95 % {late}; {len(after)} lives"
        counts = reach is not None and len(histories) > 1
        wanted = f"{WITHIN:.0%} within {reach}" if counts else "for information"
        met = not counts or within >= WITHIN
        yield BenchRow(f"step of {size:g}, history of {name} intervals", measured, wanted, met)


def _missed_rows(found: Sequence[Found]) -> Iterator[BenchRow]:
    """Yield how many of the steps that were found too late could be known."""
    late = [(one, reach) for one in found if (reach := REACH[abs(one.size)]) is not None and one.after > reach]
    sure = MODEL.sure / (1.0 - MODEL.sure)
    for wear, name in (
        (True, "wear, weather and noise known"),
        (False, "weather, noise and the law of wear known"),
    ):
        known = [odds(one.given, (one.given.first or 0) + reach, wear=wear) > np.log(sure) for one, reach in late]
        text = f"an ideal detector is sure of {sum(known)} of {len(known)}"
        yield BenchRow(f"steps of 0.1 and 0.2 found later, {name}", text, "for information", met=True)


def _troubled_rows(seed: int, lives: int) -> Iterator[BenchRow]:
    """Yield how soon a step is found where the points are worse than they say."""
    for number, (name, trouble) in enumerate(TROUBLES.items()):
        after = [
            found_in(life(case, seed + 40_000 + 1000 * number + 100 * k + i), case.history).after
            for k, history in enumerate(HISTORIES)
            for i in range(2 * lives)
            for case in [replace(trouble, history=history, size=0.1 * (-1) ** (i // 2), behind=BEHIND, mixed=i % 2 > 0)]
        ]
        text = f"{np.mean(np.array(after) <= 4):.1%} within 4 intervals; {len(after)} lives"
        yield BenchRow(f"step of 0.1: {name}", text, "for information", met=True)


def _count(after: float) -> str:
    return "more" if after >= NEVER else f"{after:.0f}"


def _accuracy_rows(found: Sequence[Found]) -> Iterator[BenchRow]:
    shown = [(one, one.step) for one in found if one.step is not None]
    error = np.array([(step.size.value or 0.0) - one.size for one, step in shown])
    std = np.array([step.size.std or np.nan for _, step in shown])
    z, cover = float(np.sqrt(np.mean((error / std) ** 2))), float(np.mean(np.abs(error) <= 1.959964 * std))
    text = f"rms error {np.sqrt(np.mean(error**2)):.4f}, z rms {z:.2f}, 95 % intervals hold {cover:.1%}"
    yield BenchRow(f"size of {len(shown)} steps found", text, "92 to 98 %", 0.92 <= cover <= 0.98)
    place = float(np.mean([one.holds_place for one, _ in shown]))
    yield BenchRow("place: the mileage is within the intervals named", f"{place:.1%}", "95 %", place >= 0.95)
    own, without = (
        float(np.nanmedian([getattr(one, name) for one, _ in shown if abs(one.size) >= 0.1]))
        for name in ("level_error", "level_error_without")
    )
    text = f"median error {own:.3f}; of a curve through all points {without:.3f}"
    yield BenchRow("level when a step of 0.1 or 0.2 is found", text, "better", own < without)


def _rival_rows(seed: int, lives: int) -> Iterator[BenchRow]:
    """Yield when the curve through all points, which is all there was before, believes a step."""
    for history in (12, 60, 240):
        after = [_believed(life(Case(history, 0.2, TODAY_AFTER[-1], km=1000.0), seed + i)) for i in range(lives)]
        median, late = (_count(np.quantile(after, q, method="higher")) for q in (0.5, 0.95))
        text = f"after {median} intervals (median), {late} (95 %); {lives} lives"
        what = f"a curve through all points believes a step of 0.2, history of {history}"
        yield BenchRow(what, text, "for information", met=True)


def _believed(given: Life) -> int:
    first = given.first or 0
    for after in TODAY_AFTER:
        truth = given.level[first + after - 1]
        if abs(_all_fitted(given, first + after) - truth) < 0.5 * abs(given.size):
            return after
    return NEVER


def _quiet_rows(seed: int, lives: int) -> Iterator[BenchRow]:
    """Yield false steps of lives without any, looked for after every interval."""
    cases = QUIET | TROUBLES
    years, false = 0.0, 0
    for number, (name, case) in enumerate(cases.items()):
        counted = [false_steps(life(case, seed + 50_000 + 1000 * number + i)) for i in range(lives // len(cases))]
        these, in_years = sum(one for one, _ in counted), sum(one for _, one in counted)
        years, false = years + in_years, false + these
        text = f"{these} in {in_years:.0f} wheelset-years"
        yield BenchRow(f"false steps: {name}", text, "for information", met=True)
    text = f"{false / years:.3f} a wheelset-year ({false} in {years:.0f} of {lives} wheelsets)"
    yield BenchRow("false steps, all together", text, "at most 0.02", false / years <= 0.02)


def false_steps(given: Life) -> tuple[int, float]:
    """Return how many steps were found at any time in a life without one, and its years."""
    records, places = given.records, list[float]()
    width = records[1].mileage_km - records[0].mileage_km
    for until in range(2, len(records) + 1):
        step = newest_step(records[:until], TrendParameters())
        if step is not None and all(abs(step.after_km - km) > SAME_KM * width for km in places):
            places.append(step.after_km)
    return len(places), (records[-1].to_ns - records[0].from_ns) / DAY_NS / 365.25


main = row_bench(
    "steps",
    "Sudden changes of conicity, curve and suspension",
    __doc__,
    _rows,
    {
        "seed": (20_000, "of the first life"),
        "lives": (24, "of each size and history"),
        "quiet-lives": (420, "without a step"),
    },
).run

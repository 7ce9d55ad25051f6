"""Tables of the vehicle bench: rows against what they have to reach, and what tests of fit find of wrong parameters."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from bench import vehicle_power
from bench.results_page import markdown_table
from bench.world_table import COVERAGE, figures, share, terminal_table

MISMATCH = "model_mismatch"
FOUND = 0.99  # share of the wheelsets of which nothing may be published, where what is on file is wrong
FALSE_ALARMS = 0.01  # share of the wheelsets, where it is right
ROWS: Mapping[str, float | None] = {  # 95th percentile of the conicity error; None: nothing may be published
    "paper_known": 0.01,
    "soft_known": 0.01,
    "coach_known": 0.02,
    "paper_unknown": 0.02,
    "soft_unknown": 0.02,
    "coach_unknown": 0.03,
    "friction": 0.015,
    "positions_0_5_m": 0.015,
    "positions_2_m": 0.015,
    "positions_5_m": 0.015,
    "positions_20_m": 0.015,
    "cross_level": 0.03,
    "all_faults": 0.03,
    "vibration_2": 0.03,
    "vibration_5": 0.03,
    "vibration_10": 0.03,
    "gyroscopes": 0.02,
    "slow_bus": 0.01,
    "soft_parameters_drawn": 0.02,
    "flat": 0.015,
    "flat_unknown": 0.02,
    "frozen_positions": 0.015,
    "push_pull": 0.01,
    "coach_parameters_drawn": 0.02,
    "wrong_class_coach_as_paper": None,
    "wrong_radius_420_as_460": None,
    "wrong_wheelbase_2_5_as_1_8": None,
    "wrong_nodes_swapped": None,
    "wrong_frame_sensor_missing": None,
}
TITLE = "Vehicles as they run"
HEADER = (
    "row",
    "seeds",
    "error: median / 95 %",
    "covers",
    "half width",
    "published",
    "mismatch",
    "reasons",
    "CPU s/h",
    "reach",
    "met",
)
NUMBERS = range(1, 7)  # columns set flush right
POWER_TITLE = "What tests of fit find where one parameter of the class on file is wrong: soft bogies, survey on file"
POWER_HEADER = ("parameter", "error on file", "wheelsets", "mismatch", "published", "error: median / 95 %", "covers")
MOST_REASONS = 2
EXPLANATION = (
    "Mean absolute error of the equivalent conicity over 1-3 mm by wheelset; share of the 95 % intervals that cover;"
    " wheelsets of which a conicity is published; wheelsets that are `model_mismatch`; processor time of the jobs per"
    " wheelset-hour recorded."
)


@dataclass(frozen=True, slots=True)
class Counted:
    """Wheelsets of some cases."""

    wheelsets: int
    published: int
    mismatch: int
    doubted: int = 0  # of those that are published

    @property
    def kept_back(self) -> float:
        """Share of the wheelsets of which no conicity is published as good: without a doubt beside it."""
        return 1.0 - (self.published - self.doubted) / self.wheelsets

    @property
    def mismatch_share(self) -> float:
        """Share of the wheelsets of which the status is that of a model that does not fit."""
        return self.mismatch / self.wheelsets


def counted(cases: Sequence[Mapping[str, Any]]) -> Counted:
    """Return how many wheelsets there are, are published, and do not fit.

    Args:
        cases: As ``vehicle_case.score`` gives them, in JSON values.
    """
    verdicts = [verdict for case in cases for verdict in case["verdicts"]]
    return Counted(
        wheelsets=len(verdicts),
        published=sum(verdict["published"] for verdict in verdicts),
        mismatch=sum(verdict["status"] == MISMATCH for verdict in verdicts),
        doubted=sum(verdict["published"] and bool(verdict["code"]) for verdict in verdicts),
    )


def summary_rows(cases: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for each row that was run; its last cell is "yes" where the row reaches its numbers.

    Args:
        cases: Of all rows and seeds that did not fail.
    """
    by_row = {name: [case for case in cases if case["row"] == name] for name in ROWS}
    return [_summary(name, of_row) for name, of_row in by_row.items() if of_row]


def power_rows(cases: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for each size of a wrong parameter that was run.

    Args:
        cases: Of all rows and seeds that did not fail.
    """
    by_row = {name: [case for case in cases if case["row"] == name] for name in vehicle_power.ROWS}
    return [_power_row(name, of_row) for name, of_row in by_row.items() if of_row]


def tables(cases: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return the tables for a terminal.

    Args:
        cases: Of all rows and seeds that did not fail.
    """
    found = [terminal_table(TITLE, HEADER, summary_rows(cases))]
    power = power_rows(cases)
    return [*found, terminal_table(POWER_TITLE, POWER_HEADER, power)] if power else found


def page_body(cases: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the same tables for a page of results.

    Args:
        cases: Of all rows and seeds that did not fail.
    """
    found = [
        EXPLANATION,
        markdown_table(HEADER, summary_rows(cases), NUMBERS),
    ]
    power = power_rows(cases)
    if power:
        found += [f"{POWER_TITLE}.", markdown_table(POWER_HEADER, power, range(1, len(POWER_HEADER)))]
    return found


def _summary(name: str, cases: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    errors, (covered, intervals), widths = figures(cases)
    of_row = counted(cases)
    cpu = sum(case["cpu_seconds"] for case in cases) / sum(case["wheelset_hours"] for case in cases)
    limit = ROWS[name]
    return (
        name,
        str(len(cases)),
        _error(errors),
        share(covered, intervals),
        f"{np.median(widths):.3f}" if widths else "",
        f"{of_row.published} of {of_row.wheelsets}",
        f"{of_row.mismatch} of {of_row.wheelsets}",
        _reasons(cases),
        f"{cpu:.1f}",
        "none" if limit is None else f"{limit:g}",
        "yes" if _met(limit, errors, (covered, intervals), of_row) else "NO",
    )


def _met(limit: float | None, errors: Sequence[float], covering: tuple[int, int], found: Counted) -> bool:
    if limit is None:
        return found.kept_back >= FOUND
    covered, intervals = covering
    right = bool(errors) and float(np.percentile(errors, 95)) <= limit
    covers = intervals > 0 and COVERAGE[0] <= covered / intervals <= COVERAGE[1]
    return right and covers and found.mismatch_share <= FALSE_ALARMS


def _power_row(name: str, cases: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    parameter, percent = vehicle_power.parts(name)
    errors, (covered, intervals), _ = figures(cases)
    of_row = counted(cases)
    return (
        parameter,
        f"{percent:+d} %" if percent else "",
        str(of_row.wheelsets),
        f"{of_row.mismatch_share:.0%}".replace("%", " %"),
        f"{1.0 - of_row.kept_back:.0%}".replace("%", " %"),
        _error(errors),
        share(covered, intervals),
    )


def _error(errors: Sequence[float]) -> str:
    if not errors:
        return "none"
    median, p95 = float(np.median(errors)), float(np.percentile(errors, 95))
    return f"{median:.4f} / {p95:.4f}" if math.isfinite(p95) else "none"


def _reasons(cases: Sequence[Mapping[str, Any]]) -> str:
    codes = Counter(verdict["code"] for case in cases for verdict in case["verdicts"] if verdict["code"])
    if not (codes or counted(cases).published):  # nothing was refused: there is no alignment
        return ", ".join(sorted({case["survey"] for case in cases if case["survey"]}))
    return ", ".join(f"{code} {count}" for code, count in codes.most_common(MOST_REASONS))

"""Tables of the world bench: what rows reach, and how wide intervals are on fleets more or less alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from rich.table import Table

from bench.results_page import markdown_table

COVERAGE = (0.92, 0.98)
SURVEY_RIGHT = "survey_confirmed"


@dataclass(frozen=True, slots=True)
class Reach:
    """What a row has to reach."""

    p95: float | None = None  # of the conicity error
    survey: tuple[str, ...] = ()  # verdicts that are right; empty where no survey is on file
    covers_above: bool = False  # too wide is right as well: the passes hardly say anything


WRONG = ("survey_unrelated",)
ROWS: Mapping[str, Reach] = {
    "known_alike": Reach(0.015, (SURVEY_RIGHT,)),
    "known_alike_gauge": Reach(0.02, (SURVEY_RIGHT,)),
    "known_wide_gauge": Reach(0.02, (SURVEY_RIGHT,)),
    "known_line_alike": Reach(0.02, (SURVEY_RIGHT,)),
    "known_line": Reach(0.02, (SURVEY_RIGHT,)),
    "known_diverse_gauge": Reach(0.02, (SURVEY_RIGHT,)),
    "survey_shifted": Reach(survey=("survey_displaced",), covers_above=True),
    "survey_scaled": Reach(survey=("survey_unit", *WRONG), covers_above=True),
    "survey_mirrored": Reach(survey=("survey_mirrored", *WRONG), covers_above=True),
    "survey_of_another_section": Reach(survey=WRONG, covers_above=True),
    "gauge_of_another_section": Reach(survey=("survey_gauge_unrelated",), covers_above=True),
    "gauge_scaled": Reach(survey=("survey_gauge_unit",), covers_above=True),
    "unknown_long_gauge": Reach(0.035),
    "unknown_alike_02": Reach(covers_above=True),
    "unknown_alike_05": Reach(covers_above=True),
    "unknown_alike_08": Reach(covers_above=True),
    "measured_known": Reach(0.01, (SURVEY_RIGHT,)),
    "measured_unknown": Reach(0.02),
}
TITLE = "Other track and other fleets"
HEADER = (
    "row",
    "seeds",
    "nothing published",
    "survey right",
    "error: median / 95 %",
    "covers",
    "half width",
    "diversity",
    "reach",
    "met",
)
WIDTH_TITLE = "Intervals of the conicity against the diversity of the fleet, rows on unknown track"
WIDTH_HEADER = ("diversity", "fleets", "nothing published", "covers", "half width: median", "error: median")
DIVERSITIES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, math.inf)  # limits of the lines
UNKNOWN = "unknown"  # how the names of the rows on unknown track begin


def figures(cases: Sequence[Mapping[str, Any]]) -> tuple[list[float], tuple[int, int], list[float]]:
    """Return errors of conicity by wheelset, how many intervals cover of how many, and their half widths.

    Args:
        cases: As ``world_case.score`` gives them, in JSON values.
    """
    wheelsets = [item for case in cases for item in case["wheelsets"]]
    errors = [item["error"] for item in wheelsets if item["error"] is not None]
    counts = [item["conicity"] for item in wheelsets]
    covered = (sum(one["covered"] for one in counts), sum(one["published"] for one in counts))
    return errors, covered, [width for case in cases for width in case["half_widths"]]


def summary_rows(cases: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for each row that was run; its last cell is "yes" where the row reaches its numbers.

    Args:
        cases: Of all rows and seeds.
    """
    by_row = {name: [case for case in cases if case["row"] == name] for name in ROWS}
    return [_summary(name, of_row) for name, of_row in by_row.items() if of_row]


def width_rows(cases: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for each range of diversity in which there are fleets on unknown track.

    Args:
        cases: Of all rows and seeds; a fleet without diversity, of which nothing was solved, comes last.
    """
    unknown = [case for case in cases if case["row"].startswith(UNKNOWN)]
    solved = [case for case in unknown if case["diversity"] > 0.0]
    lines = [
        (f"{low:g} to {high:g}" if math.isfinite(high) else f"above {low:g}", within)
        for low, high in pairwise(DIVERSITIES)
        if (within := [case for case in solved if low < case["diversity"] <= high])
    ]
    if len(solved) < len(unknown):
        lines.append(("none", [case for case in unknown if not case["diversity"] > 0.0]))
    return [_width_row(name, within) for name, within in lines]


def _width_row(name: str, cases: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    errors, (covered, published), widths = figures(cases)
    return (
        name,
        str(len(cases)),
        _without_intervals(cases),
        share(covered, published),
        f"{np.median(widths):.3f}" if widths else "",
        f"{np.median(errors):.4f}" if errors else "",
    )


def _without_intervals(cases: Sequence[Mapping[str, Any]]) -> str:
    """Return how many fleets have no published conicity."""
    return str(sum(figures([case])[1][1] == 0 for case in cases))


def share(covered: int, published: int) -> str:
    """Return a share of intervals in words; empty where there are none."""
    return f"{covered / published:.1%} of {published}".replace("%", " %") if published else ""


def _summary(name: str, cases: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    reach = ROWS[name]
    errors, (covered, published), widths = figures(cases)
    right = sum(case["survey"] in reach.survey for case in cases)
    p95 = float(np.percentile(errors, 95)) if errors else float("nan")
    covering = covered / published if published else float("nan")
    highest = 1.0 if reach.covers_above else COVERAGE[1]
    met = (
        (not reach.survey or right == len(cases))
        and (reach.p95 is None or p95 <= reach.p95)
        and (COVERAGE[0] <= covering <= highest if published else reach.covers_above)
    )
    return (
        name,
        str(len(cases)),
        _without_intervals(cases),
        f"{right} of {len(cases)}" if reach.survey else "",
        f"{np.median(errors):.4f} / {p95:.4f}" if errors else "none",
        share(covered, published),
        f"{np.median(widths):.3f}" if widths else "",
        f"{np.median([case['diversity'] for case in cases]):.2f}",
        "" if reach.p95 is None else f"{reach.p95:g}",
        "yes" if met else "NO",
    )


def tables(cases: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return the tables for a terminal; that of the intervals where there are fleets on unknown track.

    Args:
        cases: Of all rows and seeds.
    """
    found = [terminal_table(TITLE, HEADER, summary_rows(cases))]
    widths = width_rows(cases)
    return [*found, terminal_table(WIDTH_TITLE, WIDTH_HEADER, widths)] if widths else found


def page_body(cases: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the same tables for a page of results.

    Args:
        cases: Of all rows and seeds.
    """
    found = [markdown_table(HEADER, summary_rows(cases), range(1, len(HEADER) - 2))]
    widths = width_rows(cases)
    if widths:
        found += [f"{WIDTH_TITLE}.", markdown_table(WIDTH_HEADER, widths, range(1, len(WIDTH_HEADER)))]
    return found


def terminal_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Return a table for a terminal."""
    table = Table(*header, title=title, title_justify="left")
    for cells in rows:
        table.add_row(*cells)
    return table

"""Tables of the bench of refusals: right wheelsets by row, and what is found of wrong ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from bench.results_page import markdown_table
from bench.world_table import terminal_table

RIGHT = "right"
SKIPPED = "skipped"
MOST_WITHHELD, MOST_IN_A_ROW = 0.01, 0.03  # share of the right wheelsets
LEAST_FOUND = 0.99  # share of the wrong ones
TITLE = "Right vehicles that are refused, wrong ones that are not"
HEADER = ("row", "wheelsets", "withheld", "in doubt", "codes", "error: median / 95 %", "covers", "reach", "met")
WRONG_HEADER = ("wrong", "wheelsets", "withheld", "in doubt", "found", "error where published as good", "reach", "met")
WRONG_TITLE = "Wrong on file, or of the nodes"
EXPLANATION = (
    "Each seed draws arrangement, sensors, vibration of the axle boxes (m/s2 rms), profiles, speed (m/s), track and std"
    " of the survey (mm); 6 windows a wheelset. *Withheld* is a wheelset of which nothing is published for what its"
    " data contradict; *in doubt* one of which a number is published, wider, with the contradiction beside it. Errors"
    " and intervals are those of the equivalent conicity over 1-3 mm."
)


def summary_rows(found: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for all right wheelsets, and one for each kind of each dimension.

    Parameters
    ----------
    found
        Of all seeds, as ``refusals`` stores them.
    """
    return [_summary(name, of_row, limit) for name, of_row, limit in _groups(found)]


def wrong_rows(found: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for each kind of mistake.

    Parameters
    ----------
    found
        As ``summary_rows`` takes them.
    """
    kinds = dict.fromkeys(one["kind"] for one in found if one["kind"] not in (RIGHT, SKIPPED))
    return [_wrong(kind, [one for one in found if one["kind"] == kind]) for kind in kinds]


def rows_met(found: Sequence[Mapping[str, Any]]) -> bool:
    """Whether every line reaches its number."""
    return all(row[-1] == "yes" for row in (*summary_rows(found), *wrong_rows(found)))


def tables(found: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return the tables for a terminal."""
    return [
        terminal_table(TITLE, HEADER, summary_rows(found)),
        terminal_table(WRONG_TITLE, WRONG_HEADER, wrong_rows(found)),
    ]


def page_body(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the same tables for a page of results."""
    skipped = sum(one["kind"] == SKIPPED for one in found)
    judged_wrong = len({one["seed"] for one in found if one["kind"] not in (RIGHT, SKIPPED)})
    return [
        EXPLANATION,
        f"{skipped} seeds are left out: their wheelsets hunt until they derail.",
        markdown_table(HEADER, summary_rows(found), range(1, 4)),
        (
            f"{WRONG_TITLE}: {judged_wrong} of the seeds; in"
            " doubt is also what a survey of 1 mm leaves open. A radius is not seen where little rolls."
        ),
        markdown_table(WRONG_HEADER, wrong_rows(found), range(1, 5)),
    ]


def _groups(
    found: Sequence[Mapping[str, Any]],
) -> Iterator[tuple[str, list[Mapping[str, Any]], float]]:
    right = [one for one in found if one["kind"] == RIGHT]
    yield "all", right, MOST_WITHHELD
    names = right[0]["drawn"] if right else {}
    for name in names:
        for kind in sorted({one["drawn"][name] for one in right}):
            yield f"{name}: {kind}", [one for one in right if one["drawn"][name] == kind], MOST_IN_A_ROW


def _summary(name: str, of_row: Sequence[Mapping[str, Any]], limit: float) -> tuple[str, ...]:
    withheld = sum(one["withheld"] for one in of_row)
    codes = Counter(one["code"] for one in of_row if one["withheld"] or one["doubted"])
    covered = [held for one in of_row for held in one["covered"]]
    return (
        name,
        str(len(of_row)),
        str(withheld),
        str(sum(one["doubted"] for one in of_row)),
        ", ".join(f"{code} {count}" for code, count in codes.most_common()),
        _error(of_row),
        f"{np.mean(covered):.0%}".replace("%", " %") if covered else "",
        f"{limit:.0%}".replace("%", " %"),
        "yes" if of_row and withheld <= limit * len(of_row) else "NO",
    )


def _wrong(kind: str, of_kind: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    withheld, doubted = (sum(one[name] for one in of_kind) for name in ("withheld", "doubted"))
    silent = sum(not one["published"] and not one["withheld"] for one in of_kind)
    share = (withheld + doubted + silent) / len(of_kind)
    good = [one for one in of_kind if one["published"] and not one["doubted"]]
    return (
        kind,
        str(len(of_kind)),
        str(withheld + silent),
        str(doubted),
        f"{share:.0%}".replace("%", " %"),
        _error(good),
        f"{LEAST_FOUND:.0%}".replace("%", " %"),
        "yes" if share >= LEAST_FOUND else "NO",
    )


def _error(of_row: Sequence[Mapping[str, Any]]) -> str:
    errors = [float(np.mean(np.abs(one["errors"]))) for one in of_row if one["errors"]]
    return f"{np.median(errors):.4f} / {np.percentile(errors, 95):.4f}" if errors else "none"

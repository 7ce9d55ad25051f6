"""Tables of the bench of refusals: right wheelsets by row, and what is found of wrong ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from bench.results_page import markdown_table
from bench.world_table import terminal_table
from estimation.geometry.model_fit import ROLLING_FIT
from estimation.values.reasons import ReasonCode

RIGHT = "right"
SKIPPED = "skipped"
RADIUS_OPEN = str(ReasonCode.ROLLING_RADIUS_OPEN)
MOST_WITHHELD, MOST_IN_A_ROW = 0.01, 0.03  # share of the right wheelsets
LEAST_FOUND = 0.99  # share of the wrong ones
TITLE = "Right vehicles that are refused, wrong ones that are not"
HEADER = ("row", "wheelsets", "withheld", "in doubt", "codes", "error: median / 95 %", "covers", "reach", "met")
WRONG_HEADER = (
    "wrong", "wheelsets", "withheld", "in doubt", "found", "moved", "covers", "error where published as good", "reach",
    "met",
)  # fmt: skip
RADIUS_HEADER = ("track, sensors", "wheelsets", "error: median / 68 %", "stated std", "std by noise alone", "open")
WRONG_TITLE = "Wrong on file, or of the nodes"
WRONG_EXPLANATION = (
    "In doubt is also what a survey of 1 mm leaves open; a radius that is open is a doubt on a radius alone. *Moved* is"
    " by how much the published conicity is another one than with the right file, *covers* the share of its intervals"
    " that hold the truth."
)
INTERVAL_HEADER = ("sensors, m/s", "wheelsets", "conicities of nine", "error: median / 95 %", "covers")
INTERVAL_TITLE = "Intervals by sensors and speed, where the file is right"
INTERVAL_EXPLANATION = (
    "The noise of a sensor is integrated: the slower the vehicle, the less is known of its lateral displacement."
)
RADIUS_TITLE = "The radius that the motion has, where the file is right"
RADIUS_EXPLANATION = (
    "In percent of the radius; 68 % of the errors are below the second one. *Std by noise alone* is the bound of Cramer"
    " and Rao for the same sums with the noise"
    " that is left in them; the stated std also holds what the equation lacks. *Open* are those whose std does not"
    " leave out a mistake of 10 %."
)
EXPLANATION = (
    "Each seed draws arrangement, sensors, vibration of the axle boxes (m/s2 rms), profiles, speed (m/s), track and std"
    " of the survey (mm); 6 windows a wheelset. *Withheld* is a wheelset of which nothing is published for what its"
    " data contradict; *in doubt* one of which a number is published, with the doubt beside it, wider but for an open"
    " radius. Errors"
    " and intervals are those of the equivalent conicity over 1-3 mm."
)


def summary_rows(found: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for all right wheelsets, and one for each kind of each dimension.

    Args:
        found: Of all seeds, as ``refusals`` stores them.
    """
    return [_summary(name, of_row, limit) for name, of_row, limit in _groups(found)]


def wrong_rows(found: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for each kind of mistake.

    Args:
        found: As ``summary_rows`` takes them.
    """
    kinds = dict.fromkeys(one["kind"] for one in found if one["kind"] not in (RIGHT, SKIPPED))
    right = {(one["seed"], one["axle"]): one["values"] for one in found if one["kind"] == RIGHT}
    return [_wrong(kind, [one for one in found if one["kind"] == kind], right) for kind in kinds]


def interval_rows(found: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return how many conicities of right wheelsets are published and right, by sensors and speed.

    Args:
        found: As ``summary_rows`` takes them.
    """
    right = [wheelset for wheelset in found if wheelset["kind"] == RIGHT]
    return [_intervals(name, of_row) for name, of_row in _by_draw(right, "sensors", "speed")]


def radius_rows(found: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return what the motion shows of the radius of right wheelsets, by track and sensors.

    Args:
        found: As ``summary_rows`` takes them.
    """
    right = [wheelset for wheelset in found if wheelset["kind"] == RIGHT and wheelset["radius"] is not None]
    return [_radius(name, of_row) for name, of_row in _by_draw(right, "track", "sensors")]


def _by_draw(
    wheelsets: Sequence[Mapping[str, Any]], first: str, second: str
) -> list[tuple[str, list[Mapping[str, Any]]]]:
    """Return wheelsets by two of the things that were drawn, in the order of their names."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for wheelset in wheelsets:
        groups.setdefault(f"{wheelset['drawn'][first]}, {wheelset['drawn'][second]}", []).append(wheelset)
    return sorted(groups.items())


def rows_met(found: Sequence[Mapping[str, Any]]) -> bool:
    """Whether every line reaches its number."""
    return all(row[-1] == "yes" for row in (*summary_rows(found), *wrong_rows(found)))


def tables(found: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return the tables for a terminal."""
    return [
        terminal_table(TITLE, HEADER, summary_rows(found)),
        terminal_table(WRONG_TITLE, WRONG_HEADER, wrong_rows(found)),
        terminal_table(INTERVAL_TITLE, INTERVAL_HEADER, interval_rows(found)),
        terminal_table(RADIUS_TITLE, RADIUS_HEADER, radius_rows(found)),
    ]


def page_body(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the same tables for a page of results."""
    skipped = sum(one["kind"] == SKIPPED for one in found)
    judged_wrong = len({one["seed"] for one in found if one["kind"] not in (RIGHT, SKIPPED)})
    return [
        EXPLANATION,
        f"{skipped} seeds are left out: their wheelsets hunt until they derail.",
        markdown_table(HEADER, summary_rows(found), range(1, 4)),
        f"{WRONG_TITLE}: {judged_wrong} of the seeds. {WRONG_EXPLANATION}",
        markdown_table(WRONG_HEADER, wrong_rows(found), range(1, 6)),
        f"{INTERVAL_TITLE}. {INTERVAL_EXPLANATION}",
        markdown_table(INTERVAL_HEADER, interval_rows(found), range(1, 5)),
        f"{RADIUS_TITLE}. {RADIUS_EXPLANATION}",
        markdown_table(RADIUS_HEADER, radius_rows(found), range(1, 6)),
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


def _wrong(
    kind: str, of_kind: Sequence[Mapping[str, Any]], right: Mapping[tuple[int, int], Sequence[float | None]]
) -> tuple[str, ...]:
    withheld, doubted = sum(one["withheld"] for one in of_kind), sum(_doubted(one) for one in of_kind)
    silent = sum(not one["published"] and not one["withheld"] for one in of_kind)
    share = (withheld + doubted + silent) / len(of_kind)
    good = [one for one in of_kind if one["published"] and not _doubted(one)]
    covered = [held for one in of_kind for held in one["covered"]]
    return (
        kind,
        str(len(of_kind)),
        str(withheld + silent),
        str(doubted),
        f"{share:.0%}".replace("%", " %"),
        _moved(of_kind, right),
        f"{np.mean(covered):.0%}".replace("%", " %") if covered else "",
        _error(good),
        f"{LEAST_FOUND:.0%}".replace("%", " %"),
        "yes" if share >= LEAST_FOUND else "NO",
    )


def _doubted(one: Mapping[str, Any]) -> bool:
    """Whether a doubt stands beside the number that may be about what is wrong."""
    return bool(one["doubted"]) and (one["code"] != RADIUS_OPEN or one["kind"].startswith("radius"))


def _moved(of_kind: Sequence[Mapping[str, Any]], right: Mapping[tuple[int, int], Sequence[float | None]]) -> str:
    """Return by how much conicities are others than with the right file, in the median."""
    moved = []
    for one in of_kind:
        before = right.get((one["seed"], one["axle"]), ())
        pairs = zip(one["values"], before, strict=True) if one["values"] and before else ()
        moved += [now / then - 1.0 for now, then in pairs if now is not None and then is not None]
    return f"{np.median(moved):+.0%}".replace("%", " %") if moved else ""


def _intervals(name: str, of_row: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    covered = [held for one in of_row for held in one["covered"]]
    share = f"{np.mean(covered):.1%}".replace("%", " %") if covered else ""
    return name, str(len(of_row)), f"{len(covered) / len(of_row):.1f}", _error(of_row), share


def _radius(name: str, of_row: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    error, std, bound = 100.0 * np.array([one["radius"] for one in of_row]).T
    return (
        name,
        str(len(of_row)),
        f"{np.median(error):+.1f} / {np.percentile(np.abs(error), 68):.1f}",
        f"{np.median(std):.1f}",
        f"{np.median(bound):.1f}",
        str(int(np.sum(np.abs(error) + ROLLING_FIT.doubted * std > 100.0 * ROLLING_FIT.mistake))),
    )


def _error(of_row: Sequence[Mapping[str, Any]]) -> str:
    errors = [float(np.mean(np.abs(one["errors"]))) for one in of_row if one["errors"]]
    return f"{np.median(errors):.4f} / {np.percentile(errors, 95):.4f}" if errors else "none"

"""Tables of the bench of surveys, and what its figures have to reach."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.report import BenchRow

TITLE = "Surveys as evidence"
HEADER = (
    "",
    "cases",
    "refused",
    "doubted",
    "published",
    "error",
    "z rms",
    "half width",
    "interval score",
    "cover",
    "as filed: error",
    "interval score",
    "cover",
)
MISS = 40.0  # weight of a miss in the interval score of 95 % intervals
REFUSED = 0.005  # share of right surveys
FOUND = 0.99  # share of wrong ones
COVER_UNDERSTATED = 0.92
SAME = 1.02  # factor by which a mean over fleets is the same
Case = Mapping[str, Any]


def summary(cases: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield the rows with what they have to reach."""
    right = [case for case in cases if case["right"]]
    wrong = [case for case in cases if not case["right"] and case["survey"] != "none"]
    refused = sum(case["refused"] for case in right)
    yield BenchRow(
        "right surveys refused", f"{refused} of {len(right)}", "<= 0.5 %", refused <= REFUSED * max(len(right), 1)
    )
    found = [case for case in wrong if case["code"] not in ("", "survey_confirmed") and not _published_as_good(case)]
    yield BenchRow(
        "wrong surveys found: refused, replaced, or doubted and widened",
        f"{len(found)} of {len(wrong)}, of them {sum(case['refused'] for case in wrong)} refused",
        ">= 99 %",
        len(found) >= FOUND * len(wrong),
    )
    for name in dict.fromkeys(case["survey"] for case in right if not case["understated"]):
        yield _against_none([case for case in right if case["survey"] == name], cases, name)
    understated = [case for case in right if case["understated"]]
    values = figures(understated)
    yield BenchRow(
        "std understated five times: intervals that cover",
        f"{values.cover:.3f} of {values.count}, as filed {figures(understated, rival=True).cover:.3f}",
        ">= 92 %",
        values.count > 0 and values.cover >= COVER_UNDERSTATED,
    )
    for positions in ("0 m", "0.5 m", "2 m"):
        at = [case for case in right if case["survey"] == "0.3 mm" and case["positions"] == positions]
        mine, filed = figures(at), figures(at, rival=True)
        text = f"error {mine.error:.4f}, cover {mine.cover:.3f}; as filed {filed.error:.4f}, {filed.cover:.3f}"
        yield BenchRow(f"positions off by {positions}, survey of 0.3 mm", text, "shown", met=True)


class Figures:
    """Error, z, half width, interval score and coverage of published conicities."""

    def __init__(self, published: Sequence[Mapping[str, Any]]) -> None:
        """Count them."""
        error = np.array([one["error"] for one in published])
        half = np.array([one["half_width"] for one in published])
        self.count = len(error)
        some = self.count > 0
        self.error = float(np.mean(np.abs(error))) if some else float("nan")
        self.half = float(np.median(half)) if some else float("nan")
        self.z = float(np.sqrt(np.mean((1.96 * error / half) ** 2))) if some else float("nan")
        missed = np.maximum(np.abs(error) - half, 0.0)
        self.score = float(np.mean(2.0 * half + MISS * missed)) if some else float("nan")
        self.cover = float(np.mean([one["covered"] for one in published])) if some else float("nan")


def figures(cases: Sequence[Case], *, rival: bool = False) -> Figures:
    """Return the figures of all cases together; of the rival where asked for."""
    scores = [case["rival"] if rival else case for case in cases]
    return Figures([one for case in scores if case is not None for one in case["published"]])


def rows_of(cases: Sequence[Case], key: str) -> list[tuple[str, ...]]:
    """Return the lines of a table by a key of the cases."""
    found: list[tuple[str, ...]] = []
    for name in dict.fromkeys(case[key] for case in cases):
        members = [case for case in cases if case[key] == name]
        mine, filed = figures(members), figures(members, rival=True)
        asked = sum(case["asked"] for case in members)
        found.append(
            (
                name,
                str(len(members)),
                str(sum(case["refused"] for case in members)),
                str(sum(case["code"] == "survey_not_assessable" for case in members)),
                f"{mine.count} of {asked}",
                f"{mine.error:.4f}",
                f"{mine.z:.2f}",
                f"{mine.half:.4f}",
                f"{mine.score:.4f}",
                f"{mine.cover:.3f}",
                *(
                    ("", "", "")
                    if not filed.count
                    else (f"{filed.error:.4f}", f"{filed.score:.4f}", f"{filed.cover:.3f}")
                ),
            )
        )
    return found


def _of_rival(filed: Figures) -> tuple[str, str, str]:
    return (f"{filed.error:.4f}", f"{filed.score:.4f}", f"{filed.cover:.3f}") if filed.count else ("", "", "")


def _published_as_good(case: Case) -> bool:
    """Whether conicities on a survey that is not refused do not hold the truth."""
    values = Figures(case["published"])
    return not case["refused"] and values.count > 0 and values.cover < COVER_UNDERSTATED


def _against_none(members: Sequence[Case], cases: Sequence[Case], name: str) -> BenchRow:
    """Return the comparison with the same fleets without a survey, over the numbers that both publish."""
    without = {(case["row"], case["seed"]): case for case in cases if case["survey"] == "none"}
    mine: list[Mapping[str, Any]] = []
    other: list[Mapping[str, Any]] = []
    counts = [0, 0]
    for case in members:
        none = without.get((case["row"], case["seed"]))
        if none is None or case["positions"] != none["positions"]:
            continue
        own, others = ({one["key"]: one for one in item["published"]} for item in (case, none))
        shared = own.keys() & others.keys()
        mine += [own[key] for key in sorted(shared)]
        other += [others[key] for key in sorted(shared)]
        counts = [counts[0] + len(own), counts[1] + len(others)]
    with_survey, alone = Figures(mine), Figures(other)
    text = (
        f"error {with_survey.error:.4f} for {alone.error:.4f}, interval score {with_survey.score:.4f}"
        f" for {alone.score:.4f}, published {counts[0]} for {counts[1]}"
    )
    no_worse = with_survey.score <= SAME * alone.score and with_survey.error <= SAME * alone.error
    met = no_worse and counts[0] >= counts[1]
    return BenchRow(f"survey of {name} for none, numbers of both", text, "error, score and count not worse", met)

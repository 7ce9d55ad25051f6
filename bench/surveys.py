"""Surveys as evidence: ``python -m bench surveys [--seeds 0-2] [--rows plain,coach,...] ...``.

Each drawn fleet (``survey_fleets``) meets its section without a survey, and with surveys of any std, stated as it is or
a fifth of it, and with wrong ones; the gauge is on file in all. Positions are off by 0.5 m, in two rows by 0 and 2 m.
Nothing is recorded or stored: signals go through the functions of the jobs (``survey_case``). Beside each survey the
rival uses it as it is on file.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import beta

from bench.report import BenchRow, Part, ResultTable, row_table
from bench.scores import COLUMNS, Cluster, Compared, Figures
from bench.study import Case, Key, Study, one_of
from bench.survey_case import SurveyPlan, moved, on_file, score
from bench.survey_fleets import COACH, FleetPlan, drawn_fleet
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleParameters

HEADER = (
    *("", "cases", "refused", "doubted", *COLUMNS),
    *("alignment error, mm", "stated, mm", "rival: error", "interval score", "cover"),
)
REFUSED = 0.005  # share of right surveys
FOUND = 0.99  # share of wrong ones
COVER_UNDERSTATED = 0.92
RESOLUTION = 0.0005  # of a conicity: half of the last digit that is shown
BEYOND = 2.0  # stds of a mean difference, beyond which it is no chance
FEWEST_FLEETS = 4  # for a std of such a mean
LEVEL = 0.95  # of the bounds of shares
USUAL = "0.5 m"  # error of positions


def summary(cases: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield the rows with what they have to reach."""
    right = [case for case in cases if case["right"]]
    wrong = [case for case in cases if not case["right"] and case["survey"] != "none"]
    refused = sum(case["refused"] for case in right)
    yield BenchRow(
        "right surveys refused",
        f"{refused} of {len(right)}, at most {most_share(refused, len(right)):.1%}",
        "<= 0.5 %",
        refused <= REFUSED * max(len(right), 1),
    )
    found = [case for case in wrong if case["code"] not in ("", "survey_confirmed") and not _published_as_good(case)]
    yield BenchRow(
        "wrong surveys found: refused, replaced, or doubted and widened",
        f"{len(found)} of {len(wrong)}, at least {1.0 - most_share(len(wrong) - len(found), len(wrong)):.1%};"
        f" {sum(case['refused'] for case in wrong)} refused",
        ">= 99 %",
        len(found) >= FOUND * len(wrong),
    )
    for name in dict.fromkeys(case["survey"] for case in right if not case["understated"]):
        yield from _against_none(cases, name)
    understated = [case for case in right if case["understated"]]
    values = figures(understated)
    yield BenchRow(
        "std understated five times: intervals that cover",
        f"{values.cover} of {values.count}, as filed {figures(understated, rival=True).cover}",
        ">= 92 %",
        values.count > 0 and values.cover.share >= COVER_UNDERSTATED,
    )
    for positions in ("0 m", "0.5 m", "2 m"):
        at = [case for case in right if case["survey"] == "0.3 mm" and case["positions"] == positions]
        mine, filed = figures(at), figures(at, rival=True)
        text = f"error {mine.error:.4f}, cover {mine.cover}; as filed {filed.error:.4f}, {filed.cover}"
        yield BenchRow(f"positions off by {positions}, survey of 0.3 mm", text, "shown", met=True)


def compared_of(published: Sequence[Mapping[str, Any]]) -> list[Compared]:
    """Return published conicities as they are kept."""
    return [Compared(one["error"], one["half_width"], one["covered"]) for one in published]


def differences(cases: Sequence[Case], surveys: Sequence[str]) -> list[tuple[str, ...]]:
    """Return by fleet what each survey changes against none: error, interval score, and against an honest none."""
    found = []
    for row in dict.fromkeys(case["row"] for case in cases):
        members = [case for case in cases if case["row"] == row]
        none = {(case["row"], case["seed"]): case for case in members if case["survey"] == "none"}
        honest = {key: case["rival"] for key, case in none.items() if case["rival"] is not None}
        cells = []
        for name in surveys:
            errors, scores = paired(members, none, name)
            parts = [errors, scores, paired(members, honest, name)[1]]
            cells.append(", ".join(f"{np.mean(np.concatenate(one)):+.4f}" for one in parts if one))
        found.append((row, *cells))
    return found


def most_share(count: int, of: int) -> float:
    """Return the largest share, at ``LEVEL``, that is seen so rarely (Clopper and Pearson, one side)."""
    return float(beta.ppf(LEVEL, count + 1, of - count)) if count < of else 1.0


def figures(cases: Sequence[Case], *, rival: bool = False) -> Figures:
    """Return the figures of all cases together; of the rival where asked for. A fleet and its surveys are a cluster."""
    clusters: dict[Key, tuple[list[Compared], list[str]]] = {}
    for case in cases:
        scored = case["rival"] if rival else case
        if scored is not None:
            published, withheld = clusters.setdefault((case["row"], case["seed"]), ([], []))
            published += compared_of(scored["published"])
            withheld += [case["code"]] * max(0, case["asked"] - len(scored["published"]))
    return Figures.of(Cluster(*numbers) for numbers in clusters.values())


def rows_of(cases: Sequence[Case], key: str) -> list[tuple[str, ...]]:
    """Return the lines of a table by a key of the cases."""
    found: list[tuple[str, ...]] = []
    for name in dict.fromkeys(case[key] for case in cases):
        members = [case for case in cases if case[key] == name]
        mine, filed = figures(members), figures(members, rival=True)
        found.append(
            (
                name,
                str(len(members)),
                str(sum(case["refused"] for case in members)),
                str(sum(case["code"] == "survey_not_assessable" for case in members)),
                *mine.cells,
                *(_millimetres(members, name) for name in ("alignment_error", "alignment_std")),
                *(filed.cells[COLUMNS.index(column)] for column in ("error", "interval score", "cover")),
            )
        )
    return found


def _millimetres(members: Sequence[Case], name: str) -> str:
    """Return the rms of what cases know of their alignments."""
    values = [case[name] for case in members if case[name] is not None]
    return f"{1e3 * float(np.sqrt(np.mean(np.square(values)))):.3f}" if values else ""


def _published_as_good(case: Case) -> bool:
    """Whether conicities on a survey that is not refused do not hold the truth."""
    held = [one.covered for one in compared_of(case["published"])]
    return not case["refused"] and bool(held) and float(np.mean(held)) < COVER_UNDERSTATED


@dataclass(frozen=True, slots=True)
class Paired:
    """Mean by which numbers that two cases both publish differ; its std by fleets, whose numbers share their errors."""

    mean: float
    std: float  # infinite where too few fleets show it
    fleets: int

    @classmethod
    def of(cls, by_fleet: Sequence[FloatArray]) -> Paired:
        """Return that of the differences of each fleet."""
        count = sum(len(one) for one in by_fleet)
        mean = sum(float(one.sum()) for one in by_fleet) / count
        squares = sum(float((one - mean).sum()) ** 2 for one in by_fleet)
        fleets = len(by_fleet)
        if fleets < FEWEST_FLEETS:
            return cls(mean, float("inf"), fleets)
        return cls(mean, float(np.sqrt(squares * fleets / (fleets - 1.0))) / count, fleets)

    @property
    def text(self) -> str:
        """Mean and std, or that it is not decided."""
        known = f"+- {self.std:.4f}" if np.isfinite(self.std) else "not decided"
        return f"{self.mean:+.4f} {known} (fleets: {self.fleets})"

    def no_worse(self, resolution: float) -> bool:
        """Whether it is decided that the difference is no more than chance, or than what anybody sees."""
        return bool(np.isfinite(self.std)) and self.mean <= max(BEYOND * self.std, resolution)


def paired(cases: Sequence[Case], others: Mapping[Any, Case], name: str) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return by fleet by how much errors and interval scores of a survey exceed those of others, number by number."""
    errors, scores = [], []
    for case in cases:
        other = others.get((case["row"], case["seed"]))
        if case["survey"] != name or other is None or case["positions"] != USUAL:
            continue
        own, without = ({one["key"]: one for one in item["published"]} for item in (case, other))
        shared = sorted(own.keys() & without.keys())
        if shared:
            pairs = [compared_of([own[key], without[key]]) for key in shared]
            errors.append(np.array([abs(one.error) - abs(none.error) for one, none in pairs]))
            scores.append(np.array([one.score - none.score for one, none in pairs]))
    return errors, scores


def _against_none(cases: Sequence[Case], name: str) -> Iterator[BenchRow]:
    none = {(case["row"], case["seed"]): case for case in cases if case["survey"] == "none"}
    honest = {key: case["rival"] for key, case in none.items() if case["rival"] is not None}
    mine = [case for case in cases if case["survey"] == name and case["positions"] == USUAL]
    own, alone = (sum(len(case["published"]) for case in group) for group in (mine, none.values()))
    what = f"survey of {name} for none"
    errors, scores = paired(cases, none, name)
    if not errors:
        yield BenchRow(f"{what}: numbers of both", "none", "some", met=False)
        return
    error = Paired.of(errors)
    met = error.no_worse(RESOLUTION) and own >= alone
    yield BenchRow(f"{what}: error, numbers", f"{error.text}, {own} for {alone}", "not worse, not fewer", met)
    for label, found in (("interval score", scores), ("the same with its true std", paired(cases, honest, name)[1])):
        if found:
            score = Paired.of(found)
            yield BenchRow(f"{what}: {label}", score.text, "not worse", met=score.no_worse(2.0 * RESOLUTION))


ROWS: Mapping[str, FleetPlan] = {
    "plain": FleetPlan(),
    "single wheelsets": FleetPlan(parameters=VehicleParameters(), bogies=False),
    "coach": FleetPlan(parameters=COACH),
    "slow": FleetPlan(speeds=(8.5, 11.0)),
    "few passes": FleetPlan(vehicles=2, journeys=2),
    "one vehicle": FleetPlan(vehicles=1),
    "switches": FleetPlan(switches=True),
    "one flat": FleetPlan(flat=True),
}
BY_SURVEY = (
    "By survey, over all fleets. The error of an alignment is against the truth in the waves of the motion, at its best"
    " place. The *rival* uses the file as it is; without one it states the std that the fleet's alignment truly has."
)
MM = 1e-3
SURVEYS: Mapping[str, SurveyPlan] = {
    "none": SurveyPlan(None),
    **{f"{std:g} mm": SurveyPlan(std * MM) for std in (0.05, 0.1, 0.3, 1.0, 3.0)},
    **{f"{std:g} mm stated as {std / 5:g}": SurveyPlan(std * MM, stated=0.2 * std * MM) for std in (0.25, 0.5, 1.5)},
    "shift 10 m": SurveyPlan(0.1 * MM, shift=10.0),
    "scale 1.2": SurveyPlan(0.1 * MM, scale=1.2),
    "other section": SurveyPlan(0.1 * MM, other_section=True),
    "other section 1 mm": SurveyPlan(MM, other_section=True),
    "sign": SurveyPlan(0.1 * MM, scale=-1.0),
    "sign 0.5 mm": SurveyPlan(0.5 * MM, scale=-1.0),
}
NAMES = [name for name, plan in SURVEYS.items() if plan.std is not None and plan.right and plan.stated is None]
POSITIONS = {"0 m": 0.0, "0.5 m": 0.5, "2 m": 2.0}
ALL_POSITIONS = ("0.3 mm",)  # surveys that are tried with every error of positions


def parts(cases: Sequence[Case]) -> list[Part]:
    """Return the page of results."""
    right = [case for case in cases if case["right"]]
    shown = ", ".join(f"{row} {seed}" for row, seed in dict.fromkeys((case["row"], case["seed"]) for case in cases))
    return [
        f"Fleets and seeds: {shown}.",
        row_table(summary(cases)),
        BY_SURVEY,
        ResultTable(HEADER, rows_of(cases, "survey"), range(1, len(HEADER))),
        "By fleet, over all right surveys.",
        ResultTable(HEADER, rows_of(right, "row"), range(1, len(HEADER))),
        "With a survey less without, by fleet: error, interval score, and that against none with its true std.",
        ResultTable(("", *NAMES), differences(cases, NAMES), range(1, len(NAMES) + 1)),
    ]


def fleet_cases(row: str, seed: int, surveys: Sequence[str] = tuple(SURVEYS)) -> Iterator[dict[str, Any]]:
    """Yield the scores of one drawn fleet with every survey, as JSON values."""
    fleet = drawn_fleet(ROWS[row], seed)
    for survey, plan in ((name, SURVEYS[name]) for name in surveys):
        for positions in POSITIONS if survey in ALL_POSITIONS else (USUAL,):
            at = moved(fleet, POSITIONS[positions], seed)
            found, rival = score(at, on_file(at, plan, seed), rival=plan.right)
            yield {
                "row": row,
                "seed": seed,
                "survey": survey,
                "positions": positions,
                "right": plan.std is not None and plan.right,
                "understated": plan.stated is not None,
                **asdict(found),
                "rival": None if rival is None else asdict(rival),
            }


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for seed, row in product(options.seeds, options.rows):
        if (row, seed) not in done:
            yield {"row": row, "seed": seed, "surveys": list(fleet_cases(row, seed, options.surveys))}


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--surveys", type=one_of(SURVEYS), default=list(SURVEYS), help="names; default: all")


main = Study(
    name="surveys",
    title="Surveys as evidence",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: parts([one for case in cases for one in case["surveys"]]),
    line=lambda case: f"{case['row']} seed {case['seed']}: {len(case['surveys'])} cases",
    rows=ROWS,
    options=_options,
).run

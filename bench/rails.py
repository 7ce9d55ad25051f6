"""Wheel and rail apart, over several sections: ``python -m bench rails [--seeds 0-19] ...``.

Every seed is a fleet of 12 wheelsets on four surveyed sections (``rails_sections``): simulated, ingested and estimated
by the scheduled jobs; in rows ``drawn`` on vehicles and creep that are off from those on file, in rows ``trend`` on
rails that wear over years.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from bench.coverage import RIGHT, Coverage
from bench.rails_case import score, score_trend
from bench.report import COLUMNS, Part, ResultTable
from bench.scores import AMPLITUDES, Cluster
from bench.study import Case, Key, Study
from estimation.errors import ScenarioError

KNOWN, THREE, TWO, NONE = "known rails", "three measured wheels", "two measured wheels", "none"
HOLD = (KNOWN, THREE, TWO)  # the level
REACH_RAILS, REACH_WHEELS = 0.02, 0.01
KINDS = ("exact", "drawn", "trend")
Results = Mapping[str, Any]
Error = tuple[float, float, bool]
"""Error, half width, and whether the interval covers."""
Rows = list[tuple[str, ...]]


def _held_by(results: Results, anchor: str, kind: str = "exact") -> list[Any]:
    return [case for case in results[kind] if case["anchor"] == anchor]


def _of_rails(cases: Sequence[Any], place: int | None = None) -> list[Error]:
    """Return errors of the reference wheel on the sections whose rails are not taken as known."""
    return [
        error
        for case in cases
        for section in case["sections"]
        if case["anchor"] != KNOWN or section["section"] != "S0"
        for at, error in enumerate(section["wheel"])
        if error is not None and place in (None, at)
    ]


def _of_wheels(cases: Sequence[Any], which: str, place: int | None = None) -> list[Error]:
    return [
        error
        for case in cases
        for wheelset in case["wheelsets"]
        for at, error in enumerate(wheelset[which])
        if error is not None and place in (None, at)
    ]


def _blamed(cases: Sequence[Any], which: str) -> list[float]:
    """Return the mean error of each wheelset over its amplitudes."""
    return [
        float(np.mean([error[0] for error in wheelset[which] if error is not None]))
        for case in cases
        for wheelset in case["wheelsets"]
        if any(error is not None for error in wheelset[which])
    ]


def _p95(errors: Sequence[float]) -> float:
    return float(np.quantile(np.abs(errors), 0.95))


def _summary(results: Results) -> Rows:
    rows: Rows = []
    for kind, vehicles in (("exact", ""), ("drawn", ", drawn vehicles")):
        for anchor in HOLD:
            cases = _held_by(results, anchor, kind)
            rows += _reached(f"{anchor}{vehicles}", cases) if cases else []
    today = _blamed(_held_by(results, KNOWN), "today")
    if today:
        rows.append(("today: wheelset's mean error, 95 %", f"{_p95(today):.4f}", "", ""))
        rows.append(_removed(results))
    refused = [wheelset["apart"] for case in _held_by(results, NONE) for wheelset in case["wheelsets"]]
    published = sum(error is not None for errors in refused for error in errors)
    rows.append(("no anchor: conicities of wheelsets published", str(published), "0", "yes" if not published else "NO"))
    return rows


def _reached(what: str, cases: Sequence[Any]) -> Rows:
    rails, wheels, bias = _of_rails(cases), _of_wheels(cases, "apart"), _blamed(cases, "apart")
    if not rails or not wheels:
        return [(f"{what}: anything published", "no", "yes", "NO")]
    return [
        _row(f"{what}: reference wheel per section, 95 %", _p95([one[0] for one in rails]), REACH_RAILS),
        _cover(f"{what}: reference wheel, intervals cover", [_of_rails([case]) for case in cases]),
        _row(f"{what}: wheelset's mean error, 95 %", _p95(bias), REACH_WHEELS),
        _cover(f"{what}: wheelsets, intervals cover", [_of_wheels([case], "apart") for case in cases]),
    ]


def _row(what: str, measured: float, reach: float) -> tuple[str, ...]:
    return what, f"{measured:.4f}", f"{reach:g}", "yes" if measured <= reach else "NO"


def _cover(what: str, fleets: Sequence[Sequence[Error]]) -> tuple[str, ...]:
    cover, (low, high) = Coverage.of([(len(fleet), sum(error[2] for error in fleet)) for fleet in fleets]), RIGHT
    return what, str(cover), f"{100 * low:g}-{100 * high:g} %", str(cover.verdict())


def _removed(results: Results) -> tuple[str, ...]:
    """Return how much of what is blamed on wheelsets is removed, over the errors that both have."""
    both = [
        (before[0], after[0])
        for case in _held_by(results, KNOWN)
        for wheelset in case["wheelsets"]
        for before, after in zip(wheelset["today"], wheelset["apart"], strict=False)
        if before is not None and after is not None
    ]
    before, after = (np.abs(column).mean() for column in np.array(both).T)
    return "of today's mean absolute error removed", f"{100 * (1 - after / before):.0f} %", "", ""


def _by_amplitude(results: Results) -> Rows:
    cases = _held_by(results, KNOWN)
    rows: Rows = []
    for place, amplitude in enumerate(1e3 * AMPLITUDES):
        rails = _of_rails(cases, place)
        apart, today = (_of_wheels(cases, which, place) for which in ("apart", "today"))
        rows.append((f"{amplitude:g}", *_figures(rails), *_figures(apart), *_figures(today)))
    return rows


def _figures(errors: Sequence[Error]) -> tuple[str, str]:
    return (str(len(errors)), f"{_p95([one[0] for one in errors]):.4f}" if errors else "")


def _findings(results: Results) -> Rows:
    rows: Rows = []
    for anchor in (*HOLD, NONE):
        sections = [one for case in _held_by(results, anchor) for one in case["sections"] if one["section"] != "S0"]
        for worn in (True, False):
            said = [one["exceeded"] for one in sections if one["worn"] is worn]
            counts = tuple(str(sum(one is answer for one in said)) for answer in (True, False, None))
            rows.append((anchor, "worn head, or another gauge" if worn else "as on file", str(len(said)), *counts))
    return rows


def _trends(results: Results) -> Rows:
    """Return each fleet whose rails wear: the trend, its interval and the truth, by year and by traffic."""
    rows: Rows = []
    for one in results["trend"]:
        if one["amplitude"] is None:
            rows.append((str(one["seed"]), "", "none", "", "", ""))
            continue
        (value, low, high), true = one["per_100_mgt"], one["true_per_100_mgt"]
        inside = low <= true <= high and one["per_year"][1] <= one["true_per_year"] <= one["per_year"][2]
        rows.append(
            (
                str(one["seed"]),
                f"{1e3 * one['amplitude']:g}",
                f"{value:+.3f} ({low:+.3f} to {high:+.3f})",
                f"{true:+.3f}",
                f"{one['true_per_year']:+.3f}",
                "yes" if inside else "no",
            )
        )
    return rows


TABLES = (
    ("", COLUMNS, _summary),
    (
        "By amplitude, level held by known rails: how many are published, and the 95th percentile of their errors",
        ("mm", "rails", "error", "wheelsets", "error ", "today", "error  "),
        _by_amplitude,
    ),
    (
        "Is the excess of a section beyond the limit?",
        ("level held by", "rails", "sections", "yes", "no", "not known"),
        _findings,
    ),
    (
        "Rails that wear over 2.2 years: trend of the excess, level held by known rails",
        ("fleet", "mm", "by 100 MGT", "true", "true, a year", "covered"),
        _trends,
    ),
)


def parts(results: Results) -> list[Part]:
    """Return the page of results."""
    tables = [ResultTable(header, rows(results), range(1, len(header)), title) for title, header, rows in TABLES]
    return [_head(results), *tables]


def _head(results: Results) -> str:
    exact, drawn = (_seeds(results, kind) for kind in KINDS[:2])
    head = f"Seeds {exact}: each a fleet of 12 wheelsets on four surveyed sections."
    if drawn:
        head += f" Seeds {drawn} also with vehicles, and creep on each section, drawn about what is on file."
    derailed = ", ".join(f"{seed} ({kind})" for kind, seed in results["derailed"])
    return head + (f" Left out, because a wheelset climbs a rail: {derailed}." if derailed else "")


def _seeds(results: Results, kind: str) -> str:
    return ", ".join(map(str, sorted({case["seed"] for case in results[kind]})))


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for kind, seed in product(options.rows, options.seeds):
        if (kind, seed) in done:
            continue
        case = {"row": kind, "seed": seed, "derailed": False, "scores": []}
        try:
            scores = [score_trend(seed)] if kind == "trend" else score(seed, drawn=kind == "drawn")
            yield case | {"scores": scores}
        except ScenarioError:  # a wheelset climbs a rail: no railway runs it
            yield case | {"derailed": True}


def _results(cases: Sequence[Case]) -> Results:
    """Return the scores by kind, and which seeds derailed."""
    scores = {kind: [one for case in cases if case["row"] == kind for one in case["scores"]] for kind in KINDS}
    return scores | {"derailed": [(case["row"], case["seed"]) for case in cases if case["derailed"]]}


def _published(case: Case) -> Cluster:
    """Return the conicities of the wheelsets of a fleet, wheel and rail apart, whose level is held."""
    scored = [one for one in case["scores"] if one.get("anchor") in HOLD]
    wheelsets = [wheelset for one in scored for wheelset in one["wheelsets"]]
    numbers = [number for wheelset in wheelsets for number in wheelset["apart"] if number is not None]
    return Cluster.read(numbers, [code for one in wheelsets for code in one["withheld"] if code])


main = Study(
    name="rails",
    title="Wheel and rail apart",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: parts(_results(cases)),
    line=lambda case: f"{case['row']} {case['seed']}: {'derailed' if case['derailed'] else 'done'}",
    rows=KINDS,
    published=_published,
).run

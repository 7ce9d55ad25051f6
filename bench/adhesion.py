"""Creep forces and friction: ``python -m bench adhesion [--seeds 0-2] [--rows low,...] [--write-docs]``.

Every row is a scenario file in ``bench/adhesion_scenarios``; every seed of it is simulated and estimated by the pure
functions that the jobs use (``adhesion_case``). ``wrong_file`` stands for the rows of ``adhesion_rows`` whose file is
wrong, ``quiet_rows`` for those with quiet sensors.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from bench.adhesion_case import LOW, judge, score, vehicle_km
from bench.adhesion_fleet import Fleet, simulate
from bench.adhesion_rows import (
    OF,
    ONE,
    QUIET,
    WRONG,
    as_on_file,
    as_seen,
    first_vehicle,
    quiet_scenario,
    with_others,
)
from bench.report import BenchRow, Columns, ResultTable, row_table
from bench.scores import Cluster
from bench.study import Case, Key, Study
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "adhesion_scenarios"
FILES = tuple(sorted({path.stem for path in SCENARIOS.glob("*.toml")} - set(QUIET)))
ROWS = (*FILES, *QUIET, *WRONG, *ONE)
GROUPS = {"wrong_file": (*WRONG, *ONE), "quiet_rows": tuple(QUIET)}
LEAST_LENGTH = 50.0  # m, of a place: what is shorter is not separated
JUDGED = "low"  # the row of the wanted numbers
WRONG_ROWS = {*WRONG, *ONE}
LEAST_HELD = 0.92  # share of intervals and of lower bounds, in rows whose file is wrong
CHOSEN_ON = range(30)  # seeds on which limits were chosen, or whose misses led to a rule
MOST_FALSE = 0.5e-3  # alarms a vehicle-km
JUST_ABOVE = 0.16  # friction below which an alarm is one of rails at the limit
DEEP = 0.12  # friction below which a stretch is clearly low
CERTAINTY = 0.95  # of the bound of a rate
NEAR = (0.12, 0.18)  # friction of places that are near the limit


def summary(cases: Sequence[Case]) -> list[BenchRow]:
    """Return what was measured beside what is to be reached."""
    judged = [case for case in cases if case["row"] == JUDGED]
    if not judged:
        return []
    seeds = f"{len(judged)} seeds"
    wrong = [case for case in cases if case["row"] in WRONG_ROWS]
    cases = [case for case in cases if case["row"] not in WRONG_ROWS]
    lateral, moment = _share(judged, "lateral"), _share(judged, "moment")
    speed = sum(case["wheelset_seconds"] for case in judged) / sum(case["force_seconds"] for case in judged)
    rows = [
        BenchRow(f"lateral creep force, rms error over rms, {seeds}", _percent(lateral), "10 %", lateral <= 0.10),
        BenchRow(f"yaw moment of creep, rms error over rms, {seeds}", _percent(moment), "10 %", moment <= 0.10),
        BenchRow(
            f"the same by integrals in Newton's equations, contact force and yaw moment, {seeds}",
            f"{_percent(_share(judged, 'newton_contact'))}, {_percent(_share(judged, 'newton_moment'))}"
            f" (filter: {_percent(_share(judged, 'contact'))}, {_percent(moment)})",
            "the filter is better",
            _share(judged, "contact") < _share(judged, "newton_contact"),
        ),
        _stretches_row(judged, seeds),
        _alarms_row(cases),
        BenchRow(
            "speed of the filter, per wheelset and core",
            f"{speed:.0f} times real time",
            ">= 1,000",
            speed >= 1000.0,
        ),
    ]
    if wrong:
        rows.append(_wrong_row(wrong))
    return rows + _conicity_rows(judged)


def _stretches_row(judged: Sequence[Case], seeds: str) -> BenchRow:
    found, every = _found(judged, LEAST_LENGTH), _found(judged)
    unseen = [case for case in judged if case["seed"] not in CHOSEN_ON]
    confirming, deep = _found(unseen, LEAST_LENGTH), _found(judged, LEAST_LENGTH, DEEP)
    return BenchRow(
        f"stretches of friction < 0.15, of 50 m or more, found within 200 m of their start, {seeds}",
        f"{_percent(np.mean(found))} of {len(found)}; of seeds that nothing was chosen on: {sum(confirming)} of"
        f" {len(confirming)}; of those that reach below {DEEP:g}: {sum(deep)} of {len(deep)}; with shorter ones"
        f" {_percent(np.mean(every))} of {len(every)}",
        ">= 95 %",
        bool(np.mean(found) >= 0.95),
    )


def _alarms_row(cases: Sequence[Case]) -> BenchRow:
    unseen = [case for case in cases if case["seed"] not in CHOSEN_ON]
    far, km = _false(cases, JUST_ABOVE), _km(cases)
    return BenchRow(
        "alarms without friction < 0.16 in them, all rows with friction but those whose file or sensors are wrong",
        f"{_rate(far, km)}, with 95 % at most {1e3 * most_often(far, km):.1f} (0 in {most_often(0, MOST_FALSE):.0f} km"
        f" are at most 0.5); of seeds that nothing was chosen on: {_rate(_false(unseen, JUST_ABOVE), _km(unseen))};"
        f" without friction < 0.15: {_false(cases)}, of those seeds {_false(unseen)}; {_by_row(cases)}",
        "< 0.5 per 1,000 km",
        far < MOST_FALSE * km,
    )


def most_often(count: int, exposure: float) -> float:
    """Return the rate that ``count`` events of a Poisson process in an exposure do not contradict.

    With a rate in place of the exposure it is the exposure that shows this rate.
    """
    return float(chi2.ppf(CERTAINTY, 2 * (count + 1))) / 2.0 / max(exposure, np.finfo(float).tiny)


def _conicity_rows(judged: Sequence[Case]) -> list[BenchRow]:
    """Return what leaving out the samples on low friction does to conicities; none where nothing was left out."""
    judged = [case for case in judged if case["conicity_left_out"]]
    left, kept = (_errors(judged, name) for name in ("conicity_left_out", "conicity_all"))
    if not judged:
        return []
    seeds = f"{len(judged)} seeds"
    return [
        BenchRow(
            f"conicity beside low friction, mean and mean absolute error, {seeds}",
            f"{_error(kept)} with every sample, {_error(left)} without those on certainly low friction",
            "mean absolute error smaller",
            float(np.abs(left).mean()) < float(np.abs(kept).mean()),
        )
    ]


def _wrong_row(cases: Sequence[Case]) -> BenchRow:
    """Return what holds in the worst of the rows whose file or sensors are wrong."""
    rows = [[case for case in cases if case["row"] == name] for name in sorted({case["row"] for case in cases})]
    held = [_held(of) for of in rows]
    covered = min(float(np.mean(one)) for one, _ in held if one)
    bounded = min(float(np.mean(one)) for _, one in held if one)
    return BenchRow(
        f"file or sensors wrong, the worst of {len(rows)} rows: places covered, lower bounds that hold",
        f"{_percent(covered)}, {_percent(bounded)}; alarms without friction < 0.15: {_rate(_false(cases), _km(cases))}",
        ">= 92 %",
        min(covered, bounded) >= LEAST_HELD,
    )


def _km(cases: Iterable[Case]) -> float:
    return float(sum(case["vehicle_km"] for case in cases if case["cells"]))


def _rate(alarms: int, km: float) -> str:
    return f"{alarms} in {km:.0f} vehicle-km: {1e3 * alarms / max(km, 1.0):.1f} per 1,000 km"


def _by_row(cases: Sequence[Case]) -> str:
    """Return the false alarms of each row that has some."""
    rows = {name: [case for case in cases if case["row"] == name] for name in sorted({case["row"] for case in cases})}
    some = [f"{name}: {_rate(_false(of), _km(of))}" for name, of in rows.items() if _false(of)]
    return "; ".join(some) or f"none in any of {len(rows)} rows"


def _near_limit(cells: Iterable[Case]) -> str:
    """Return the mean and the std of the errors of friction of places near the limit."""
    near = [one for one in cells if one["value"] is not None and NEAR[0] <= one["mean"] < NEAR[1]]
    errors = np.array([one["value"] - one["mean"] for one in near])
    return f"{errors.mean():+.3f}, {errors.std():.3f}" if len(errors) else ""


def _held(cases: Iterable[Case]) -> tuple[list[bool], list[bool]]:
    """Return whether each interval holds the true friction, and whether each lower bound is below it."""
    cells = [cell for case in cases for cell in case["cells"]]
    covered = [cell["low"] <= cell["mean"] <= cell["high"] for cell in cells if cell["value"] is not None]
    return covered, [cell["at_least"] <= cell["mean"] for cell in cells if cell["at_least"]]


def _share(cases: Iterable[Case], name: str) -> float:
    squares = [case[name] for case in cases]
    force = sum(one["force"] for one in squares)
    return float(np.sqrt(sum(one["error"] for one in squares) / force)) if force else float("nan")


def _found(cases: Iterable[Case], least_length: float = 0.0, below: float = LOW) -> list[bool]:
    return [
        one
        for case in cases
        for one, (begin, end) in zip(case["found"], case["stretches"], strict=True)
        if end - begin >= least_length and _least(case, begin, end) < below
    ]


def _least(case: Case, begin: float, end: float) -> float:
    """Return the least friction of the places that a stretch meets."""
    met = [one["least"] for one in case["cells"] if one["from"] < end and one["from"] + LEAST_LENGTH > begin]
    return min(met, default=0.0)


def _false(cases: Iterable[Case], limit: float = LOW) -> int:
    return sum(least >= limit for case in cases for _, _, least in case["alarms"])


def _errors(cases: Iterable[Case], name: str) -> np.ndarray:
    return np.array([error for case in cases for error in case[name]])


def _percent(share: float | np.floating[Any]) -> str:
    return f"{100.0 * share:.1f} %" if np.isfinite(share) else ""


def _error(errors: np.ndarray) -> str:
    return f"{errors.mean():+.4f}, {np.abs(errors).mean():.4f}" if len(errors) else ""


FRICTION_COLUMNS: Columns = {  # of a row, its cases and their places
    "row": lambda name, *_: name,
    "seeds": lambda _, of, __: str(len(of)),
    "lateral creep": lambda _, of, __: _percent(_share(of, "lateral")),
    "yaw moment": lambda _, of, __: _percent(_share(of, "moment")),
    "stretches below 0.15, of 50 m or more, found": lambda _, of, places: _count(_found(of, LEAST_LENGTH), places),
    "alarms without": lambda _, of, places: str(_false(of)) if places else "",
    "vehicle-km": lambda _, of, __: f"{sum(case['vehicle_km'] for case in of):.0f}",
    "places with an interval": lambda _, of, places: f"{len(_held(of)[0])} of {len(places)}" if places else "",
    "of those covered": lambda _, of, __: _mean(_held(of)[0]),
    "error of friction at 0.12 to 0.18, mean and std": lambda *given: _near_limit(given[2]),
    "lower bounds that hold": lambda _, of, __: _mean(_held(of)[1]),
    "seeds with a vehicle left out": lambda _, of, places: (
        str(sum(bool(case.get("left_out")) for case in of)) if places else ""
    ),
    "conicity error, all samples": lambda _, of, __: _error(_errors(of, "conicity_all")),
    "without low friction": lambda _, of, __: _error(_errors(of, "conicity_left_out")),
}


def friction_table(cases: Sequence[Case]) -> ResultTable:
    """Return a line for every row of the bench."""
    by_row = {name: [case for case in cases if case["row"] == name] for name in sorted({case["row"] for case in cases})}
    groups = ((name, of, [cell for case in of for cell in case["cells"]]) for name, of in by_row.items())
    return ResultTable.of(FRICTION_COLUMNS, groups)


def _count(found: Sequence[bool], places: Sequence[Case]) -> str:
    return f"{sum(found)} of {len(found)}" if places else ""


def _mean(held: Sequence[bool]) -> str:
    return _percent(np.mean(held)) if held else ""


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for seed in options.seeds:
        yield from _of_seed([row for row in options.rows if (row, seed) not in done], seed)


def _of_seed(rows: Sequence[str], seed: int) -> Iterator[dict[str, Any]]:
    """Yield the cases of rows for a seed; a scenario that rows share is simulated once."""
    for row in rows:
        if row in QUIET:
            quiet = as_seen(simulate(with_seed(quiet_scenario(SCENARIOS, QUIET[row]), seed)), QUIET[row])
            yield score(quiet, row, left_out_too=False).as_json()
    for file in FILES:
        of_file = [row for row in rows if row == file or (file == OF and row in WRONG | ONE)]
        if not of_file:
            continue
        fleet = simulate(with_seed(load_scenario(SCENARIOS / f"{file}.toml"), seed))
        if file in of_file:
            yield score(fleet, file).as_json()
        for row in of_file:
            if row in WRONG:
                yield score(as_on_file(fleet, WRONG[row]), row, left_out_too=False).as_json()
        if any(row in ONE for row in of_file):
            yield from _ones(fleet, [row for row in of_file if row in ONE])


def _ones(fleet: Fleet, rows: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the cases of a fleet whose first vehicle alone is wrong: the passes of the others are as they were."""
    right = score(fleet, OF, left_out_too=False).stored
    for row in rows:
        case = score(as_on_file(first_vehicle(fleet), ONE[row]), row, left_out_too=False)
        assert case.stored is not None
        assert right is not None
        friction = judge(with_others(case.stored, right))
        yield case.as_json() | asdict(friction) | {"vehicle_km": vehicle_km(fleet)}


def _line(case: Case) -> str:
    found = f"{sum(case['found'])} of {len(case['found'])} stretches, {len(case['alarms'])} alarms"
    return f"{case['row']} seed {case['seed']}: {found}"


def _published(case: Case) -> Cluster:
    """Return the friction of the places of a case: its fleet shares what is wrong of it."""
    known = [one for one in case["cells"] if one["value"] is not None]
    numbers = [
        (one["value"] - one["mean"], 0.5 * (one["high"] - one["low"]), one["low"] <= one["mean"] <= one["high"])
        for one in known
    ]
    bounded = ["lower bound alone" if one["at_least"] else "" for one in case["cells"] if one["value"] is None]
    return Cluster.read(numbers, bounded)


main = Study(
    name="adhesion",
    title="Creep forces and friction",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: [row_table(summary(cases)), friction_table(cases)],
    line=_line,
    published=_published,
    rows=ROWS,
    groups=GROUPS,
).run

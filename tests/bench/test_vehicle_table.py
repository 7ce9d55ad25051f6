"""Tables of the vehicle bench: what counts as found, as a false alarm and as published."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench.study import stored_cases
from bench.vehicles import CHANGED, ROWS, SCENARIOS, scenario_of, table


def case(row: str, statuses: list[str], *, covered: int = 0, error: float = 0.005, seed: int = 0) -> dict[str, Any]:
    """Return a case in which every wheelset that is ``estimated`` has 20 intervals, ``covered`` of them right."""
    verdicts = [
        {"serial": f"W{number}", "status": status, "code": "" if status == "estimated" else "why", "published": good}
        for number, status in enumerate(statuses)
        for good in [status == "estimated"]
    ]
    numbers = [[error, 0.01, place < covered] for place in range(20)]
    wheelsets = [
        {"serial": item["serial"], "error": error, "compared": numbers, "withheld": []}
        for item in verdicts
        if item["published"]
    ]
    cost = {"cpu_s": [1.0, 2.0, 3.0], "wheelset_hours": 3.0}
    return {"row": row, "seed": seed, "verdicts": verdicts, "wheelsets": wheelsets, **cost}


def cells(*cases: dict[str, Any]) -> dict[str, str]:
    """Return the one line of the table by column."""
    shown = table(cases)
    (row,) = shown.rows
    return dict(zip(shown.header, row, strict=True))


@pytest.mark.parametrize(
    ("statuses", "covered", "error", "met"),
    [
        (["estimated"] * 4, 19, 0.005, "yes"),
        (["estimated"] * 4, 20, 0.005, "NO"),  # too wide
        (["estimated"] * 4, 19, 0.011, "NO"),  # error
        (["estimated"] * 4, 17, 0.005, "NO"),  # coverage
        (["estimated"] * 3 + ["model_mismatch"], 19, 0.005, "NO"),  # a false alarm
        (["model_mismatch"] * 4, 19, 0.005, "NO"),
    ],
)
def test_a_right_class_is_held_to_error_coverage_and_false_alarms(
    statuses: list[str], covered: int, error: float, met: str
) -> None:
    cases = [case("soft_known", statuses, covered=covered, error=error, seed=seed) for seed in range(40)]
    assert cells(*cases)["met"] == met


def test_a_few_fleets_decide_no_coverage_but_an_error() -> None:
    few = [case("soft_known", ["estimated"] * 4, covered=20, seed=seed) for seed in range(3)]
    assert cells(*few)["met"] == "not decided"
    assert cells(*few, case("soft_known", ["estimated"] * 4, covered=20, error=0.2, seed=3))["met"] == "NO"


def test_half_widths_are_reached_too() -> None:
    cases = [case("soft_unknown", ["estimated"] * 4, covered=19, error=0.004, seed=seed) for seed in range(40)]
    assert cells(*cases)["met"] == "NO"  # +-0.01 where +-0.005 is asked


@pytest.mark.parametrize(
    ("statuses", "met"),
    [
        (["model_mismatch"] * 3 + ["unestimated"], "yes"),
        (["model_mismatch"] * 3 + ["estimated"], "NO"),
    ],
)
def test_of_a_wrong_class_nothing_may_be_published(statuses: list[str], met: str) -> None:
    found = cells(case("wrong_nodes_swapped", statuses, covered=19))
    assert found["met"] == met
    assert found["mismatch"] == "3 of 4"
    assert found["CPU s/h"] == "2.0"
    assert found["reasons"] == f"why {sum(status != 'estimated' for status in statuses)}"


def test_a_fleet_without_alignment_has_the_verdict_on_its_survey_as_reason() -> None:
    waiting = case("coach_known", ["unestimated"] * 2) | {"survey": "survey_unit"}
    for verdict in waiting["verdicts"]:
        verdict["code"] = ""
    assert cells(waiting)["reasons"] == "survey_unit"


def test_every_row_is_a_scenario_file() -> None:
    assert {path.stem for path in SCENARIOS.glob("*.toml")} <= set(ROWS)
    assert all((SCENARIOS / f"{CHANGED.get(row, (row,))[0]}.toml").exists() for row in ROWS)


def test_results_are_read_as_far_as_they_go_and_the_last_of_a_case_counts(tmp_path: Path) -> None:
    path = tmp_path / "vehicles.jsonl"
    assert stored_cases(path, ("row", "seed")) == []
    lines = [{"row": "a", "seed": 0, "x": 1}, {"row": "a", "seed": 1, "x": 2}, {"row": "a", "seed": 0, "x": 3}]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    assert [(item["seed"], item["x"]) for item in stored_cases(path, ("row", "seed"))] == [(0, 3), (1, 2)]


@pytest.mark.parametrize("row", CHANGED)
def test_a_changed_row_is_a_scenario_that_differs(row: str) -> None:
    changed, base = scenario_of(row, 1), scenario_of(CHANGED[row][0], 1)
    assert changed.name == row
    assert replace(changed, name=base.name) != base

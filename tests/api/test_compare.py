"""``treadwatch compare``: as a person runs it, what its words say, and what a bad scenario gives."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli import build
from api.comparison.report import as_json, nearest, words
from api.comparison.study import Example, PairStudy, Score, Told, against_truth
from estimation.contact.conicity import equivalent_conicity
from estimation.estimators.catalogue import SHIPPED, estimators
from estimation.estimators.interface import EstimatorParameters
from estimation.estimators.replicates import Replicates, curve_estimate
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.simulator.section_run import AMPLITUDES, WheelsetTruth

SCENARIO = """\
name = "tiny"
description = "two vehicles on two kilometres"
[fleet]
vehicles = 2
wheelsets = 1
passes = 2
[section]
length_m = 2000.0
[known]
alignment = false
[[pairs]]
name = "smooth"
wheel_profile = "S1002"
rail_profile = "60E1"
rail_inclination_1_in = 40.0
deepest_wear_mm = 0.6
"""
NAMES = [item.name for item in estimators()]


def score(name: str, told: Told, errors: tuple[float, ...], estimated: int = 18) -> Score:
    return Score("P8/113A", told, name, errors, 2, 18, estimated, estimated - 1, 1.0)


def truth() -> WheelsetTruth:
    x = np.linspace(-10e-3, 10e-3, 401)
    zero = np.zeros(401)
    return WheelsetTruth(
        number=0,
        serial="W00",
        vehicle="V0",
        axle=1,
        displacement=x,
        difference=0.4 * x,
        radius_sum=zero,
        angle_sum=zero,
        angle_difference=zero,
        amplitude=np.array(AMPLITUDES),
        conicity=equivalent_conicity(x, 0.4 * x, AMPLITUDES),
        nonlinearity=0.0,
        zero_crossing=0.0,
        parameters=VehicleParameters(),
    )


def paired(scores: tuple[Score, ...], untold: dict[Told, str] | None = None) -> PairStudy:
    return PairStudy("P8/113A", 0, scores, untold or {}, 1.0, Example(truth(), {}))


def test_a_baseline_that_wins_is_named() -> None:
    near, far = (0.01, 0.02), (0.015, 0.05)
    scores = tuple(score(name, Told.KNOWN, near if name == "cubic" else far) for name in NAMES)
    scores += tuple(score(name, Told.FLEET, near if name == SHIPPED else far) for name in NAMES)
    scores += tuple(score(name, Told.NOTHING, (), 0) for name in NAMES)
    known, fleet, nothing = words([paired(scores)])
    assert known.startswith("P8/113A, track known: a baseline wins, piecewise cubic least squares")
    assert "0.0195" in known
    assert "locally linear bins reach 0.0483" in known
    assert "locally linear bins win" in fleet
    assert "follows with 0.0483" in fleet
    assert "nearest for 2 of 2 wheelsets" in fleet
    assert "no estimator estimates half of the amplitudes" in nothing


def test_where_nobody_comes_near_nobody_wins() -> None:
    scores = tuple(score(name, Told.NOTHING, (0.12, 0.1 if name == SHIPPED else 0.2)) for name in NAMES)
    (said,) = words([paired(scores, {Told.KNOWN: "x", Told.FLEET: "y"})])[2:]
    assert "nobody comes near; the least wrong are locally linear bins" in said
    assert "win" not in said


def test_each_wheelset_has_one_who_is_nearest() -> None:
    errors = {"bins": (0.01, 0.03), "linear": (0.02, np.nan), "paper": (np.nan, 0.02), "cubic": (np.nan, np.nan)}
    found = nearest(paired(tuple(score(name, Told.KNOWN, values) for name, values in errors.items())))
    assert found == {(Told.KNOWN, name): number for name, number in zip(errors, (1, 0, 1, 0), strict=True)}


def test_who_estimates_next_to_nothing_does_not_win() -> None:
    scores = tuple(
        score(name, Told.KNOWN, (0.001,), 2) if name == "paper" else score(name, Told.KNOWN, (0.02,)) for name in NAMES
    )
    said = words([paired(scores, {Told.FLEET: "the passes are too alike", Told.NOTHING: "none"})])
    assert "the paper's algorithm" not in said[0]
    assert said[1] == "P8/113A, track from the fleet: nothing can be told: the passes are too alike."
    figures = as_json([paired(scores)], "tiny")
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures


def test_errors_are_those_of_the_amplitudes_that_are_estimated() -> None:
    x = np.linspace(-2.1e-3, 2.1e-3, 85)
    curve = Replicates(x, 0.44 * x, np.empty((0, 85)), 0.45 * x[None], 100, 1)
    parameters = EstimatorParameters(curve=replace(EstimatorParameters().curve, amplitudes=(0.5e-3, *AMPLITUDES)))
    compared = against_truth(curve_estimate(curve, parameters), truth())
    assert len(compared) == 5  # 1.0 to 2.0 mm; the curve ends at 2.1
    assert [error for error, _ in compared] == pytest.approx([0.02] * 5, rel=1e-3)
    assert not any(inside for _, inside in compared)


def test_a_tiny_section_is_compared_printed_and_drawn(tmp_path: Path) -> None:
    path = tmp_path / "tiny.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    out = tmp_path / "out"
    arguments = ["compare", "--scenario", str(path), "--seed", "1", "--out", str(out)]
    shown = CliRunner().invoke(build(["compare"]), arguments)
    assert shown.exit_code == 0, shown.output
    figures = json.loads((out / "comparison.json").read_text())
    known = {item["estimator"]: item for item in figures["pairs"][0]["scores"] if item["track"] == "known"}
    assert sorted(known) == sorted(NAMES)
    assert known[SHIPPED]["estimated"] >= 9
    assert known[SHIPPED]["median_error"] < 0.02 < known["linear"]["median_error"]
    assert all(sentence in shown.output for sentence in figures["words"])
    assert (out / "comparison.png").read_bytes().startswith(b"\x89PNG")
    rows = (out / "comparison.md").read_text().splitlines()
    assert len(rows) == 2 + len(figures["pairs"][0]["scores"])
    assert len({row.count("|") for row in rows}) == 1
    again = CliRunner().invoke(build(["compare"]), [*arguments, "--json"])
    printed = json.loads(again.stdout)
    assert printed["words"] == figures["words"]


def test_a_bad_scenario_ends_with_a_line_that_names_file_and_field(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(SCENARIO.replace("passes = 2", "passes = -2"), encoding="utf-8")
    command = [sys.executable, "-c", "from api.cli import main; main()", "compare", "--scenario", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == f"treadwatch: {path}:6, field 'fleet.passes': -2 is outside 1 to 100\n"
    assert not (tmp_path / "comparison").exists()

"""``treadwatch compare``: as a person runs it, its sentences, and a bad scenario."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from in_process_command import Run
from matplotlib.figure import Figure
from typer.testing import CliRunner

from api.cli import build
from api.comparison.report import as_json, draw_errors, nearest, sentences_of
from api.comparison.study import AMPLITUDES, Example, PairStudy, Score, TrueWheelset, conicity_errors
from api.comparison.study import TrackInformation as Track
from estimation.contact.conicity import equivalent_conicity
from estimation.estimators.catalogue import SHIPPED, estimators
from estimation.estimators.interface import (
    EstimatorParameters,
    Replicates,
    curve_estimate,
    geometry_from_curve,
)
from estimation.tables.bin_table import BinParameters

SCENARIO = """\
name = "tiny"
description = "two vehicles on a kilometre and a half"
seed = 1
[fleet]
code = "T"
name = "Tiny fleet"
[section]
code = "S"
number = 12
name = "Short section"
length_m = 1500.0
surveyed = false
[speed]
lowest_m_s = 16.0
highest_m_s = 25.0
steady = true
[sessions]
start = 2024-03-18T00:00:00Z
campaigns = 2
whole_section = true
km_between = 100.0
[drawn_fleet]
vehicles = 2
wheelsets_each = 1
[[drawn_fleet.pairs]]
name = "smooth"
wheel_profile = "S1002"
rail_profile = "60E1"
rail_inclination_1_in = 40.0
deepest_wear_mm = 0.6
"""
NAMES = [item.name for item in estimators()]


def score(name: str, track: Track, errors: tuple[float, ...], estimated: int = 18) -> Score:
    return Score("P8/113A", track, name, errors, 2, 18, estimated, estimated - 1, 1.0)


def truth() -> TrueWheelset:
    x = np.linspace(-10e-3, 10e-3, 401)
    zero = np.zeros(401)
    return TrueWheelset(
        serial="W00",
        displacement=x,
        difference=0.4 * x,
        radius_sum=zero,
        angle_sum=zero,
        angle_difference=zero,
        amplitude=np.array(AMPLITUDES),
        conicity=equivalent_conicity(x, 0.4 * x, AMPLITUDES),
        nonlinearity=0.0,
        zero_crossing=0.0,
    )


def paired(scores: tuple[Score, ...], unestimated: dict[Track, str] | None = None) -> PairStudy:
    return PairStudy("P8/113A", 0, scores, unestimated or {}, 1.0, Example(truth(), {}))


def test_every_estimator_has_a_colour_and_a_marker_of_its_own_and_every_track_a_place() -> None:
    figure = Figure()
    scores = tuple(score(name, track, (0.01, 0.02)) for track in Track for name in NAMES)
    draw_errors(figure.subplots(), paired(scores))
    dots = figure.axes[0].get_lines()
    assert len({(line.get_color(), line.get_marker()) for line in dots}) == len(NAMES)
    assert len({line.get_color() for line in dots}) == len({line.get_marker() for line in dots}) == len(NAMES)
    ticks = np.repeat(np.arange(len(Track)), len(NAMES))
    for line, tick in zip(dots, ticks, strict=True):
        assert np.abs(np.asarray(line.get_xdata()) - tick).max() < 0.5


def test_a_track_on_which_nothing_is_estimated_says_so() -> None:
    scores = tuple(score(name, track, () if track is Track.NONE else (0.01,)) for track in Track for name in NAMES)
    axes = Figure().subplots()
    draw_errors(axes, paired(scores))
    assert [(one.get_text(), one.get_position()[0]) for one in axes.texts] == [("nothing estimated", 2)]


def test_a_baseline_that_wins_is_named() -> None:
    near, far = (0.01, 0.02), (0.015, 0.05)
    scores = tuple(score(name, Track.KNOWN, near if name == "cubic" else far) for name in NAMES)
    scores += tuple(score(name, Track.FLEET, near if name == SHIPPED else far) for name in NAMES)
    scores += tuple(score(name, Track.NONE, (), 0) for name in NAMES)
    known, fleet, nothing = sentences_of([paired(scores)])
    assert known.startswith("P8/113A, track known: a baseline wins, piecewise cubic least squares")
    assert "0.0195" in known
    assert "locally linear bins reach 0.0483" in known
    assert "locally linear bins win" in fleet
    assert "follows with 0.0483" in fleet
    assert "nearest for 2 of 2 wheelsets" in fleet
    assert "no estimator estimates half of the amplitudes" in nothing


def test_without_an_accurate_estimator_none_wins() -> None:
    scores = tuple(score(name, Track.NONE, (0.12, 0.1 if name == SHIPPED else 0.2)) for name in NAMES)
    (sentence,) = sentences_of([paired(scores, {Track.KNOWN: "x", Track.FLEET: "y"})])[2:]
    assert "none comes near; the nearest are locally linear bins" in sentence
    assert "win" not in sentence


def test_each_wheelset_has_one_who_is_nearest() -> None:
    errors = {"bins": (0.01, 0.03), "linear": (0.02, np.nan), "paper": (np.nan, 0.02), "cubic": (np.nan, np.nan)}
    found = nearest(paired(tuple(score(name, Track.KNOWN, values) for name, values in errors.items())))
    assert found == {(Track.KNOWN, name): number for name, number in zip(errors, (1, 0, 1, 0), strict=True)}


def test_who_estimates_next_to_nothing_does_not_win() -> None:
    scores = tuple(
        score(name, Track.KNOWN, (0.001,), 2) if name == "paper" else score(name, Track.KNOWN, (0.02,))
        for name in NAMES
    )
    lines = sentences_of([paired(scores, {Track.FLEET: "the passes are too alike", Track.NONE: "none"})])
    assert "the paper's algorithm" not in lines[0]
    assert lines[1] == "P8/113A, track from the fleet: nothing is estimated: the passes are too alike."
    figures = as_json([paired(scores)], "tiny")
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures


def test_errors_are_those_of_the_amplitudes_that_are_estimated() -> None:
    x = np.linspace(-2.1e-3, 2.1e-3, 85)
    curve = Replicates(x, 0.44 * x, np.empty((0, 85)), 0.45 * x[None], 100, 1)
    parameters = EstimatorParameters(curve=replace(EstimatorParameters().curve, amplitudes=(0.5e-3, *AMPLITUDES)))
    edges = BinParameters().edges
    samples = np.zeros(len(edges) - 1)
    found = geometry_from_curve(curve_estimate(curve, parameters), parameters, samples, edges, "key")
    compared = conicity_errors(found, truth())
    assert [item is None for item in compared] == 5 * [False] + 4 * [True]  # 1.0 to 2.0 mm; the curve ends at 2.1
    assert [item[0] for item in compared if item] == pytest.approx([0.02] * 5, rel=1e-3)
    assert not any(item[1] for item in compared if item)


@pytest.mark.slow
def test_a_tiny_section_is_compared_printed_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # the other cores have tests of their own
    path = tmp_path / "tiny.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    out = tmp_path / "out"
    arguments = ["compare", "--scenario", str(path), "--seed", "1", "--out", str(out)]
    shown = CliRunner().invoke(build(["compare"]), arguments)
    assert shown.exit_code == 0, shown.output
    figures = json.loads((out / "comparison.json").read_text())
    assert {item["track"] for item in figures["pairs"][0]["scores"]} >= {"known", "none"}
    known = {item["estimator"]: item for item in figures["pairs"][0]["scores"] if item["track"] == "known"}
    assert sorted(known) == sorted(NAMES)
    assert known[SHIPPED]["estimated"] >= 9
    assert known[SHIPPED]["median_error"] < 0.02 < known["linear"]["median_error"]
    assert all(sentence in shown.output for sentence in figures["sentences"])
    assert (out / "comparison.png").read_bytes().startswith(b"\x89PNG")
    rows = (out / "comparison.md").read_text().splitlines()
    assert len(rows) == 2 + len(figures["pairs"][0]["scores"])
    assert len({row.count("|") for row in rows}) == 1


def test_a_bad_scenario_ends_with_a_line_that_names_file_and_field(treadwatch: Run, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(SCENARIO.replace("wheelsets_each = 1", "wheelsets_each = 0"), encoding="utf-8")
    done = treadwatch("compare", "--scenario", path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"treadwatch: {path}:24, field 'drawn_fleet.wheelsets_each': 0 is outside")
    assert not (tmp_path / "comparison").exists()

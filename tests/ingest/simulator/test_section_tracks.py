"""What is told of a track, on a simulated section: positions put right, gauge taken over, nothing told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from section_text import SMALL_SECTION

from estimation.estimators.tracks import (
    TrackKnowledge,
    fleet_knowledge,
    motions,
    section_passes,
    straight_track,
)
from estimation.jobs.settings import EstimationSettings
from estimation.track.passes import Pass
from estimation.track.settings import AlignmentSettings
from ingest.simulator.section_file import read_section_scenario
from ingest.simulator.section_run import SECTION, SectionRun, simulate_section

SETTINGS, ALIGNMENT = EstimationSettings(), AlignmentSettings()


@pytest.fixture(scope="module")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> SectionRun:
    folder: Path = tmp_path_factory.mktemp("tracks")
    path = folder / "section.toml"
    path.write_text(SMALL_SECTION, encoding="utf-8")
    return simulate_section(read_section_scenario(path), 3, folder, workers=1)


@pytest.fixture(scope="module")
def found(small_run: SectionRun) -> list[Pass]:
    return section_passes(small_run.all_windows(), SETTINGS.windows, ALIGNMENT)


def test_a_known_alignment_puts_every_window_where_it_was(small_run: SectionRun, found: list[Pass]) -> None:
    known = fleet_knowledge(found, small_run.true_track(), SECTION, 2000.0, ALIGNMENT)
    assert isinstance(known, TrackKnowledge)
    exact = replace(small_run, scenario=replace(small_run.scenario, position_offset=0.0, position_scale=0.0))
    before = []
    for measured, true in zip(small_run.all_windows(), exact.all_windows(), strict=True):
        placed = known.placed(measured)
        assert placed is not None
        both = measured.valid & true.valid
        before.append(np.abs(measured.distance - true.distance)[both].max())
        assert np.abs(placed.distance - true.distance)[both].max() < 0.5
        correction = known.correction_of(measured)
        assert correction is not None
        np.testing.assert_array_equal(correction.at(measured.distance), placed.distance)
    assert max(before) > 2.0


def test_a_window_of_a_journey_that_nobody_knows_is_left_out(small_run: SectionRun, found: list[Pass]) -> None:
    known = fleet_knowledge(found, small_run.true_track(), SECTION, 2000.0, ALIGNMENT)
    assert isinstance(known, TrackKnowledge)
    window = next(iter(small_run.windows("W00")))
    assert known.placed(replace(window, vehicle="stranger")) is None
    assert known.correction_of(replace(window, start_ns=0)) is None
    assert list(motions([replace(window, vehicle="stranger")], known, SETTINGS.windows)) == []


def test_the_gauge_alone_is_taken_over(small_run: SectionRun, found: list[Pass]) -> None:
    track = small_run.true_track()
    gauge = 1e-3 * np.sin(track.s / 20.0)
    nothing = np.full(len(track.s), np.nan)
    told = replace(track, alignment=nothing, alignment_std=nothing, gauge_deviation=gauge, gauge_known=True)
    known = fleet_knowledge(found, told, SECTION, 2000.0, ALIGNMENT)
    assert isinstance(known, TrackKnowledge)
    assert known.track.gauge_known
    np.testing.assert_allclose(known.track.gauge_deviation, 1e-3 * np.sin(known.track.s / 20.0), atol=2e-5)


def test_no_pass_tells_nothing(small_run: SectionRun) -> None:
    assert fleet_knowledge([], None, SECTION, 2000.0, ALIGNMENT) == "no pass"
    window = next(iter(small_run.windows("W00")))
    assert TrackKnowledge(small_run.true_track()).placed(window) is window


def test_without_track_y_is_taken_for_y_minus_d(small_run: SectionRun) -> None:
    exact = replace(small_run, scenario=replace(small_run.scenario, position_offset=0.0, position_scale=0.0))
    windows = list(exact.windows("W00"))
    blind = list(motions(windows, TrackKnowledge(straight_track(SECTION, 2000.0)), SETTINGS.windows))
    seen = list(motions(windows, TrackKnowledge(exact.true_track()), SETTINGS.windows))
    for y, relative in zip(blind, seen, strict=True):
        both = y.valid & relative.valid
        d = (y.displacement - relative.displacement)[both]
        assert 1e-3 < d.std() < 3e-3
        np.testing.assert_allclose(y.yaw_acceleration[both], relative.yaw_acceleration[both], atol=1e-9)

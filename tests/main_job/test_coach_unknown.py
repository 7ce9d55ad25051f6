"""Coaches over a section of which nothing is on file: their bogies find the track, and then themselves on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from api.comparison.study import read_truth
from api.comparison.trial import deploy, opened, receive, record, run_jobs
from bench.made_scenario import changed_scenario
from bench.vehicles import SCENARIOS
from estimation.bogie.parameters import BOGIE_TRACK
from estimation.jobs.steps.bogie_geometry import BOGIE_FOUND
from estimation.values.track import AlignmentSource

CHANGES = {
    "section": {"length_m": 3000.0},
    "sessions": {"campaigns": 8, "minutes_each": 1.0},
    "drawn_fleet": {"vehicles": 2},
}


@pytest.mark.slow
def test_bogies_find_the_track_and_their_conicities_where_single_wheelsets_leave_it_open(tmp_path: Path) -> None:
    scenario = changed_scenario(SCENARIOS / "coach_unknown.toml", CHANGES)
    recorded = record(scenario, tmp_path / "recordings", workers=1)
    settings = deploy(scenario, tmp_path)
    receive(recorded, settings)
    with opened(settings) as (storage, context):
        run_jobs(context)
        with storage.read() as unit:
            alignment = unit.tracks.alignment(scenario.section.code)
            truths = read_truth(recorded.truth)
            records = {truth.serial: unit.geometries.current(truth.serial) for truth in truths}
            refused = unit.windows.counts()
    assert alignment is not None
    assert alignment.source is AlignmentSource.FLEET
    assert alignment.findings is None
    assert alignment.passes.max() >= 2 * BOGIE_TRACK.fewest_runs
    numbers = inside = 0
    for truth in truths:
        current = records[truth.serial]
        assert current is not None, refused
        assert "stiffness_ratio" in current.parameters[BOGIE_FOUND]
        pairs = zip(current.geometry.amplitude.tolist(), current.geometry.conicity, strict=True)
        published = {round(1e3 * a, 2): estimate for a, estimate in pairs if estimate.value is not None}
        for a, true in zip((1e3 * truth.amplitude).tolist(), truth.conicity.tolist(), strict=True):
            estimate = published.get(round(a, 2))
            if estimate is not None and 1.0 <= a <= 3.0:
                assert estimate.value is not None
                assert estimate.std is not None
                numbers += 1
                inside += abs(estimate.value - true) < 3.0 * estimate.std
    assert numbers > 20
    assert inside > 0.95 * numbers

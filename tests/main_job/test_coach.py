"""A coach through the product: its bogies are estimated as one, from what is stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from api.comparison.study import read_truth
from api.comparison.trial import deploy, opened, receive, record, run_jobs
from bench.made_scenario import changed_scenario
from bench.vehicles import SCENARIOS
from estimation.jobs.steps import bogie_geometry

CHANGES = {
    "sessions": {"campaigns": 4, "minutes_each": 2.0},
    "drawn_fleet": {"vehicles": 1, "wheelsets_each": 2},
}


@pytest.mark.slow
def test_both_wheelsets_of_a_coach_take_their_radii_from_one_fit(tmp_path: Path) -> None:
    scenario = changed_scenario(SCENARIOS / "coach_known.toml", CHANGES)
    recorded = record(scenario, tmp_path / "recordings", workers=1)
    settings = deploy(scenario, tmp_path)
    receive(recorded, settings)
    bogie_geometry._FITS.clear()
    with opened(settings) as (storage, context):
        run_jobs(context)
        fits = len(bogie_geometry._FITS)
        assert fits == 1, "the interval and the current geometry of both wheelsets are of the same windows"
        with storage.read() as unit:
            truths = read_truth(recorded.truth)
            records = {truth.serial: unit.geometries.current(truth.serial) for truth in truths}
        found = []
        for truth in truths:
            current = records[truth.serial]
            assert current is not None
            found.append(current.parameters[bogie_geometry.BOGIE_FOUND])
            pairs = zip(current.geometry.amplitude.tolist(), current.geometry.conicity, strict=True)
            published = {round(1e3 * a, 2): estimate for a, estimate in pairs if estimate.value is not None}
            assert published
            for a, true in zip((1e3 * truth.amplitude).tolist(), truth.conicity.tolist(), strict=True):
                estimate = published.get(round(a, 2))
                if estimate is not None:
                    assert estimate.std is not None
                    assert abs(estimate.value - true) < 3.5 * estimate.std
        assert found[0] == found[1]
        assert abs(found[0]["stiffness_ratio"] - 1.0) < 3.0 * found[0]["stiffness_ratio_std"]
        front = records[truths[0].serial]
        assert front is not None
        at_2_5_mm = int(np.argmin(np.abs(front.geometry.amplitude - 2.5e-3)))
        std = front.geometry.conicity[at_2_5_mm].std
        assert std is not None
        assert std < 0.02, "alone it has 0.03 and more"

"""A section without a survey, positions off by 20 m: from frames to conicity, as on a real line."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tiny_fleet import Deployment, deployment, recorded_once, true_conicity

from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.track import AlignmentSource
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.fleet import FleetReport
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

HEAD = """\
name = "unknown"
description = "two vehicles of three wheelsets, three campaigns, no survey"
seed = 5
[fleet]
code = "U"
name = "Unknown fleet"
[dynamics]
load = 12263.0

[section]
code = "U-1"
number = 1
name = "Section without a survey"
length_m = 2400.0
surveyed = false
[speed]
lowest_m_s = 14.0
highest_m_s = 22.0
[position]
largest_offset_m = 20.0
largest_scale_percent = 0.1
[sessions]
start = 2024-01-08T05:30:00Z
campaigns = 3
minutes_each = 1.55
first_odometer_km = 1000.0
km_between = 300.0
start_within_m = 150.0
"""
VEHICLE = """
[[vehicles]]
code = "{code}"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [2.0, 4.5, 16.5]
"""
WHEELSET = """
[[vehicles.wheelsets]]
serial = "{serial}"
initial_wear_mm = {wear}
initial_mileage_km = 100000.0
"""
WEAR = {"U-A": (0.1, 0.9, 0.5), "U-B": (1.2, 0.3, 0.7)}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    text = HEAD
    for code, depths in WEAR.items():
        text += VEHICLE.format(code=code)
        text += "".join(WHEELSET.format(serial=f"{code}{axle}", wear=depth) for axle, depth in enumerate(depths))
    path = tmp_path_factory.mktemp("scenario") / "unknown.toml"
    path.write_text(text)
    return load_scenario(path)


@pytest.fixture(scope="module")
def report(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> FleetReport:
    return recorded_once(tmp_path_factory, scenario)


@pytest.fixture
def unknown(migrated_sqlite_file: Path, tmp_path: Path, report: FleetReport) -> Iterator[Deployment]:
    file = tmp_path / "unknown.sqlite3"
    shutil.copyfile(migrated_sqlite_file, file)
    found = deployment(f"sqlite:///{file}", tmp_path / "unknown", report)
    yield found
    found.storage.close()


@pytest.mark.slow
def test_conicity_comes_out_without_a_survey_and_journeys_are_put_where_they_ran(
    unknown: Deployment, scenario: Scenario, report: FleetReport
) -> None:
    for campaign in (1, 2, 3):
        unknown.campaign_over([one for one in report.recordings if one.campaign == campaign])
        unknown.run_jobs()
    with unknown.storage.read() as unit:
        versions = unit.tracks.versions("U-1", None, 10)
        track_report = unit.tracks.report("U-1")
        geometries = {one.serial: unit.geometries.current(one.serial) for one in unit.registry.wheelsets()}
    assert [one.source for one in versions] == [AlignmentSource.FLEET] * len(versions)
    assert track_report is not None
    assert track_report.status is Status.ESTIMATED
    errors = []
    for serial, record in geometries.items():
        assert record is not None
        assert set(record.track_versions["U-1"]) <= {one.version for one in versions}
        known = dict(zip(np.round(1e3 * record.geometry.amplitude, 6), record.geometry.conicity, strict=True))
        for amplitude in (1.5, 2.0, 2.5):  # mm, at which the truth is on file
            value = known[amplitude].value
            if value is None:  # next to a contact jump, whose place an unknown gauge leaves open
                assert amplitude < 2.0
                assert code_of(known[amplitude].reason) is ReasonCode.CONICITY_OPEN
                continue
            errors.append(value - true_conicity(report.truth, serial, record.mileage_km, amplitude))
    assert np.abs(errors).max() < 0.03
    assert np.median(np.abs(errors)) < 0.01
    _check_positions(unknown, scenario)


def _check_positions(unknown: Deployment, scenario: Scenario) -> None:
    """All journeys of all campaigns coincide; the position of the fleet as a whole is not observable."""
    track = scenario_track(scenario)
    left = []
    with unknown.storage.read() as unit:
        for campaign in range(scenario.sessions.campaigns):
            for vehicle in scenario.vehicles:
                run = vehicle_run(scenario, track, vehicle, campaign)
                (first, *_) = unit.windows.list(vehicle.wheelsets[0].serial, run.start_ns, run.start_ns + 10**11)
                position = unit.tracks.position(first.wheelset, first.start_ns)
                assert position is not None
                corrected = run.reported + position.offset_m + position.scale * (run.reported - position.middle_m)
                left.append(np.interp([600.0, 1200.0], run.distance, corrected - run.distance))
    apart = np.array(left) - np.mean(left, axis=0)
    assert np.abs(apart).max() < 1.0

"""A small fleet on its bus: what the frames say, read with cantools and our codec, against what was simulated."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from same_values import same_values
from scenario_text import SMALL

from bench.wheelset_motion import wheelset_motion
from estimation.errors import ScenarioError
from estimation.values.windows import ACCELERATIONS
from ingest.catalogue import default_catalogue, vehicle_time_ns
from ingest.codec import Decoded, decode
from ingest.frames import FrameBatch
from ingest.logs import read_log
from ingest.simulator.campaign import scenario_track, vehicle_run, wheelset_record
from ingest.simulator.fleet import FleetReport, prepare, run_fleet, simulate_campaign, transmit
from ingest.simulator.scenario import PositionErrors, Scenario
from ingest.simulator.scenario_file import read_scenario
from ingest.simulator.sensors import Channel


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(SMALL)
    return read_scenario(path)


@pytest.fixture(scope="module")
def report(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> FleetReport:
    return run_fleet(scenario, tmp_path_factory.mktemp("fleet"), workers=1)


def frames_of(scenario: Scenario, campaign: int = 0) -> tuple[FrameBatch, Decoded]:
    batch, _ = simulate_campaign(scenario, scenario_track(scenario), scenario.vehicles[0], campaign)
    return batch, decode(default_catalogue(), batch)


def test_every_frame_is_in_the_catalogue_and_in_time_order(scenario: Scenario) -> None:
    batch, decoded = frames_of(scenario)
    assert decoded.counts.decoded == len(batch)
    assert np.all(np.diff(batch.t_ns) > 0)
    identifiers = set(batch.arbitration_id.tolist())
    assert identifiers == {0x80, 0x100, 0x181, 0x182, 0x190, 0x281, 0x282, 0x290, 0x390, 0x701, 0x702, 0x710}


def test_the_bus_carries_the_vehicle_clock_exactly(scenario: Scenario) -> None:
    batch, decoded = frames_of(scenario)
    time, sync = decoded.messages[0x100], decoded.messages[0x80]
    reported = vehicle_time_ns(time.column("milliseconds"), time.column("days"))
    np.testing.assert_array_equal(
        reported, scenario.start_ns(scenario.vehicles[0], 0) + 10**9 * np.arange(len(reported))
    )
    assert np.all(np.diff(sync.column("counter")) % 240 == 1)
    assert len(sync.index) == 12 * 250 + 1
    late = batch.t_ns[time.index] - reported
    assert np.all((late > 2.5e9) & (late < 2.502e9))


def test_accelerations_on_the_bus_are_those_measured_to_half_a_count(scenario: Scenario) -> None:
    track = scenario_track(scenario)
    run = vehicle_run(scenario, track, scenario.vehicles[0], 0)
    record = wheelset_record(scenario, run, 1, wheelset_motion(scenario, track, run, 1))
    batch, _ = frames_of(scenario)
    database = cantools.database.load_file(str(files("ingest") / "dbc" / "treadwatch.dbc"))
    mine = np.flatnonzero(batch.arbitration_id == 0x182)
    for k in (0, 1, 777, len(mine) - 1):
        values = database.decode_message(0x182, batch.data[mine[k]].tobytes(), decode_choices=False)
        for place, name in enumerate(ACCELERATIONS):
            scale = database.get_message_by_frame_id(0x182).get_signal_by_name(name).scale
            assert values[name] == pytest.approx(record.values[k, place], abs=0.5001 * float(scale))


def test_speed_odometer_and_position_belong_together(scenario: Scenario) -> None:
    _, decoded = frames_of(scenario, campaign=1)
    motion, position = decoded.messages[0x190].values(), decoded.messages[0x390].values()
    ran = np.diff(position[:, 1])
    np.testing.assert_allclose(ran, 0.1 * 0.5 * (motion[1:, 0] + motion[:-1, 0]), atol=0.003)
    np.testing.assert_allclose(motion[:, 1] - 50_500e3, position[:, 1] - position[0, 1], atol=0.6)
    assert set(position[:, 0]) == {9.0}
    assert motion[:, 0].min() >= 15.0 - 0.002
    assert motion[:, 0].max() <= 22.0 + 0.002


def test_a_wheelset_behind_feels_the_same_place_later(scenario: Scenario) -> None:
    track = scenario_track(scenario)
    run = vehicle_run(scenario, track, scenario.vehicles[0], 0)
    motions = [wheelset_motion(scenario, track, run, axle) for axle in (0, 2)]
    np.testing.assert_allclose(motions[0].distance - motions[1].distance, 10.0, atol=1e-9)
    later = np.interp(motions[0].distance[:5000], motions[1].distance, motions[1].alignment)
    np.testing.assert_allclose(later, motions[0].alignment[:5000], atol=1e-6)


def test_a_dead_node_says_so_and_a_silent_one_says_nothing(scenario: Scenario) -> None:
    _, decoded = frames_of(scenario, campaign=1)
    assert decoded.messages[0x182].invalid().all()
    assert decoded.messages[0x282].column("self_test_failed").all()
    assert decoded.messages[0x082].column("error_code").tolist() == [0x5000]
    assert decoded.messages[0x181].valid().all()
    assert not decoded.messages[0x281].column("self_test_failed").any()
    assert not {0x183, 0x283, 0x703} & set(decoded.messages)


def test_sample_counters_count_what_was_sent_not_what_arrived(scenario: Scenario) -> None:
    lossy = replace(scenario, bus=replace(scenario.bus, lost_share=0.2))
    whole, thinned = frames_of(scenario)[1], frames_of(lossy)[1]
    assert len(thinned.messages[0x181].index) == pytest.approx(0.8 * len(whole.messages[0x181].index), rel=0.05)
    counters = thinned.messages[0x281].column("sample_counter")
    assert set(counters.tolist()) <= set((1 + 250 * np.arange(13)).tolist())


def test_bursts_take_everything_for_a_while(scenario: Scenario) -> None:
    bursty = replace(scenario, bus=replace(scenario.bus, burst_per_hour=3600.0, burst=0.5))
    batch, _ = frames_of(bursty)
    assert np.diff(batch.t_ns).max() >= 0.49e9


def test_clipping_is_reported_in_the_status(scenario: Scenario) -> None:
    clipping = replace(scenario, sensors=replace(scenario.sensors, mass_lateral=Channel(limit=0.05)))
    _, decoded = frames_of(clipping)
    assert decoded.messages[0x281].column("mass_lateral_clipped")[1:].any()
    assert not decoded.messages[0x281].column("lateral_clipped").any()


def test_jitter_moves_stamps_but_not_the_order(scenario: Scenario) -> None:
    shaken = replace(scenario, bus=replace(scenario.bus, jitter=200e-6))
    plain, moved = frames_of(scenario)[0], frames_of(shaken)[0]
    np.testing.assert_array_equal(plain.arbitration_id, moved.arbitration_id)
    np.testing.assert_array_equal(plain.data, moved.data)
    assert 0 < np.abs(moved.t_ns - plain.t_ns).max() <= 800_000


def test_recordings_hold_the_frames_and_are_named_by_vehicle_and_start(scenario: Scenario, report: FleetReport) -> None:
    names = [item.path.name for item in report.recordings]
    assert names == ["V-1__20240108T053000Z.blf", "V-1__20240417T053000Z.blf"]
    assert same_values(read_log(report.recordings[0].path), frames_of(scenario)[0])


@pytest.mark.slow
def test_workers_change_nothing(scenario: Scenario, report: FleetReport, tmp_path: Path) -> None:
    again = run_fleet(scenario, tmp_path, workers=2)
    folder = report.registry.parent
    ours = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert ours == sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    for path in ours:
        assert (folder / path).read_bytes() == (tmp_path / path).read_bytes(), path
    assert again.frames == report.frames


def test_another_seed_is_another_track_and_another_run(scenario: Scenario) -> None:
    other = replace(scenario, seed=6)
    assert not same_values(frames_of(scenario)[0], frames_of(other)[0])


def test_the_truth_file_follows_wear_and_the_lathe(report: FleetReport) -> None:
    truth = json.loads(report.truth.read_text())
    first, second, third = truth["wheelsets"]
    assert [item["reprofilings"] for item in first["campaigns"]] == [0, 1]
    assert first["campaigns"][0]["wear_left_mm"] == pytest.approx(0.005)
    assert first["campaigns"][1]["wear_left_mm"] == pytest.approx(0.205)
    assert second["campaigns"][1]["wear_left_mm"] == pytest.approx(0.4 + 0.2525)
    assert second["campaigns"][1]["wear_right_mm"] == pytest.approx(0.4 + 0.0505)
    assert second["campaigns"][1]["mileage_km"] == pytest.approx(130_500.0)
    assert [item["sensor_failed"] for item in second["campaigns"]] == [False, True]
    new = third["campaigns"][0]
    at_3_mm = new["equivalent_conicity"][new["amplitude_mm"].index(3.0)]
    assert at_3_mm == pytest.approx(0.195, abs=0.01)  # new P8 on new 56E1 1:20 at 1435 mm
    assert len(new["lateral_displacement_mm"]) == len(new["rolling_radius_difference_mm"])


def test_the_registry_has_a_reprofiling_where_somebody_has_entered_it(
    scenario: Scenario, report: FleetReport, tmp_path: Path
) -> None:
    vehicle = scenario.vehicles[0]
    silent = tuple(replace(plan, reprofilings_registered=False) for plan in vehicle.wheelsets)
    unregistered = replace(scenario, vehicles=(replace(vehicle, wheelsets=silent), *scenario.vehicles[1:]))
    assert [entry["wheelset"] for entry in json.loads(report.registry.read_text())["reprofilings"]] == ["A"]
    assert json.loads(prepare(unregistered, tmp_path).read_text())["reprofilings"] == []


def test_a_wheelset_that_would_derail_stops_the_run(scenario: Scenario) -> None:
    assert scenario.section.recipe is not None
    rough = replace(scenario.section, recipe=replace(scenario.section.recipe, alignment_std=0.02))
    with pytest.raises(ScenarioError, match="derails"):
        frames_of(replace(scenario, section=rough))


def test_a_rate_that_the_bus_does_not_have_is_refused(scenario: Scenario) -> None:
    with pytest.raises(ScenarioError, match="rate_hz"):
        frames_of(replace(scenario, sensors=replace(scenario.sensors, rate_hz=500)))


def test_an_unknown_vehicle_is_refused(scenario: Scenario, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no vehicle 'V-2'"):
        run_fleet(scenario, tmp_path, vehicles=["V-2"], workers=1)
    assert list(tmp_path.iterdir()) == []


def test_a_vehicle_speaks_its_frames_on_a_live_bus(scenario: Scenario) -> None:
    short = replace(scenario, sessions=replace(scenario.sessions, campaigns=1, duration=2.0))
    batch, _ = frames_of(short)
    with can.Bus("transmit", interface="virtual") as bus, can.Bus("transmit", interface="virtual") as listener:
        sent = transmit(short, bus, "V-1", speed_up=20.0)
        received = [listener.recv(0.5) for _ in range(sent)]
    assert sent == len(batch)
    for message, identifier, data, length in zip(received, batch.arbitration_id, batch.data, batch.dlc, strict=True):
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (identifier, data[:length].tobytes())


def test_reported_positions_are_off_by_one_offset_and_scale_a_run_and_nothing_else_is(scenario: Scenario) -> None:
    errors = replace(scenario, position=PositionErrors(20.0, 1e-3))
    vehicle, track = scenario.vehicles[0], scenario_track(scenario)
    near = replace(errors, sessions=replace(errors.sessions, start_within=10.0))
    runs = [vehicle_run(near, track, vehicle, campaign) for campaign in (0, 1)]
    assert abs(runs[0].distance[0] - runs[1].distance[0]) < 10.0
    drawn = []
    for run in runs:
        scale, offset = np.polyfit(run.distance - run.distance[0], run.reported - run.distance, 1)
        assert abs(offset) < 20.0
        assert abs(scale) < 1e-3
        np.testing.assert_allclose(run.reported, run.distance + offset + scale * (run.distance - run.distance[0]))
        drawn.append((offset, scale))
    assert drawn[0] != drawn[1]
    exact = vehicle_run(scenario, track, vehicle, 0)
    np.testing.assert_array_equal(exact.reported, exact.distance)
    decoded = frames_of(near)[1].messages[0x390]
    reported = decoded.column("distance")
    assert abs(1e-3 * reported[0] - runs[0].reported[0]) < 0.5


def test_a_section_that_nobody_surveyed_is_registered_without_an_alignment(scenario: Scenario, tmp_path: Path) -> None:
    path = prepare(replace(scenario, section=replace(scenario.section, surveyed=False)), tmp_path)
    (section,) = json.loads(path.read_text())["track_sections"]
    assert "alignment" not in section
    assert [file.name for file in tmp_path.iterdir()] == [path.name]

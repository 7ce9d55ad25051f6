"""When frames are on the bus: slots, arbitration at a bit rate, and what the receiver makes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from estimation.errors import ScenarioError
from ingest import catalogue as kinds
from ingest.align.clock import align_to_clock
from ingest.align.samples import node_samples
from ingest.catalogue import default_catalogue
from ingest.frames import merge
from ingest.logs import read_log, write_blf
from ingest.simulator.bus_frames import bus_timing, frame_ns, vehicle_frames
from ingest.simulator.campaign import VehicleRun
from ingest.simulator.scenario import BusPlan, Scenario
from ingest.simulator.scenario_file import read_scenario
from ingest.simulator.sensors import SensorRecord

CATALOGUE = default_catalogue()
INTERVAL_NS = CATALOGUE.sample_interval_ns
MESSAGES = [plan for plan in CATALOGUE.messages.values() if plan.kind != kinds.EMERGENCY]
SYNC, TIME, FIRST, LAST, STATUS_8, POSITION = 0x080, 0x100, 0x181, 0x188, 0x288, 0x390
SAMPLES = 2500


def bus(**changes: float) -> BusPlan:
    return replace(BusPlan(0.0, 0.0, 0.0, 0.0, 0.0), **changes)


def test_without_a_bit_rate_every_message_has_a_slot_in_three_quarters_of_a_cycle() -> None:
    timing = bus_timing(bus(), MESSAGES, INTERVAL_NS)
    delays = [int(timing[plan.arbitration_id][0]) for plan in MESSAGES]
    assert len(set(delays)) == len(MESSAGES)
    assert max(delays) <= 0.75 * INTERVAL_NS


def test_at_a_bit_rate_frames_follow_each_other_by_identifier() -> None:
    timing = bus_timing(bus(bit_rate=500e3), MESSAGES, INTERVAL_NS)
    sync, frame = frame_ns(1, 500e3), frame_ns(8, 500e3)
    assert (sync, frame) == (113_850, 229_770)
    assert timing[SYNC][7] == sync
    assert timing[FIRST][7] == sync + frame
    assert timing[LAST][7] == sync + 8 * frame


def test_the_frames_of_a_full_second_hold_the_position_back_until_after_the_next_sync() -> None:
    timing = bus_timing(bus(bit_rate=500e3), MESSAGES, INTERVAL_NS)
    delays = timing[POSITION][::25]
    assert (delays[1:] == delays[1]).all()
    assert delays[1] < INTERVAL_NS < delays[0] < 2 * INTERVAL_NS


def test_more_than_the_bus_can_carry_is_refused() -> None:
    with pytest.raises(ScenarioError, match="the bus is too slow") as raised:
        bus_timing(bus(bit_rate=250e3), MESSAGES, INTERVAL_NS)
    assert raised.value.field == "bus.bitrate_kbit_s"


def eight_nodes(folder: Path, keys: str) -> Scenario:
    head, tail = SMALL.split("[[vehicles]]")
    tail = tail[: tail.index("[[vehicles.wheelsets]]")].replace("[2.0, 4.5, 12.0]", str([2.5 * k for k in range(8)]))
    wheelsets = "".join(f'[[vehicles.wheelsets]]\nserial = "W{k}"\nwear_mm_per_100000_km = 1.0\n' for k in range(8))
    path = folder / "eight.toml"
    path.write_text(f"{head.replace('[bus]', '[bus]' + chr(10) + keys)}[[vehicles]]{tail}{wheelsets}")
    return read_scenario(path)


@pytest.mark.parametrize(
    "keys",
    [
        "bitrate_kbit_s = 500\nstamp_jitter_us = 60",
        "bitrate_kbit_s = 1000\nposition_delay_ms = 3.55\nstamp_jitter_us = 60",
        "bitrate_kbit_s = 1000\nnode_delay_us = 430\njitter_us = 200",
    ],
)
def test_every_frame_of_a_full_bus_gets_its_own_cycle_from_the_log_file(tmp_path: Path, keys: str) -> None:
    scenario = eight_nodes(tmp_path, keys)
    number = np.arange(SAMPLES, dtype=np.float64)
    values = np.zeros((SAMPLES, 4))
    values[:, 0] = number * CATALOGUE.find(kinds.ACCELERATION, 1).signal("lateral_acceleration").scale
    record = SensorRecord(0.004 * number, values, np.zeros((SAMPLES, 4), np.bool_))
    distance = 1e-3 * np.arange(4 * SAMPLES - 3) / 4.0  # a millimetre, the least count, every sample
    vehicle = scenario.vehicles[0]
    start_ns = scenario.start_ns(vehicle, 0)
    run = VehicleRun(vehicle, 0, start_ns, 0.0, np.full(len(distance), 0.25), distance, distance)
    path = tmp_path / "run.blf"
    write_blf(path, vehicle_frames(CATALOGUE, scenario, run, [record] * 8))
    result = align_to_clock(CATALOGUE, merge([read_log(path)]))
    first = -(-start_ns // INTERVAL_NS)
    for identifier in range(FIRST, LAST + 1):
        samples = result.messages[identifier]
        assert np.array_equal(samples.column("lateral_acceleration"), samples.tick - first)
        assert len(samples.tick) == SAMPLES
    position = result.messages[POSITION]
    assert np.array_equal(position.column("distance"), position.tick - first)


def test_swapped_nodes_send_each_others_values_and_a_missing_sensor_none(tmp_path: Path) -> None:
    scenario = eight_nodes(tmp_path, "nodes_swapped = true")
    scenario = replace(scenario, sensors=replace(scenario.sensors, on_mass=False))
    vehicle = scenario.vehicles[0]
    count = 500
    records = [
        SensorRecord(0.004 * np.arange(count), np.full((count, 4), float(axle)), np.zeros((count, 4), np.bool_))
        for axle in range(8)
    ]
    distance = 1e-3 * np.arange(4 * count - 3)
    run = VehicleRun(vehicle, 0, scenario.start_ns(vehicle, 0), 0.0, np.full(len(distance), 1.0), distance, distance)
    messages = align_to_clock(CATALOGUE, merge([vehicle_frames(CATALOGUE, scenario, run, records)])).messages
    sent = []
    for node in range(1, 9):
        signals = node_samples(node, CATALOGUE, messages)
        assert signals is not None
        values = signals[0].values
        assert np.isnan(values[:, 3]).all()
        sent.append(round(float(values[0, 1]), 6))
    assert sent == [1.0, 0.0, 3.0, 2.0, 5.0, 4.0, 7.0, 6.0]

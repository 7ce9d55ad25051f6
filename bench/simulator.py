"""How fast the simulator is: simulated seconds per second, per wheelset and core, with everything a user pays for."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator

import numpy as np

from bench.report import BenchRow
from bench.wheelset_motion import wheelset_motion
from ingest.simulator.campaign import scenario_track, vehicle_run, wheelset_record
from ingest.simulator.scenario_file import load_scenario

RUNS = 5
REACH = 300.0


def rows() -> Iterator[BenchRow]:
    """Yield the speed of the motion alone, and with contact geometry and sensors, on the ``mems`` scenario."""
    scenario = load_scenario("mems")
    track = scenario_track(scenario)
    vehicle = scenario.vehicles[0]
    run = vehicle_run(scenario, track, vehicle, 0)
    wheelset_record(scenario, run, 0, wheelset_motion(scenario, track, run, 0))  # compiled from here on
    motion_rates, whole_rates = [], []
    for attempt in range(RUNS):
        axle = attempt % len(vehicle.wheelsets)
        begin = time.perf_counter()
        motion = wheelset_motion(scenario, track, run, axle)
        motion_rates.append(scenario.sessions.duration / (time.perf_counter() - begin))
        record = wheelset_record(scenario, run, axle, motion)
        whole_rates.append(scenario.sessions.duration / (time.perf_counter() - begin))
        if not np.isfinite(record.values).all():
            raise ArithmeticError("the simulated signals are not finite")
    for what, rates in (("contact geometry and motion", motion_rates), ("the same and sensors", whole_rates)):
        rate = statistics.median(rates)
        yield BenchRow(
            what=f"simulated seconds per second per wheelset and core: {what}",
            measured=f"{rate:,.0f}",
            reach=f">= {REACH:.0f}",
            met=rate >= REACH,
        )

"""What a fleet says reaches the trends of its wheelsets, and only where it says another thing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from one_database import on_sqlite
from wheelset_life import DAY_NS, START_NS, SetClock, geometry_record, register, wear

from bench.put_values import put_geometry
from estimation.jobs import refresh_fleet, refresh_trends
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.refresh_fleet import FleetInputs, Place, together
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.trend.fleet import own_wear
from estimation.trend.parameters import FLEET
from estimation.values.quantities import Estimate
from estimation.values.runs import JobTrigger
from estimation.values.trend import FLEET_WEAR, FleetWear, OwnWear
from estimation.values.units import DAY_S
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE

SERIALS = ("W1", "W2", "W3", "W4")


def context(storage: Storage, day: float) -> JobContext:
    return JobContext(storage, SetClock(START_NS + round(day * DAY_NS)), "test", JobSettings())


def slope_of(storage: Storage, serial: str) -> Estimate:
    with storage.read() as unit:
        record = unit.trends.latest(serial)
    assert record is not None
    return record.trend.slope_per_1000_km


def said(storage: Storage) -> dict[str, FleetWear | None]:
    with storage.read() as unit:
        return {result.subject: result.value for result in unit.results.in_force(FLEET_WEAR)}


@on_sqlite
def test_a_wheelset_of_few_points_begins_with_what_its_fleet_says(storage: Storage) -> None:
    register(storage, *SERIALS)
    for serial in SERIALS[:3]:
        wear(storage, serial, 120, rate=0.001)
    wear(storage, "W4", 9, rate=0.001)
    run_job(refresh_trends.JOB, context(storage, 120.5), JobTrigger.CLI)
    alone = slope_of(storage, "W4")
    learnt = run_job(refresh_fleet.JOB, context(storage, 121.0), JobTrigger.CLI)
    assert learnt.counts == {"wheelsets": 4, "refreshed": 4, "unchanged": 0, "learnt": 4, "quarantined": 0}
    run_job(refresh_trends.JOB, context(storage, 121.1), JobTrigger.CLI)
    pooled = slope_of(storage, "W4")
    assert alone.std is not None
    assert pooled.std is not None
    assert pooled.value == pytest.approx(0.001, abs=0.0003)
    assert pooled.std < 0.5 * alone.std
    assert {serial: of.others for serial, of in said(storage).items() if of is not None} == dict.fromkeys(SERIALS, 3)


@on_sqlite
def test_a_fleet_is_asked_once_a_day_and_without_new_data_nothing_follows(storage: Storage) -> None:
    register(storage, *SERIALS)
    for serial in SERIALS:
        wear(storage, serial, 120, rate=0.001)
    jobs = (refresh_fleet.JOB, refresh_trends.JOB)
    for job in jobs:
        run_job(job, context(storage, 120.5), JobTrigger.CLI)
    again = [run_job(job, context(storage, 120.6), JobTrigger.CLI) for job in jobs]
    assert (again[0].counts["learnt"], again[1].counts["refreshed"]) == (0, 0)
    assert refresh_fleet.JOB.every_s == DAY_S
    with storage.write() as unit:
        put_geometry(unit, geometry_record("W1", 124, 124.0, 0.15 + 0.001 * 123))
    trends = run_job(refresh_trends.JOB, context(storage, 124.1), JobTrigger.CLI)
    assert trends.counts["refreshed"] == 1  # until the fleet is asked again


def straight(rate: float, seed: int) -> OwnWear:
    rng, x = np.random.default_rng(seed), np.linspace(0.0, 1.5e5, 12)
    return own_wear(x, 0.1 + rate * x + 0.001 * rng.standard_normal(12), np.full(12, 0.001))


def test_those_are_asked_that_are_most_alike_and_enough() -> None:
    """Two axles of two classes: with five at a place it is asked, with four the class in the fleet."""
    places: dict[str, Place] = {}
    wears: dict[str, OwnWear] = {}
    for name, axle, count, rate in (("a", 1, 5, 4e-7), ("b", 2, 4, 8e-7)):
        for number in range(count):
            places[f"{name}{number}"] = Place(3e-3, "metro", "F", axle)
            wears[f"{name}{number}"] = straight(rate, len(wears))
    places["c"], wears["c"] = Place(3e-3, "coach", "G", 1), straight(2e-6, 99)
    outcome = together(FleetInputs(wears, places))
    others = {part.subject: part.value.others for part in outcome.parts if part.value is not None}
    assert FLEET.least_others == 4
    assert AXLES_OF_A_BOGIE == 2
    assert others == {**{f"a{n}": 4 for n in range(5)}, **{f"b{n}": 8 for n in range(4)}, "c": 9}
    elsewhere = {**places, "c": replace(places["c"], amplitude=2e-3)}
    alone = {part.subject: part.value for part in together(FleetInputs(wears, elsewhere)).parts}["c"]
    assert alone is not None
    assert alone.others == 0

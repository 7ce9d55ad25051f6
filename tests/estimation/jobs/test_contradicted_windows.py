"""What is left of windows of which many contradict how their vehicle is registered says nothing either."""

from __future__ import annotations

from dataclasses import replace

import pytest
from smooth_wheelset import mems_windows, run

from estimation.jobs.steps.estimated_geometry import CONTRADICTIONS, contradiction
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, VehicleRecord, WheelsetRecord
from estimation.values.windows import Window, WindowState
from fleet_db.storage import SqlStorage

HOUR = 3600 * 10**9


def put(storage: SqlStorage, refused: list[int], left: list[int], code: ReasonCode, vehicle: str = "V1") -> None:
    """Put windows of W1 at certain hours, some of them refused, the others with tables."""
    one: Window = mems_windows(run(60, seed=1, cone=0.1, speed=20.0), seed=0)[0]
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.registry.add_wheelset(WheelsetRecord("W1", "F", "P8", 0.45, None))
        for name in ("V1", "V2"):
            unit.registry.add_vehicle(VehicleRecord(name, "F", "paper", 1, 40.0, (1.0,)))
        for hour in sorted([*refused, *left]):
            of = vehicle if hour in refused else "V1"
            window = replace(one, wheelset="W1", vehicle=of, start_ns=hour * HOUR, track_section=None)
            unit.windows.put(window, 10.0, 1)
            if hour in refused:
                unit.windows.mark("W1", hour * HOUR, WindowState.REFUSED, Reason(code, "why"))
            else:
                unit.windows.mark("W1", hour * HOUR, WindowState.ESTIMATED)


def found(storage: SqlStorage, left: list[int]) -> Reason | None:
    with storage.read() as unit:
        refused = unit.windows.refused("W1", CONTRADICTIONS)
        of = [one for one in unit.windows.list("W1") if one.start_ns // HOUR in left]
        return contradiction(refused, {one.vehicle for one in of}, of[0].start_ns, of[-1].start_ns, len(of))


@pytest.mark.parametrize("code", CONTRADICTIONS)
def test_three_of_five_are_against_the_two_that_are_left(sqlite_storage: SqlStorage, code: ReasonCode) -> None:
    put(sqlite_storage, [100, 102, 104], [101, 103], code)
    assert found(sqlite_storage, [101, 103]) == Reason(code, "why")


@pytest.mark.parametrize(("left", "against"), [(6, True), (7, False)])
def test_a_third_of_them_are_and_three_in_ten_are_not(sqlite_storage: SqlStorage, left: int, *, against: bool) -> None:
    hours = [103 + k for k in range(left)]
    put(sqlite_storage, [100, 101, 102], hours, ReasonCode.AXLE_DISTANCE)
    assert (found(sqlite_storage, hours) is not None) == against


def test_other_reasons_and_other_vehicles_are_not(sqlite_storage: SqlStorage) -> None:
    put(sqlite_storage, [100, 102, 104], [101], ReasonCode.INTERRUPTED)
    assert found(sqlite_storage, [101]) is None


def test_those_of_another_vehicle_are_not(sqlite_storage: SqlStorage) -> None:
    put(sqlite_storage, [100, 102, 104], [101], ReasonCode.AXLE_DISTANCE, vehicle="V2")
    assert found(sqlite_storage, [101]) is None


@pytest.mark.parametrize(("hour", "against"), [(126, True), (127, False)])
def test_what_was_more_than_a_day_earlier_has_been_repaired(
    sqlite_storage: SqlStorage, hour: int, *, against: bool
) -> None:
    """At 127 h one of the two is out of sight, and one of four is not enough."""
    left = [hour, hour + 1, hour + 2]
    put(sqlite_storage, [102, 103], left, ReasonCode.SENSOR_TURNED)
    assert (found(sqlite_storage, left) is not None) == against

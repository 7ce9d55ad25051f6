"""What a vehicle's class adds to a stored window, and what is said where the other node of the bogie is missing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bogie_run import SOFT, of_bogie, windows
from paper_class import PAPER_CLASS
from smooth_wheelset import GOOD

from estimation.errors import DamagedError
from estimation.jobs.steps.load_window import load_window
from estimation.motion.axle_distance import check_frame_sensors
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage
from fleet_db.stores.registry_history import RecordKey

SECOND = 1_000_000_000
BOGIE_CLASS = of_bogie(2.5e6)
MIDDLE, YAWING = 0.25, 0.5  # m/s2 and rad/s2 of the frame: 0.25 +- 1.25 * 0.5 m/s2 above the axles


def window(axle: int, **changes: object) -> Window:
    n = 500
    frame = MIDDLE + (1.0 if axle == 1 else -1.0) * 1.25 * YAWING
    plain = Window(
        wheelset=f"W{axle}",
        vehicle="V",
        axle=axle,
        start_ns=60 * SECOND,
        length_ns=2 * SECOND,
        sample_interval_s=4e-3,
        lateral_acceleration=np.full(n, 0.125),
        yaw_acceleration=np.zeros(n),
        roll_acceleration=np.zeros(n),
        mass_lateral_acceleration=frame + 0.5 * np.sin(np.arange(n)),
        speed=np.full(n, 20.0),
        distance=20.0 * 4e-3 * np.arange(n),
        valid=np.ones(n, dtype=bool),
        resolution=(0.125, 0.125, 0.125, 0.125),
        track_section=None,
        odometer_m=0.0,
        quality=GOOD,
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def register(storage: SqlStorage, windows: list[Window], axles: tuple[int, ...] = (1, 2)) -> None:
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.registry.add_vehicle(VehicleRecord("V", "F", "bogie", 2, 40.0, (1.0, 3.5)))
        for axle in axles:
            unit.registry.add_wheelset(WheelsetRecord(f"W{axle}", "F", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(f"W{axle}", "V", axle, 0, None, 0.0, 0.0))
        for one in windows:
            unit.windows.put(one, 10.0, 1)


def loaded(storage: SqlStorage, vehicle_class: VehicleClass, wheelset: str = "W1") -> Window | Reason:
    with storage.read() as unit:
        (record,) = unit.windows.list(wheelset)
        return load_window(unit, record, vehicle_class)


@pytest.mark.parametrize("wheelset", ["W1", "W2"])
def test_both_axles_of_a_bogie_have_the_yaw_of_their_frame(sqlite_storage: SqlStorage, wheelset: str) -> None:
    register(sqlite_storage, [window(1), window(2)])
    found = loaded(sqlite_storage, BOGIE_CLASS, wheelset)
    assert isinstance(found, Window)
    np.testing.assert_allclose(found.frame_yaw_acceleration, YAWING, rtol=1e-12)
    assert found.wheelset == wheelset


@pytest.mark.parametrize("gravity", [True, False])
def test_a_single_wheelset_needs_no_partner_and_has_gravity_as_its_sensors_have(
    sqlite_storage: SqlStorage, *, gravity: bool
) -> None:
    register(sqlite_storage, [window(1)])
    sensors = replace(PAPER_CLASS.sensors, measures_gravity=gravity)
    found = loaded(sqlite_storage, replace(PAPER_CLASS, sensors=sensors))
    assert isinstance(found, Window)
    assert found.frame_yaw_acceleration is None
    assert found.measures_gravity is gravity
    np.testing.assert_array_equal(found.lateral_acceleration, window(1).lateral_acceleration)


def why(storage: SqlStorage) -> str:
    found = loaded(storage, BOGIE_CLASS)
    assert isinstance(found, Reason)
    assert found.code is ReasonCode.FRAME_UNKNOWN
    assert "axle 2" in found.text
    return found.text


def test_without_a_wheelset_at_the_other_axle_the_frame_is_unknown(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, [window(1)], axles=(1,))
    assert "has no wheelset on file" in why(sqlite_storage)


def test_without_a_window_of_that_time_the_frame_is_unknown(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, [window(1), window(2, start_ns=120 * SECOND)])
    assert "has no window of this time" in why(sqlite_storage)


def test_of_a_window_that_is_sampled_otherwise_the_frame_is_not_taken(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, [window(1), window(2, sample_interval_s=2e-3)])
    assert "is sampled otherwise" in why(sqlite_storage)


def test_a_damaged_window_of_the_other_axle_is_one_of_the_file(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    register(sqlite_storage, [window(1), window(2)])
    with sqlite_storage.read() as unit:
        (record,) = unit.windows.list("W2")
    (file,) = [path for path in tmp_path.rglob("*") if path.is_file() and record.content_digest in path.name]
    file.unlink()
    with pytest.raises(DamagedError, match=file.name):
        why(sqlite_storage)


@pytest.mark.parametrize(
    ("from_s", "to_s", "there"),
    [(0, None, "wheelset W2"), (0, 60, "no wheelset"), (61, None, "no wheelset"), (0, 61, "no wheelset")],
)
def test_a_window_of_a_wheelset_that_did_not_run_there_is_not_used(
    sqlite_storage: SqlStorage, from_s: int, to_s: int | None, there: str
) -> None:
    register(sqlite_storage, [window(1)])
    serial = "W2" if there == "wheelset W2" else "W1"
    with sqlite_storage.write() as unit:
        for axle in (1, 2):
            unit.corrections.void(RecordKey(RecordKind.MOUNTING, f"W{axle}", 0), Decision("ada", "wrong", 1))
        end_ns = None if to_s is None else to_s * SECOND
        unit.registry.add_mounting(Mounting(serial, "V", 1, from_s * SECOND, end_ns, 0.0, 0.0))
    found = loaded(sqlite_storage, PAPER_CLASS)
    assert isinstance(found, Reason)
    assert found.code is ReasonCode.MOUNTING_DIFFERS
    assert f"has {there} at axle 1" in found.text


def test_a_mounting_needs_to_cover_what_was_measured_and_not_all_of_the_window(sqlite_storage: SqlStorage) -> None:
    valid = np.zeros(500, dtype=bool)
    valid[260:300] = True  # from 61.04 s on
    part = window(1, valid=valid)
    register(sqlite_storage, [part])
    with sqlite_storage.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.MOUNTING, "W1", 0), Decision("ada", "wrong", 1))
        unit.registry.add_mounting(Mounting("W1", "V", 1, 61 * SECOND, 61_500_000_000, 0.0, 0.0))
    assert isinstance(loaded(sqlite_storage, PAPER_CLASS), Window)


def test_the_window_that_the_other_wheelset_has_elsewhere_is_no_partner(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, [window(1)])
    with sqlite_storage.write() as unit:
        unit.registry.add_vehicle(VehicleRecord("X", "F", "bogie", 2, 40.0, (1.0, 3.5)))
        unit.windows.put(window(2, vehicle="X"), 10.0, 1)
    assert "has no window of this time of wheelset W2" in why(sqlite_storage)


def rear_first(one: Window) -> Window:
    """Return what a node measures whose vehicle runs with its rear end first."""
    names = ("lateral_acceleration", "roll_acceleration", "mass_lateral_acceleration")
    return replace(one, **{name: -getattr(one, name) for name in names})


def measured(axle: int, *, back: bool) -> Window:
    """Return a window of a bogie that runs forward, or back with its axle 2 first."""
    (one, *_) = windows(SOFT, axle if not back else 3 - axle)
    placed = replace(one, wheelset=f"W{axle}", vehicle="V", axle=axle, start_ns=60 * SECOND, track_section=None)
    return rear_first(placed) if back else placed


@pytest.mark.parametrize("back", [False, True])
def test_a_bogie_is_an_ordinary_one_whichever_end_goes_first(sqlite_storage: SqlStorage, *, back: bool) -> None:
    node = measured(1, back=back)
    register(sqlite_storage, [node, measured(2, back=back)])
    found = loaded(sqlite_storage, BOGIE_CLASS)
    assert isinstance(found, Window)
    assert found.backwards is back
    np.testing.assert_allclose(found.distance, node.distance + (2.0 * 1.0 if back else 0.0))
    np.testing.assert_array_equal(found.yaw_acceleration, (-1.0 if back else 1.0) * node.yaw_acceleration)


@pytest.mark.parametrize(("other_back", "backwards"), [(True, True), (False, False)])
def test_a_single_node_that_alone_says_backwards_is_the_wrong_way_round(
    sqlite_storage: SqlStorage, *, other_back: bool, backwards: bool
) -> None:
    register(sqlite_storage, [measured(1, back=True), measured(2, back=other_back)])
    found = loaded(sqlite_storage, PAPER_CLASS)
    assert isinstance(found, Window)
    assert found.backwards is backwards


def test_of_a_frame_sensor_that_measures_nothing_the_frame_is_unknown(sqlite_storage: SqlStorage) -> None:
    node = measured(2, back=False)
    for share, refused in ((0.15, True), (0.35, False)):
        quiet = replace(node, mass_lateral_acceleration=share * node.mass_lateral_acceleration)
        assert (check_frame_sensors(measured(1, back=False), quiet) is not None) is refused
    register(
        sqlite_storage, [measured(1, back=False), replace(node, mass_lateral_acceleration=np.zeros(len(node.valid)))]
    )
    found = loaded(sqlite_storage, BOGIE_CLASS)
    assert isinstance(found, Reason)
    assert found.code is ReasonCode.FRAME_UNKNOWN
    assert "check the sensor of axle 2" in found.text

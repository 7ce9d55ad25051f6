"""What is stored of the suspension of vehicles and of the hunting of windows, on both databases."""

from __future__ import annotations

from dataclasses import replace

import stored_values as make
from same_values import same_values

from estimation.values.trend import SuspensionFinding
from estimation.values.windows import NO_BLOWS, NOT_HUNTING, Hunting, TurnBlows
from fleet_db.storage import SqlStorage
from fleet_db.telemetry import pack_window, unpack_window, window_digest

FINDING = SuspensionFinding("V-1", "S-7", 10, 20, 0.8125, 0.03125, 0.336, "3", 99)


def test_findings_come_back_in_order_of_time(fleet: SqlStorage) -> None:
    later, other = replace(FINDING, from_ns=20, to_ns=30), replace(FINDING, vehicle="V-2")
    with fleet.write() as unit:
        for one in (later, other, FINDING):
            unit.suspensions.put(one)
    with fleet.read() as unit:
        assert unit.suspensions.list("V-1") == [FINDING, later]
        assert unit.suspensions.list() == [FINDING, later, other]
        assert unit.suspensions.newest(2) == [FINDING, later, other]
        assert unit.suspensions.newest(1) == [later, other]


def test_an_epoch_that_is_looked_at_again_replaces_its_finding(fleet: SqlStorage) -> None:
    again = replace(FINDING, ratio=0.75, recorded_ns=120)
    for one in (FINDING, again):
        with fleet.write() as unit:
            unit.suspensions.put(one)
    with fleet.read() as unit:
        assert unit.suspensions.list("V-1") == [again]


def test_hunting_is_stored_with_its_window(fleet: SqlStorage) -> None:
    calm = make.window()
    hunting = replace(calm, quality=replace(calm.quality, hunting=Hunting(0.75, 4.25, 0.00625)))
    assert same_values(unpack_window(pack_window(hunting), where="here"), hunting)
    assert same_values(unpack_window(pack_window(calm), where="here"), calm)
    assert window_digest(hunting) != window_digest(calm)
    for window in (calm, hunting):
        with fleet.write() as unit:
            unit.windows.put(window, 10.0, 50)
        with fleet.read() as unit:
            record = unit.windows.get("WS-1", window.start_ns)
        assert record is not None
        assert record.quality.hunting == window.quality.hunting
    assert calm.quality.hunting == NOT_HUNTING


def test_blows_are_stored_with_their_window(fleet: SqlStorage) -> None:
    calm = make.window(0)
    struck = replace(make.window(1), quality=replace(calm.quality, blows=TurnBlows(0.8, 21.5, 2.8125, -1)))
    assert same_values(unpack_window(pack_window(struck), where="here"), struck)
    assert window_digest(struck) != window_digest(make.window(1))
    for window in (calm, struck):
        with fleet.write() as unit:
            unit.windows.put(window, 10.0, 50)
            record = unit.windows.get(window.wheelset, window.start_ns)
        assert record is not None
        assert record.quality.blows == window.quality.blows
    assert calm.quality.blows == NO_BLOWS


def test_a_vehicle_knows_when_one_of_its_wheelsets_hunts(fleet: SqlStorage) -> None:
    windows = [make.window(index) for index in range(4)]
    shares = (0.5, 0.49, 1.0, 0.0)
    with fleet.write() as unit:
        for window, share in zip(windows, shares, strict=True):
            quality = replace(window.quality, hunting=Hunting(share, 4.0, 0.005) if share else NOT_HUNTING)
            unit.windows.put(replace(window, quality=quality), 10.0, 50)
        vehicle, first = windows[0].vehicle, windows[0].start_ns
        assert unit.windows.hunted(vehicle, first) == {windows[0].start_ns, windows[2].start_ns}
        assert unit.windows.hunted(vehicle, first + 1) == {windows[2].start_ns}
        assert unit.windows.hunted("another", first) == frozenset()

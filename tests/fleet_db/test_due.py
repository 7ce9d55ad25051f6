"""Due windows: listed with the change, removed by the stage that has seen just that."""

from __future__ import annotations

import sqlalchemy
import stored_values as make

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Due, StageInputs, SubjectKind
from estimation.values.windows import DueStage, WindowState
from fleet_db.due import WINDOWS, is_due, list_due
from fleet_db.storage import SqlStorage

SUMS = DueStage.SUMS


def listed(storage: SqlStorage, *indices: int) -> None:
    starts = [make.window(index).start_ns for index in indices]
    with storage.write() as unit:
        list_due(unit.connection, SUMS, WINDOWS.c.start_ns.in_(starts))


def due(storage: SqlStorage) -> list[int]:
    """Return the versions of the due windows, oldest first."""
    with storage.read() as unit:
        return list(unit.due.of_wheelset(SUMS, "WS-1").values())


def test_a_window_stays_due_until_its_newest_version_has_been_seen(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        for index in range(3):
            unit.windows.put(make.window(index), 10.0 + index, 50)
    listed(fleet, 0, 2)
    with fleet.read() as unit:
        seen = unit.due.of_wheelset(SUMS, "WS-1")
    assert list(seen) == [make.window(index).start_ns for index in (0, 2)]
    listed(fleet, 1, 2)
    assert due(fleet) == [1, 1, 2]
    with fleet.write() as unit:
        unit.due.remove_seen(SUMS, {("WS-1", start): version for start, version in seen.items()})
    assert due(fleet) == [1, 2]
    with fleet.read() as unit:
        statement = sqlalchemy.select(WINDOWS.c.start_ns).where(is_due(SUMS, WINDOWS)).order_by(WINDOWS.c.start_ns)
        starts = list(unit.connection.scalars(statement))
    assert starts == [make.window(index).start_ns for index in (1, 2)]


def test_wheelsets_are_due_by_their_windows(fleet: SqlStorage) -> None:
    inputs = StageInputs(DueStage.MILEAGES, SubjectKind.WHEELSET, (), "")
    with fleet.write() as unit:
        for index in range(2):
            unit.windows.put(make.window(index), 10.0 + index, 50)
        unit.windows.put(make.window(0), 11.0, 60)
    with fleet.read() as unit:
        assert unit.marks.due(inputs, 0) == {"WS-1": Due(3)}
        assert unit.marks.due(inputs, 0, ["WS-2"]) == {}
        seen = unit.plausibility.due(["WS-1"])[0]
    with fleet.write() as unit:
        unit.due.remove_seen(DueStage.MILEAGES, seen)
        assert unit.marks.due(inputs, 0) == {}


def test_what_waits_is_listed_and_what_failed_keeps_its_version(fleet: SqlStorage) -> None:
    failed = Reason(ReasonCode.PROCESSING_FAILED, "failed")
    with fleet.write() as unit:
        for index in range(3):
            unit.windows.put(make.window(index), 10.0 + index, 50)
        keys = [(one.wheelset, one.start_ns) for one in unit.windows.list("WS-1")]
        unit.windows.mark(*keys[0], WindowState.REFUSED, failed)
        unit.windows.mark(*keys[1], WindowState.ESTIMATED)
        unit.due.remove_seen(DueStage.TABLES, {keys[1]: 1})
        assert unit.windows.look_again(keys[:2]) == keys[:2]
        assert unit.due.of_wheelset(DueStage.TABLES, "WS-1") == {start_ns: 1 for _, start_ns in keys}
        unit.windows.mark(*keys[0], WindowState.REFUSED, failed)
        unit.windows.mark(*keys[1], WindowState.ESTIMATED)
        unit.marks.list_again(StageInputs(DueStage.TABLES, SubjectKind.WINDOW, (), "other settings"))
        states = [one.state for one in unit.windows.list("WS-1")]
        assert states == [WindowState.PENDING, WindowState.ESTIMATED, WindowState.PENDING]
        assert list(unit.due.of_wheelset(DueStage.TABLES, "WS-1").values()) == [2, 1, 2]


def test_a_window_that_is_removed_stays_due(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.windows.put(make.window(0), 10.0, 50)
    listed(fleet, 0)
    with fleet.write() as unit:
        unit.assembled.remove(unit.windows.list("WS-1"))
    assert due(fleet) == [1]

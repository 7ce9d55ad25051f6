"""Windows of a span, looked up and stored together: as one by one, by index, and only where they are others."""

from __future__ import annotations

from dataclasses import replace

import sqlalchemy
import stored_values as make

from bench.put_values import put_table
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import PassedOver, Window, WindowPosition, WindowState
from fleet_db.session import sqlite_file
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.assembled import AssembledWindow, StoredWindow
from fleet_db.telemetry import window_digest

END = make.START + 100 * make.LENGTH


def assembled(window: Window, mileage_km: float = 10.0, excess_m: float = 0.0, off_m: float = 0.0) -> AssembledWindow:
    return AssembledWindow(window, window_digest(window), mileage_km, excess_m, off_m)


def stored(unit: SqlUnitOfWork, vehicle: str = "V-1") -> list[StoredWindow]:
    return list(unit.assembled.in_span(vehicle, (), make.START, END))


def rows(unit: SqlUnitOfWork) -> list[dict[str, object]]:
    statement = sqlalchemy.text("SELECT * FROM windows ORDER BY wheelset, start_ns")
    return [dict(row) for row in unit.connection.execute(statement).mappings()]


def test_windows_that_are_added_together_are_as_those_that_are_put_one_by_one(fleet: SqlStorage) -> None:
    windows = [make.window(index) for index in range(3)]
    with fleet.write() as unit:
        for number, window in enumerate(windows):
            unit.windows.put(window, 10.0 + number, 50)
            unit.plausibility.note("WS-1", window.start_ns, 0.5 * number, 70.0 * number)
        one_by_one = rows(unit)
        unit.assembled.remove(unit.windows.list("WS-1"))
        assert rows(unit) == []
        together = [assembled(w, 10.0 + n, 0.5 * n, 70.0 * n) for n, w in enumerate(windows)]
        assert unit.assembled.add(together, 50)
        assert unit.assembled.add([], 50)
        assert rows(unit) == one_by_one
        assert unit.windows.load("WS-1", windows[1].start_ns).start_ns == windows[1].start_ns


def test_what_another_transaction_has_stored_meanwhile_stays(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.windows.put(make.window(1), 11.0, 50)
        there = rows(unit)
        assert not unit.assembled.add([assembled(make.window(n, seed=n), 12.0) for n in range(3)], 60)
        assert [row for row in rows(unit) if row["start_ns"] == make.window(1).start_ns] == there
        assert len(rows(unit)) == 3


def test_windows_that_are_replaced_together_are_as_those_that_are_put_one_by_one(fleet: SqlStorage) -> None:
    def first(unit: SqlUnitOfWork) -> None:
        for index in range(2):
            unit.windows.put(make.window(index), 10.0, 50)
            unit.windows.mark("WS-1", make.window(index).start_ns, WindowState.REFUSED, Reason(ReasonCode.CLIPPED, "x"))
            unit.windows.pass_over("WS-1", make.window(index).start_ns, PassedOver.SUPERSEDED)

    others = [make.window(index, seed=9) for index in range(2)]
    with fleet.write() as unit:
        first(unit)
        for other in others:
            unit.windows.put(other, 12.0, 60)
            unit.plausibility.note("WS-1", other.start_ns, 3.0, 0.0)
        one_by_one = rows(unit)
        unit.assembled.remove(unit.windows.list("WS-1"))
        first(unit)
        assert all(one.untouched for one in stored(unit))
        unit.assembled.replace([assembled(other, 12.0, 3.0) for other in others], 60)
        unit.assembled.replace([], 60)
        assert rows(unit) == one_by_one


def test_a_window_is_as_stored_only_with_its_file_mileage_and_doubts(fleet: SqlStorage) -> None:
    window = make.window()
    now = assembled(window, 10.0, 1.0, 60.0)
    with fleet.write() as unit:
        unit.assembled.add([now], 50)
        (before,) = stored(unit)
        size = unit.assembled.files.path(now.digest).stat().st_size
        assert (before.sample_bytes, before.samples_purged) == (size, False)
        assert unit.assembled.is_as_stored(before, now)
        assert not unit.assembled.is_as_stored(before, replace(now, mileage_km=10.5))
        assert not unit.assembled.is_as_stored(before, replace(now, odometer_excess_m=0.0))
        assert not unit.assembled.is_as_stored(before, replace(now, off_line_m=0.0))
        assert not unit.assembled.is_as_stored(before, assembled(make.window(seed=1), 10.0, 1.0, 60.0))
        unit.assembled.files.path(now.digest).unlink()
        assert not unit.assembled.is_as_stored(before, now)
        assert unit.assembled.is_as_stored(replace(before, samples_purged=True), now)


def test_windows_with_a_bin_table_and_those_of_wheelsets_elsewhere_are_known(fleet: SqlStorage) -> None:
    window = make.window()
    with fleet.write() as unit:
        unit.assembled.add([assembled(window)], 50)
        put_table(unit, "WS-1", window.start_ns, make.bin_table(0), 3, window_digest(window))
        assert [one.untouched for one in stored(unit)] == [False]
        assert stored(unit, "V-2") == []
        assert len(unit.assembled.in_span("V-2", {"WS-1", "WS-2"}, make.START, END)) == 1
        assert len(unit.assembled.in_span("V-1", {"WS-1"}, make.START + 1, END)) == 0
        assert len(unit.assembled.in_span("V-1", {"WS-1"}, make.START - 5, make.START)) == 0


def test_positions_of_some_windows_are_forgotten(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.assembled.add([assembled(make.window(index)) for index in range(3)], 50)
        for record in unit.windows.list("WS-1"):
            unit.tracks.put_positions([WindowPosition("WS-1", record.start_ns, record.content_digest, 1)])
        unit.windows.look_again([("WS-1", make.window(0).start_ns), ("WS-1", make.window(2).start_ns)])
        unit.windows.look_again([])
        left = [unit.tracks.position("WS-1", make.window(index).start_ns) for index in range(3)]
        assert [one is not None for one in left] == [False, True, False]


def test_what_is_looked_up_does_not_grow_with_the_windows_there_are(fleet: SqlStorage) -> None:
    asked: list[tuple[str, object]] = []

    @sqlalchemy.event.listens_for(fleet.engine, "before_cursor_execute")
    def keep(_c: object, _cursor: object, statement: str, parameters: object, *_: object) -> None:
        asked.append((statement, parameters))

    on_file = sqlite_file(fleet.engine) is not None
    with fleet.write() as unit:
        if not on_file:  # a small table is read whole, and rightly so
            unit.assembled.add([assembled(make.window())], 50)
            columns = [name for name in rows(unit)[0] if name != "start_ns"]
            more = f"INSERT INTO windows (start_ns, {', '.join(columns)}) SELECT start_ns + 60000000000 * n, "
            more += f"{', '.join(columns)} FROM windows, generate_series(1, 20000) AS n"
            unit.connection.execute(sqlalchemy.text(more))
            unit.connection.execute(sqlalchemy.text("ANALYZE windows"))
        unit.assembled.in_span("V-1", {"WS-2"}, make.START, make.START + 1)
        statement, parameters = asked[-1]
        explain = "EXPLAIN QUERY PLAN " if on_file else "EXPLAIN "
        plan = unit.connection.exec_driver_sql(explain + statement, parameters)  # type: ignore[arg-type]
        text = "\n".join(str(row) for row in plan)
    assert "ix_windows_vehicle_start_ns" in text, text
    assert ("sqlite_autoindex_windows_1" if on_file else "pk_windows") in text, text

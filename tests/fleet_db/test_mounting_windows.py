"""Windows of a mounting that was voided, or that ends at another time, are estimated again when they are right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import stored_values as make

from estimation.values.windows import WindowState
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey

WAITS, DONE = WindowState.PENDING, WindowState.ESTIMATED
DECISION = Decision("ada", "a mistake", 77)


def void(unit: SqlUnitOfWork) -> None:
    unit.corrections.void(RecordKey(RecordKind.MOUNTING, "WS-1", make.MOUNTING.from_ns), DECISION)


def end(unit: SqlUnitOfWork) -> None:
    unit.registry.add_mounting(replace(make.MOUNTING, to_ns=make.START + make.LENGTH))


def end_within(unit: SqlUnitOfWork) -> None:
    unit.registry.add_mounting(replace(make.MOUNTING, to_ns=make.START + make.LENGTH // 2))


def enter_again(unit: SqlUnitOfWork) -> None:
    unit.registry.add_mounting(make.MOUNTING)


@pytest.mark.parametrize(
    ("change", "expected"),
    [(enter_again, [DONE, DONE]), (end, [DONE, WAITS]), (end_within, [WAITS, WAITS]), (void, [WAITS, WAITS])],
)
def test_windows_wait_whose_mounting_is_another_now_and_no_others(
    fleet: SqlStorage, change: Callable[[SqlUnitOfWork], None], expected: list[WindowState]
) -> None:
    with fleet.write() as unit:
        for number in range(2):
            window = make.window(number)
            unit.windows.put(window, 1.0, 1)
            unit.windows.mark(window.wheelset, window.start_ns, DONE)
        change(unit)
    with fleet.read() as unit:
        assert [record.state for record in unit.windows.list("WS-1")] == expected

"""The state at rest is a function of the windows, the registry and the settings: not of when what came."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from alignment_job import DAY_NS, counts, register
from section_runs import windows

from bench.chaos.final_state import OF_HISTORY, final_state
from estimation.values.windows import Window
from fleet_db.storage import SqlStorage

JOBS = ("refresh_alignment", "estimate_windows", "refresh_geometry", "refresh_trends", "evaluate_alerts")
OFFSETS = (0.0, 6.0, -5.0, 9.0, 3.0, -8.0)
RUNS = ((0, (0, 1, 2, 3, 4, 5)), (2, (1, 4)), (31, (0, 3)))  # day, numbers


def arriving() -> list[Window]:
    """Return the windows of all runs in order of time, at what their odometers say."""
    found = [
        replace(window, start_ns=window.start_ns + day * DAY_NS, distance=window.distance + OFFSETS[number] + day % 5)
        for day, numbers in RUNS
        for number in numbers
        for window in windows(number)
    ]
    return sorted(found, key=lambda window: (window.start_ns, window.wheelset))


def store(storage: SqlStorage, found: Sequence[Window]) -> None:
    with storage.write() as unit:
        for window in found:
            unit.windows.put(window, 10.0 + window.start_ns / DAY_NS, 1)


def played(storage: SqlStorage, pieces: Sequence[Sequence[Window]]) -> dict[str, str]:
    """Return the state after the pieces have come one after the other, with the jobs run after each."""
    register(storage)
    for piece in (*pieces, ()):
        store(storage, piece)
        for name in JOBS:
            counts(storage, name)
    return at_rest(storage)


def at_rest(storage: SqlStorage) -> dict[str, str]:
    """Return the state but for what may differ by history."""
    assert counts(storage, "refresh_alignment")["unchanged"] == 1
    return {name: digest for name, digest in final_state(storage).items() if name not in OF_HISTORY}


@pytest.mark.slow
def test_windows_in_pieces_late_and_out_of_order_give_the_state_of_all_at_once(
    new_sqlite_storage: Callable[[], SqlStorage],
) -> None:
    ordered = arriving()
    expected = played(new_sqlite_storage(), [ordered])
    late = [ordered[0], ordered[5], ordered[13]]  # a month after the others
    rest = [window for window in ordered if not any(window is one for one in late)]
    random.Random(3).shuffle(rest)  # noqa: S311 - an order
    assert played(new_sqlite_storage(), [rest[:3], rest[3:], late]) == expected


@pytest.mark.slow
def test_what_is_taken_away_again_leaves_the_state_without_it(new_sqlite_storage: Callable[[], SqlStorage]) -> None:
    """Positions that a short piece has fixed are found again; superseded versions stay on record."""
    ordered = arriving()
    expected = played(new_sqlite_storage(), [ordered[:12]])
    storage = new_sqlite_storage()
    played(storage, [ordered[3:15], ordered[:3]])
    with storage.write() as unit:
        for window in ordered[12:15]:
            record = unit.windows.get(window.wheelset, window.start_ns)
            assert record is not None
            unit.assembled.remove([record])
    for _ in range(2):
        for name in JOBS:
            counts(storage, name)
    assert at_rest(storage) == expected
    with storage.read() as unit:
        versions = unit.tracks.versions("S1", None, 100)
        in_force = unit.tracks.in_force("S1")
    assert in_force is not None
    assert [one.version for one in versions if one.superseded_ns is None] == [in_force.version]
    assert len(versions) > 1


def test_data_that_come_in_order_cost_each_epoch_once(new_sqlite_storage: Callable[[], SqlStorage]) -> None:
    storage, ordered = new_sqlite_storage(), arriving()
    register(storage)
    done = []
    for piece in (ordered[:12], ordered[12:16], ordered[16:]):
        store(storage, piece)
        done.append(counts(storage, "refresh_alignment"))
    assert [one["epochs"] for one in done] == [1, 1, 1]
    assert [one["windows"] for one in done] == [12, 4, 8]
    assert counts(storage, "refresh_alignment")["unchanged"] == 1

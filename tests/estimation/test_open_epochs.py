"""What a journey costs those that came before it: nothing where the alignment is known, and little before that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from alignment_job import DAY_NS, counts, register
from section_runs import windows
from test_any_order import OFFSETS, at_rest

from bench.standing_clock import StandingClock
from estimation.jobs import refresh_alignment
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.runs import JobTrigger
from estimation.values.windows import Window, WindowKey
from fleet_db.storage import SqlStorage

NOW_NS, SECOND_NS, QUIET_S = 10**15, 10**9, 600.0


def journey(number: int, day: int) -> list[Window]:
    """Return the windows of a run, at what its odometer says."""
    return [
        replace(one, start_ns=one.start_ns + day * DAY_NS, distance=one.distance + OFFSETS[number] + day % 5)
        for one in windows(number)
    ]


def put(storage: Storage, found: Sequence[Window], recorded_ns: int = 1) -> None:
    with storage.write() as unit:
        for window in found:
            unit.windows.put(window, 10.0 + window.start_ns / DAY_NS, recorded_ns)


def positions(storage: Storage, found: Sequence[Window]) -> dict[WindowKey, object]:
    with storage.read() as unit:
        stored = {(one.wheelset, one.start_ns): unit.tracks.position(one.wheelset, one.start_ns) for one in found}
    return {
        key: None if one is None else (one.offset_m, one.scale, one.middle_m, one.reason) for key, one in stored.items()
    }


@pytest.fixture
def known(new_sqlite_storage: Callable[[], SqlStorage]) -> SqlStorage:
    """Return a store whose section has been passed by all wheelsets twice."""
    storage = new_sqlite_storage()
    register(storage)
    for day in (0, 2):
        put(storage, [window for number in range(6) for window in journey(number, day)])
    for name in ("refresh_alignment", "estimate_windows"):
        counts(storage, name)
    return storage


def test_a_journey_on_known_track_moves_none_of_those_before_it(known: SqlStorage) -> None:
    first = [window for number in (0, 1, 2) for window in journey(number, 8)]
    put(known, first)
    counts(known, "refresh_alignment")
    assert counts(known, "estimate_windows")["estimated"] == len(first)
    before = positions(known, first)
    second = journey(4, 8)
    put(known, second)
    assert counts(known, "refresh_alignment")["epochs"] == 1
    assert positions(known, first) == before
    assert counts(known, "estimate_windows")["estimated"] == len(second)


def test_journeys_are_placed_on_known_track_where_they_were(known: SqlStorage) -> None:
    found = [window for number in (0, 1, 2, 4) for window in journey(number, 8)]
    put(known, found)
    counts(known, "refresh_alignment")
    with known.read() as unit:
        fleet = []
        for one in found:
            position = unit.tracks.position(one.wheelset, one.start_ns)
            assert position is not None
            assert position.reason is None
            fleet.append(position.offset_m + OFFSETS[int(one.wheelset[1:])])
    assert max(fleet) - min(fleet) < 0.3  # m: the mean of all is not observable


def _scheduled(storage: Storage, now_ns: int) -> int:
    """Return how many epochs a scheduled run has computed."""
    context = JobContext(storage, StandingClock(now_ns), "test", JobSettings(), quiet_s=QUIET_S)
    run = run_job(refresh_alignment.JOB, context, JobTrigger.SCHEDULE)
    assert run.error is None
    return run.counts["epochs"]


def test_an_epoch_that_still_grows_is_computed_when_it_has_grown_enough_or_nothing_comes(
    new_sqlite_storage: Callable[[], SqlStorage],
) -> None:
    storage = new_sqlite_storage()
    register(storage)
    computed = []
    for number in range(5):
        now_ns = NOW_NS + number * SECOND_NS
        put(storage, journey(number, 0), now_ns)
        computed.append(_scheduled(storage, now_ns + SECOND_NS))
    assert computed == [1, 0, 0, 1, 0]  # with 1 and 4 journeys
    last_ns = NOW_NS + 4 * SECOND_NS
    assert _scheduled(storage, last_ns + round(QUIET_S - 1.0) * SECOND_NS) == 0
    assert _scheduled(storage, last_ns + round(QUIET_S + 1.0) * SECOND_NS) == 1
    whole = new_sqlite_storage()
    register(whole)
    put(whole, [window for number in range(5) for window in journey(number, 0)])
    for one in (storage, whole):
        for name in ("refresh_alignment", "estimate_windows"):
            counts(one, name)
    assert at_rest(storage) == at_rest(whole)


def test_what_is_recorded_in_the_future_does_not_wait_for_it(new_sqlite_storage: Callable[[], SqlStorage]) -> None:
    storage = new_sqlite_storage()
    register(storage)
    put(storage, [*journey(0, 0), *journey(1, 0)], NOW_NS)
    assert _scheduled(storage, NOW_NS) == 1
    put(storage, journey(2, 0), NOW_NS + DAY_NS)  # by a clock that was ahead
    assert _scheduled(storage, NOW_NS + round(QUIET_S + 1.0) * SECOND_NS) == 1

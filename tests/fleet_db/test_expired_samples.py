"""Samples go where a window is estimated or refused for good; nothing takes the window for lost, or waits for it."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import pytest
import stored_values as make
from stored_raw import raw_of

from bench.put_values import put_table
from estimation.errors import DamagedError, ParameterError, PurgedError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import EpochMember, FoldState, TrackEpoch
from estimation.values.units import DAY_NS
from estimation.values.windows import DueStage, PassedOver, WindowPosition, WindowRecord, WindowState
from fleet_db.keeping.checks import check_deep
from fleet_db.keeping.kept_files import kept_files, orphaned_samples
from fleet_db.keeping.purge import WAITING, Purged, purge
from fleet_db.keeping.retention import Kept, Retention
from fleet_db.storage import SqlStorage

NOTHING: dict[str, Any] = dict.fromkeys((kind.value for kind in Kept), None)
AFTER = make.START + 2 * DAY_NS
SECTION = "S-7"


def purged(storage: SqlStorage, now_ns: int = AFTER) -> Purged:
    (done,) = purge(storage, raw_of(storage), Retention(**(NOTHING | {"window_samples": 1.0})), now_ns, lambda: None)
    return done


def put(storage: SqlStorage, index: int, reason: ReasonCode | None = None, *, pending: bool = False) -> WindowRecord:
    """Store a window: estimated and rolled up, refused for a reason, or pending."""
    with storage.write() as unit:
        window = make.window(index)
        unit.windows.put(window, 100.0 + index, make.START)
        record = unit.windows.get("WS-1", window.start_ns)
        assert record is not None
        if reason is not None:
            unit.windows.mark("WS-1", window.start_ns, WindowState.REFUSED, Reason(reason, "why"))
        elif not pending:
            put_table(unit, "WS-1", window.start_ns, make.bin_table(index), None, record.content_digest)
            unit.windows.mark("WS-1", window.start_ns, WindowState.ESTIMATED)
            due = unit.due.of_wheelset(DueStage.SUMS, "WS-1")
            unit.due.remove_seen(DueStage.SUMS, {("WS-1", start): version for start, version in due.items()})
        after = unit.windows.get("WS-1", window.start_ns)
    assert after is not None
    return after


def aged(storage: SqlStorage) -> None:
    for path in storage.data_dir.rglob("*.window"):
        os.utime(path, (1e9, 1e9))


def states(storage: SqlStorage) -> list[WindowState]:
    with storage.read() as unit:
        return [record.state for record in unit.windows.list("WS-1")]


def test_samples_of_what_is_estimated_or_refused_for_good_go(fleet: SqlStorage) -> None:
    put(fleet, 0)
    put(fleet, 1, ReasonCode.NOT_MOVING)
    put(fleet, 2, pending=True)
    for index, code in enumerate(WAITING, start=3):
        put(fleet, index, code)
    aged(fleet)
    files = len(list(fleet.data_dir.rglob("*.window")))
    assert purged(fleet, make.START + DAY_NS).items == 0  # the first is a day old, and not older
    done = purged(fleet)
    assert (done.items, done.item_bytes > 0) == (2, True)
    assert purged(fleet).items == 0
    assert len(list(fleet.data_dir.rglob("*.window"))) == files - 2
    with fleet.read() as unit:
        with pytest.raises(PurgedError):
            unit.windows.load("WS-1", make.START)
        assert len(list(kept_files(unit.connection))) == files - 2
    assert not check_deep(fleet, raw_of(fleet), lambda *_: None).damaged
    assert orphaned_samples(fleet) == []


def test_a_table_that_is_not_summed_keeps_the_samples(fleet: SqlStorage) -> None:
    record = put(fleet, 0)
    with fleet.write() as unit:
        put_table(unit, "WS-1", record.start_ns, make.bin_table(7), None, record.content_digest)
    assert purged(fleet).items == 0


@pytest.mark.parametrize(("horizon_ns", "waits", "items"), [(0, False, 1), (DAY_NS + 1, False, 0), (0, True, 0)])
def test_an_epoch_that_may_be_computed_again_keeps_them(
    fleet: SqlStorage, horizon_ns: int, *, waits: bool, items: int
) -> None:
    record = put(fleet, 0)
    epoch = TrackEpoch(
        SECTION, 1, "", "d", make.START + horizon_ns, 1, waits, FoldState(None, None, None), None, 0, make.START
    )
    with fleet.write() as unit:
        unit.epochs.put(epoch, [EpochMember(record, "context", "assumed")])
    assert purged(fleet).items == items
    if waits:  # a later one has identified something
        with fleet.write() as unit:
            unit.epochs.put(replace(epoch, number=2, windows=0, waits=False), [])
        assert purged(fleet).items == 1


def test_a_window_without_samples_is_no_window_of_an_epoch_that_is_computed_again(fleet: SqlStorage) -> None:
    put(fleet, 0)
    put(fleet, 5)
    assert purged(fleet, make.START + DAY_NS + 1).items == 1
    with fleet.read() as unit:
        later = make.window(5).start_ns
        assert [one.start_ns for one in unit.epochs.remaining(SECTION, 1, 9)] == [later]
        assert unit.epochs.purged_until(SECTION) == make.START
    with fleet.write() as unit:
        (record,) = unit.windows.list("WS-1", later)
        epoch = TrackEpoch(
            SECTION,
            1,
            "",
            "d",
            later,
            1,
            waits=False,
            after=FoldState(None, None, None),
            estimated_on=None,
            report=0,
            recorded_ns=make.START,
        )
        unit.epochs.put(epoch, [EpochMember(record, "context", "assumed")])
    assert purged(fleet).items == 1
    put(fleet, 3)  # so late that later ones have no samples
    with fleet.read() as unit:
        assert unit.epochs.purged_until(SECTION) == later
        assert [one.start_ns for one in unit.epochs.remaining(SECTION, 2, 9)] == [make.window(3).start_ns]


def test_nothing_queues_it_again(fleet: SqlStorage) -> None:
    put(fleet, 0)
    put(fleet, 1, ReasonCode.IN_CURVES)
    purged(fleet)
    with fleet.write() as unit:
        unit.tracks.put_positions([WindowPosition("WS-1", make.START, "d" * 64, 1)])
        assert not unit.windows.mark("WS-1", make.START, WindowState.PENDING)
        unit.windows.estimate_again(SECTION)
        assert unit.windows.counts()["pending"] == 0
        assert unit.windows.refused_on(SECTION, [ReasonCode.IN_CURVES]) == []
        assert unit.windows.look_again([("WS-1", make.START)]) == []
        assert unit.plausibility.judge({("WS-1", make.START): Reason(ReasonCode.ODOMETER_IMPLAUSIBLE, "no")}) == 0
        assert unit.windows.passed_over("WS-1") == [(make.START, PassedOver.SUPERSEDED)]
        (record,) = unit.windows.list("WS-1", None, make.START + 1)
        assert unit.assembled.intact(record, verify=True)
        unit.windows.pass_over("WS-1", make.START, PassedOver.RECORD_CHANGED)
        unit.windows.pass_over("WS-1", make.START, PassedOver.CLASS_CHANGED)
        assert unit.windows.passed_over("WS-1") == [(make.START, PassedOver.RECORD_CHANGED)]
        assert unit.tracks.position("WS-1", make.START) is not None
    assert states(fleet) == [WindowState.ESTIMATED, WindowState.REFUSED]


def test_the_same_recording_again_changes_nothing(fleet: SqlStorage) -> None:
    before = put(fleet, 0)
    aged(fleet)
    purged(fleet)
    with fleet.write() as unit:
        assert not unit.windows.put(make.window(0), 100.0, 3)
        assert unit.windows.put(make.window(0), 101.0, 3)  # another mileage needs no samples
        assert unit.windows.get("WS-1", make.START) == replace(before, mileage_km=101.0, samples_purged=True)
        with pytest.raises(DamagedError):
            unit.windows.load("WS-1", make.START)
    assert list(fleet.data_dir.rglob("*.window")) == []
    with fleet.write() as unit:
        assert unit.windows.put(make.window(0, seed=3), 101.0, 3)  # fuller
        assert make.same(unit.windows.load("WS-1", make.START), make.window(0, seed=3))
    assert states(fleet) == [WindowState.PENDING]


def test_a_file_that_was_used_again_is_left_to_the_orphans(fleet: SqlStorage) -> None:
    put(fleet, 0)
    assert purged(fleet).items == 1
    assert len(list(fleet.data_dir.rglob("*.window"))) == 1  # younger than a transaction may be
    aged(fleet)
    assert len(orphaned_samples(fleet)) == 1


def test_a_day_of_samples_is_the_least() -> None:
    assert Retention(window_samples=1.0).window_samples == 1.0
    with pytest.raises(ParameterError, match="at least 1 days"):
        Retention(window_samples=0.9)
    assert (Retention().window_samples, Retention().window_bin_tables) == (31.0, 92.0)

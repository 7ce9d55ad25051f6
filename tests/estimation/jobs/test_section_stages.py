"""A section is looked at again where something has happened on it, and only there; a look writes nothing but itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from alignment_job import QUIET, counts, put, register, surveyed
from paper_class import paper_class
from queried_news import first_changed, placed
from sqlalchemy import update

from bench.put_values import put_table
from bench.standing_clock import StandingClock
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.jobs import estimate_windows, refresh_alignment
from estimation.jobs.estimate_windows import OUTDATED
from estimation.jobs.job import JobContext
from estimation.jobs.refresh_alignment import ALIGNMENT
from estimation.jobs.settings import JobSettings
from estimation.jobs.stage import AnyStage
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.jobs.steps.epoch_inputs import FileLookup, changed_from
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, Reprofiling
from estimation.values.runs import Mark
from estimation.values.track import EpochMember, TrackLayout
from estimation.values.windows import DueStage, WindowState
from fleet_db.due import WINDOWS
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.assembled import AssembledWindow
from fleet_db.stores.registry_history import RecordKey
from fleet_db.telemetry import window_digest

JOBS = ("refresh_alignment", "estimate_windows")
SETTINGS = JobSettings()


def context_of(storage: SqlStorage, code_version: str = "test") -> JobContext:
    return JobContext(storage, StandingClock(10**15), code_version, SETTINGS)


def news(storage: SqlStorage, code_version: str = "test") -> list[set[str]]:
    """Return the sections that the alignment looks at, and those that the estimation looks at."""
    return [due_of(stage, storage, context_of(storage, code_version)) for stage in (ALIGNMENT, OUTDATED)]


def due_of(stage: AnyStage, storage: SqlStorage, context: JobContext) -> set[str]:
    with storage.read() as unit:
        return set(unit.marks.due(stage.inputs(context), context.clock.now_ns()))


def first_due(unit: SqlUnitOfWork, section: str) -> int | None:
    """Return the first epoch of a section that is not as its windows are now."""
    settings = SETTINGS
    lookup = FileLookup(unit, settings, ClassLookup(unit, settings.estimation))
    changed_ns = changed_from(unit, lookup, section)
    due = [
        epoch.number
        for epoch in unit.epochs.list(section)
        if epoch.stale or (changed_ns is not None and changed_ns <= epoch.horizon_ns)
    ]
    return min(due, default=None)


def come_to_rest(storage: SqlStorage) -> None:
    register(storage, ("S1", "S2"))
    with storage.write() as unit:
        for code in ("S1", "S2"):
            unit.tracks.add_alignment(replace(surveyed(), section=code))
    put(storage, [0, 1])
    for _ in range(2):
        for job in JOBS:
            counts(storage, job)
    with storage.read() as unit:
        assert unit.windows.counts()["estimated"] > 0


@pytest.fixture
def at_rest(filled_storage: Callable[[Callable[[SqlStorage], object]], SqlStorage]) -> SqlStorage:
    """Return a store with windows on one of two surveyed sections, on which jobs found nothing more to do."""
    return filled_storage(come_to_rest)


def first_window(unit: SqlUnitOfWork) -> tuple[str, int]:
    record = unit.windows.list("W0")[0]
    return record.wheelset, record.start_ns


def _mark(unit: SqlUnitOfWork) -> None:
    unit.windows.mark(*first_window(unit), WindowState.REFUSED, Reason(ReasonCode.ALIGNMENT_UNKNOWN, "none"))


def _forget(unit: SqlUnitOfWork) -> None:
    unit.windows.look_again([first_window(unit)])


def _remove(unit: SqlUnitOfWork) -> None:
    unit.assembled.remove(unit.windows.list("W0")[:1])


def _turn(unit: SqlUnitOfWork) -> None:
    unit.registry.add_reprofiling(Reprofiling("W0", 1, 1.0))


def _survey(unit: SqlUnitOfWork) -> None:
    unit.tracks.add_alignment(surveyed(1.1))


def _rename(unit: SqlUnitOfWork) -> None:
    unit.tracks.add_section(replace(unit.tracks.section("S1"), name="other"))


def _move_axle(unit: SqlUnitOfWork) -> None:
    unit.registry.add_vehicle(replace(unit.registry.vehicle("V0"), axle_offsets_m=(1.0,)))


def _remount(unit: SqlUnitOfWork) -> None:
    unit.registry.add_mounting(Mounting("W0", "V0", 1, 0, None, 0.0, 0.0, reversed=True))


def _radius(unit: SqlUnitOfWork) -> None:
    unit.registry.add_wheelset(replace(unit.registry.wheelset("W0"), nominal_radius_m=0.44))


def _measure(unit: SqlUnitOfWork) -> None:
    unit.registry.add_measured_profiles(MeasuredProfiles("W0", 1, 10.0, wheel_profile("P8"), wheel_profile("P8"), 5e-5))


def _layout(unit: SqlUnitOfWork) -> None:
    unit.tracks.add_layout(TrackLayout("S1", 0, np.array([0.0, 2900.0]), np.zeros(2), np.zeros(2)))


def _put_epoch(unit: SqlUnitOfWork) -> None:
    unit.epochs.put(unit.epochs.list("S1")[0], [])


def _put_found(unit: SqlUnitOfWork) -> None:
    unit.epochs.put_found("S1", 1, None)


def _put_table(unit: SqlUnitOfWork) -> None:
    record, table, _ = next(unit.tables.stream("W0", 0, None))
    put_table(unit, *record.key, table, None, record.content_digest)


def _start_again(unit: SqlUnitOfWork) -> None:
    unit.epochs.start_again("S1")


def test_at_rest_no_section_is_looked_at_and_nothing_is_written(
    at_rest: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert news(at_rest) == [set(), set()]
    monkeypatch.setattr(SqlStorage, "write", None)
    assert refresh_alignment.JOB.run(context_of(at_rest))["unchanged"] == 2
    assert estimate_windows.run(context_of(at_rest)) == QUIET


CHANGES = (
    _mark,
    _forget,
    _remove,
    _turn,
    _move_axle,
    _remount,
    _radius,
    _measure,
    _survey,
    _layout,
    _rename,
    _put_epoch,
    _put_found,
    _put_table,
    _start_again,
)
NO_CONCERN_OF_AN_ALIGNMENT = (_mark, _put_found, _put_table)


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_happens_on_a_section_it_is_looked_at_again_and_the_other_is_not(
    at_rest: SqlStorage, change: Callable[[SqlUnitOfWork], None]
) -> None:
    with at_rest.write() as unit:
        change(unit)
    of_alignment, of_estimation = (found - {""} for found in news(at_rest))
    assert of_alignment == (set() if change in NO_CONCERN_OF_AN_ALIGNMENT else {"S1"})
    assert of_estimation == {"S1"}


def _put_late(unit: SqlUnitOfWork) -> None:
    window = unit.windows.load(*first_window(unit))
    unit.windows.put(replace(window, start_ns=window.start_ns + 10**12), 10.0, 1)


def _change_content(unit: SqlUnitOfWork) -> None:
    window = unit.windows.load(*first_window(unit))
    unit.windows.put(replace(window, distance=window.distance + 1.0), 10.0, 1)


def _change_mileage(unit: SqlUnitOfWork) -> None:
    unit.windows.put(unit.windows.load(*first_window(unit)), 11.0, 1)


def _change_vehicle(unit: SqlUnitOfWork) -> None:
    unit.windows.put(replace(unit.windows.load(*first_window(unit)), vehicle="V1"), 10.0, 1)


def _leave(unit: SqlUnitOfWork) -> None:
    unit.windows.put(replace(unit.windows.load(*first_window(unit)), track_section=None), 10.0, 1)


def _leave_and_return(unit: SqlUnitOfWork) -> None:
    window = unit.windows.load(*first_window(unit))
    unit.windows.put(replace(window, track_section="S2"), 10.0, 1)
    unit.windows.put(window, 11.0, 1)


def _come_from_elsewhere(unit: SqlUnitOfWork) -> None:
    window = unit.windows.load(*first_window(unit))
    unit.windows.put(replace(window, track_section="S2"), 10.0, 1)
    epoch = replace(unit.epochs.list("S1")[0], section="S2", windows=1)
    record = unit.windows.get(*first_window(unit))
    assert record is not None
    unit.epochs.put(epoch, [EpochMember(record, "context", "assumed")])


def _replace_assembled(unit: SqlUnitOfWork) -> None:
    window = unit.windows.load(*first_window(unit))
    moved = replace(window, distance=window.distance + 1.0, track_section="S2")
    unit.assembled.replace([AssembledWindow(moved, window_digest(moved), 10.0)], 1)


def _purge(unit: SqlUnitOfWork) -> None:
    """Let a window come before others whose samples have been purged."""
    record = unit.windows.list("W0")[1]
    window = unit.windows.load(*first_window(unit))
    gone = WINDOWS.c.start_ns == record.start_ns
    unit.connection.execute(update(WINDOWS).where(gone).values(samples_purged_ns=1))
    unit.windows.put(replace(window, start_ns=window.start_ns - 10**9), 10.0, 1)


@pytest.mark.parametrize(
    "change",
    [
        *CHANGES,
        _put_late,
        _change_content,
        _change_mileage,
        _change_vehicle,
        _leave,
        _leave_and_return,
        _come_from_elsewhere,
        _replace_assembled,
        _purge,
    ],
)
def test_what_is_listed_is_what_a_comparison_of_all_windows_finds(
    at_rest: SqlStorage, change: Callable[[SqlUnitOfWork], None]
) -> None:
    with at_rest.write() as unit:
        before = placed(unit.connection, "S1")
        assert first_due(unit, "S1") is first_changed(unit.connection, "S1", before) is None
        change(unit)
    with at_rest.read() as unit:
        assert first_due(unit, "S1") == first_changed(unit.connection, "S1", before)
    for job in JOBS:
        counts(at_rest, job)
    with at_rest.read() as unit:
        now = placed(unit.connection, "S1")
        assert first_due(unit, "S1") is first_changed(unit.connection, "S1", now) is None
        assert unit.due.of_section(DueStage.ALIGNMENT, "S1") == {}


def test_a_window_is_news_on_the_section_it_is_on_and_on_the_one_it_was_on(at_rest: SqlStorage) -> None:
    put(at_rest, [0], section="S2")  # the same times
    assert [found - {""} for found in news(at_rest)] == [{"S1", "S2"}, {"S1", "S2"}]


def test_windows_on_a_section_that_is_no_longer_on_file_are_looked_at(at_rest: SqlStorage) -> None:
    with at_rest.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.SECTION, "S1"), Decision("ada", "never was", 1))
    for _ in range(2):
        counts(at_rest, "estimate_windows")
    assert "S1" in news(at_rest, "other")[1]


def test_another_class_and_other_settings_look_at_all_windows(at_rest: SqlStorage) -> None:
    others = replace(SETTINGS, estimation=replace(SETTINGS.estimation, interval_km=SETTINGS.estimation.interval_km + 1))
    for stage in (ALIGNMENT, OUTDATED):
        assert due_of(stage, at_rest, replace(context_of(at_rest), settings=others)) == {"S1", "S2"}
    metro = paper_class("metro")
    softer = replace(metro, parameters=replace(metro.parameters, yaw_stiffness=0.9 * metro.parameters.yaw_stiffness))
    with at_rest.write() as unit:
        unit.registry.add_vehicle_class(softer, 2)
    assert news(at_rest) == [{"S1"}, {"S1"}]  # there are no windows on the other


def test_another_version_of_the_numerics_looks_at_all(at_rest: SqlStorage) -> None:
    assert news(at_rest, "other") == [{"S1", "S2"}, {"S1", "S2"}]


def test_a_change_during_a_look_is_looked_at_again(at_rest: SqlStorage) -> None:
    with at_rest.write() as unit:
        _forget(unit)
    inputs = OUTDATED.inputs(context_of(at_rest))
    with at_rest.read() as unit:
        seen = unit.marks.due(inputs, 0)["S1"].seen
    with at_rest.write() as unit:
        _mark(unit)
    with at_rest.write() as unit:
        unit.marks.note(inputs, {"S1": Mark(seen, "")})
    assert news(at_rest)[1] == {"S1"}

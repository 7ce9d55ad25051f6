"""A section is looked at again where something has happened on it, and only there; a look writes nothing but itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from alignment_job import QUIET, counts, put, register, surveyed
from paper_class import paper_class

from bench.standing_clock import StandingClock
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.jobs import estimate_windows, refresh_alignment
from estimation.jobs.job import JobContext
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps.section_looks import section_news
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, Reprofiling
from estimation.values.track import TrackLayout
from estimation.values.windows import WindowState
from fleet_db.registry_events import Decision, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey

STAGES = ("refresh_alignment", "estimate_windows")
SETTINGS = JobSettings()


def context_of(storage: SqlStorage, code_version: str = "test") -> JobContext:
    return JobContext(storage, StandingClock(10**15), code_version, SETTINGS)


def news(storage: SqlStorage, code_version: str = "test") -> list[set[str]]:
    with storage.read() as unit:
        return [set(section_news(unit, context_of(storage, code_version), stage)) for stage in STAGES]


def come_to_rest(storage: SqlStorage) -> None:
    register(storage, ("S1", "S2"))
    with storage.write() as unit:
        for code in ("S1", "S2"):
            unit.tracks.add_alignment(replace(surveyed(), section=code))
    put(storage, [0, 1])
    for _ in range(2):
        for stage in STAGES:
            counts(storage, stage)
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
    unit.tracks.forget_position(*first_window(unit))


def _remove(unit: SqlUnitOfWork) -> None:
    unit.assembled.remove(unit.windows.list("W0")[:1])


def _turn(unit: SqlUnitOfWork) -> None:
    unit.registry.add_reprofiling(Reprofiling("W0", 1, 1.0))


def _survey(unit: SqlUnitOfWork) -> None:
    unit.tracks.add_alignment(surveyed(1.1))


def _rename(unit: SqlUnitOfWork) -> None:
    unit.tracks.add_section(replace(unit.tracks.section("S1"), name="other"))


def _wait(unit: SqlUnitOfWork) -> None:
    unit.windows.look_again([first_window(unit)])


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
    unit.tables.put(*record.key, table, None, record.content_digest)


def _start_again(unit: SqlUnitOfWork) -> None:
    unit.epochs.start_again("S1")


def test_at_rest_no_section_is_looked_at_and_nothing_is_written(
    at_rest: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert news(at_rest) == [set() | {""}, set()]  # windows on no section are no concern of the alignment
    monkeypatch.setattr(SqlStorage, "write", None)
    monkeypatch.setattr(refresh_alignment, "_first_due", None)
    assert refresh_alignment.run(context_of(at_rest))["unchanged"] == 2
    assert estimate_windows.run(context_of(at_rest)) == QUIET


@pytest.mark.parametrize(
    "change",
    [
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
        _wait,
        _put_epoch,
        _put_found,
        _put_table,
        _start_again,
    ],
)
def test_whatever_happens_on_a_section_it_is_looked_at_again_and_the_other_is_not(
    at_rest: SqlStorage, change: Callable[[SqlUnitOfWork], None]
) -> None:
    with at_rest.write() as unit:
        change(unit)
    assert [found - {""} for found in news(at_rest)] == [{"S1"}, {"S1"}]


def test_a_window_is_news_on_the_section_it_is_on_and_on_the_one_it_was_on(at_rest: SqlStorage) -> None:
    put(at_rest, [0], section="S2")  # the same times
    assert [found - {""} for found in news(at_rest)] == [{"S1", "S2"}, {"S1", "S2"}]


def test_windows_on_a_section_that_is_no_longer_on_file_are_looked_at(at_rest: SqlStorage) -> None:
    with at_rest.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.SECTION, "S1"), Decision("ada", "never was", 1))
    for _ in range(2):
        counts(at_rest, "estimate_windows")
    assert "S1" in news(at_rest, "other")[1]


def test_another_class_and_other_settings_look_at_all(at_rest: SqlStorage) -> None:
    others = replace(SETTINGS, estimation=replace(SETTINGS.estimation, interval_km=SETTINGS.estimation.interval_km + 1))
    with at_rest.read() as unit:
        changed = replace(context_of(at_rest), settings=others)
        assert set(section_news(unit, changed, "estimate_windows")) == {"", "S1", "S2"}
    metro = paper_class("metro")
    softer = replace(metro, parameters=replace(metro.parameters, yaw_stiffness=0.9 * metro.parameters.yaw_stiffness))
    with at_rest.write() as unit:
        unit.registry.add_vehicle_class(softer, 2)
    assert news(at_rest)[1] == {"", "S1", "S2"}


def test_another_version_of_the_numerics_looks_at_all(at_rest: SqlStorage) -> None:
    assert news(at_rest, "other")[1] == {"", "S1", "S2"}


def test_a_change_during_a_look_is_looked_at_again(at_rest: SqlStorage) -> None:
    with at_rest.write() as unit:
        _wait(unit)
    with at_rest.read() as unit:
        seen = section_news(unit, context_of(at_rest), "estimate_windows")
    with at_rest.write() as unit:
        _mark(unit)
    with at_rest.write() as unit:
        unit.section_looks.note("estimate_windows", seen)
    assert news(at_rest)[1] == {"S1"}

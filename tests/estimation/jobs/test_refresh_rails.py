"""Wheels and rails apart on a real store: two sections, one worn; what is read again, and what holds the level."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from alignment_job import DAY_NS, LENGTH, NAMES, counts, put, register, surveyed
from one_database import on_sqlite
from section_runs import RUNS, SECONDS
from smooth_wheelset import mems_windows, run

from bench.put_values import put_geometry
from bench.standing_clock import StandingClock
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.errors import DamagedError
from estimation.jobs import refresh_rails
from estimation.jobs.job import JobContext
from estimation.jobs.refresh_rails import anchor_inputs, anchors
from estimation.jobs.settings import JobSettings, KnownSection, RailsSettings
from estimation.jobs.steps import rail_cells
from estimation.jobs.steps.assumptions import Membership
from estimation.jobs.steps.rolling import Rolled, rolled
from estimation.rails.parameters import RailsParameters
from estimation.storage import Storage, UnitOfWork
from estimation.values.opinions import SECTION_RAILS, WHEELSET_RAILS, RailPart, RailsReference, WheelsFinding
from estimation.values.quantities import Estimate
from estimation.values.reasons import ReasonCode
from estimation.values.registry import Reprofiling
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import Window
from fleet_db.storage import SqlStorage
from fleet_db.stores.geometries import GeometryStore
from fleet_db.stores.opinions import RailsStore

WEAR = 0.04  # what the rails of S2 add to every conicity
EVERYWHERE, ONLY_WORN = (0, 1, 2), 4
KNOWN = JobSettings(rails=RailsSettings(frozenset({KnownSection("S1", 0)})))


@cache
def on_worn_rails(number: int) -> tuple[Window, ...]:
    cone, speed = RUNS[number]
    found = mems_windows(run(SECONDS, seed=1, cone=cone + WEAR, speed=speed), seed=900 + number)
    return tuple(replace(window, wheelset=f"W{number}", vehicle=f"V{number}", track_section="S2") for window in found)


@cache
def turned_on_worn_rails(number: int) -> tuple[Window, ...]:
    """Return the windows of :func:`on_worn_rails` with other wheels, for which nobody registered a lathe."""
    cone, speed = RUNS[number]
    found = mems_windows(run(SECONDS, seed=1, cone=cone + WEAR + 0.1, speed=speed), seed=900 + number)
    return tuple(replace(window, wheelset=f"W{number}", vehicle=f"V{number}", track_section="S2") for window in found)


def put_worn(storage: Storage, number: int, day: int = 1) -> None:
    with storage.write() as unit:
        for window in on_worn_rails(number):
            unit.windows.put(replace(window, start_ns=window.start_ns + day * DAY_NS), 10.0 + day, 1)


def run_on_both_sections(storage: Storage) -> None:
    """Store runs on both sections, estimated; one wheelset ran on worn rails alone."""
    register(storage, ("S1", "S2"))
    with storage.write() as unit:
        for code in ("S1", "S2"):
            unit.tracks.add_alignment(replace(surveyed(), section=code))
    put(storage, EVERYWHERE)
    for number in (*EVERYWHERE, ONLY_WORN):
        put_worn(storage, number)
    estimate(storage)


@pytest.fixture
def received(storage: SqlStorage, filled_storage: Callable[[Callable[[SqlStorage], object]], SqlStorage]) -> Storage:
    """Return a store with what ``run_on_both_sections`` stores; on SQLite a copy."""
    if storage.engine.dialect.name == "sqlite":
        return filled_storage(run_on_both_sections)
    run_on_both_sections(storage)
    return storage


def estimate(storage: Storage) -> None:
    for name in ("estimate_windows", "refresh_geometry"):
        counts(storage, name)


def refresh(storage: Storage, settings: JobSettings = KNOWN) -> Mapping[str, int]:
    return counts(storage, "refresh_rails", settings)


def newest(storage: Storage, section: str) -> RailPart:
    with storage.read() as unit:
        found = unit.results.latest(SECTION_RAILS, section)
    assert found is not None
    assert found.value is not None
    return found.value.periods[-1]


def wheels(storage: Storage, number: int) -> WheelsFinding:
    with storage.read() as unit:
        found = unit.results.latest(WHEELSET_RAILS, NAMES[number])
    assert found is not None
    assert found.value is not None
    return found.value


def reason_of(storage: Storage, section: str) -> ReasonCode | None:
    """Return why a section holds no level though it is named as known."""
    with storage.read() as unit:
        found = unit.results.latest(SECTION_RAILS, section)
    assert found is not None
    assert found.value is not None
    return None if found.value.refused is None else found.value.refused.code


def named(*sections: str) -> JobSettings:
    return JobSettings(rails=RailsSettings(frozenset(KnownSection(code, 0) for code in sections)))


def values(estimates: tuple[Estimate, ...]) -> list[float]:
    return [one.value for one in estimates if one.value is not None]


def test_worn_rails_are_a_finding_of_the_section_and_not_of_the_wheelsets(received: Storage) -> None:
    done = refresh(received)
    assert done == {"wheelsets": 6, "cells": 7, "sections": 2, "known_refused": 0, "quarantined": 0}
    part = newest(received, "S2")
    assert part.reference is RailsReference.KNOWN_RAILS
    assert values(part.part) == pytest.approx([WEAR] * len(values(part.part)), abs=0.015)
    assert len(values(part.part)) > 2
    cone, _ = RUNS[ONLY_WORN]
    one = wheels(received, ONLY_WORN).part
    assert one.sections == ("S2",)
    assert values(one.conicity) == pytest.approx([cone] * len(values(one.conicity)), abs=0.5 * WEAR)
    found = wheels(received, ONLY_WORN)
    for amplitude, estimate_there in zip(found.amplitude, found.part.conicity, strict=True):
        if estimate_there.low is not None and estimate_there.high is not None:
            true = cone + 0.01 + 0.75 * 800.0 * amplitude**2  # rL - rR = (2 cone + 0.02) x + 1600 x^3
            assert estimate_there.low <= true <= estimate_there.high
    with received.read() as unit:
        geometry = unit.geometries.current(NAMES[ONLY_WORN])
    assert geometry is not None
    blamed = values(geometry.geometry.conicity)
    assert blamed == pytest.approx([cone + WEAR] * len(blamed), abs=0.5 * WEAR)


@on_sqlite
def test_a_repeat_reads_no_table_and_stores_nothing(received: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    refresh(received)
    with received.read() as unit:
        before, _ = unit.results.version(SECTION_RAILS, "S2")

    def refused(*_: object) -> None:
        raise AssertionError("the cells of a wheelset without news were looked at")

    monkeypatch.setattr(rail_cells, "rolled", refused)
    assert set(refresh(received).values()) == {0}
    with received.read() as unit:
        assert unit.results.version(SECTION_RAILS, "S2")[0] == before


@on_sqlite
def test_a_run_without_news_goes_by_counters_alone(received: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    refresh(received)
    with monkeypatch.context() as patched:
        patched.setattr(RailsStore, "cells", lambda _: pytest.fail("all cells were read"))
        assert set(refresh(received).values()) == {0}
    with received.write() as unit:
        unit.tracks.add_section(replace(unit.tracks.section("S2"), tonnage_mgt_per_year=40.0))
    assert refresh(received)["sections"] == 2
    assert refresh(received, named("S2"))["sections"] == 2
    with received.write() as unit:
        unit.registry.add_measured_profiles(
            MeasuredProfiles(NAMES[1], DAY_NS, 10.0, wheel_profile("P8"), wheel_profile("P8"), 0.1e-3)
        )
    assert refresh(received, named("S2"))["sections"] == 2


@on_sqlite
def test_wheelsets_are_parted_again_as_soon_as_one_that_failed_is_read(
    received: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(unit: UnitOfWork, rules: Membership) -> Rolled:
        if rules.wheelset == "W1":
            raise DamagedError("cells of W1")
        return rolled(unit, rules)

    with monkeypatch.context() as patched:
        patched.setattr(rail_cells, "rolled", failing)
        assert refresh(received)["quarantined"] == 1
    assert refresh_rails.JOB.run(JobContext(received, StandingClock(10**18), "test", KNOWN))["cells"] == 2
    assert wheels(received, 1).part.sections == ("S1", "S2")


@on_sqlite
def test_only_the_cell_with_a_new_window_is_made_again(received: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    refresh(received)
    put_worn(received, 1, day=2)
    estimate(received)
    made: list[tuple[str, str]] = []
    conicity_of = rail_cells.section_conicity

    def noting(wheel: object, rail: object, *rest: object, **named: object) -> object:
        made.append((getattr(wheel, "wheelset", ""), getattr(rail, "section", "")))
        return conicity_of(wheel, rail, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(rail_cells, "section_conicity", noting)
    assert refresh(received)["cells"] == 1
    assert made == [("W1", "S2")]


@on_sqlite
def test_windows_that_are_refused_by_now_take_their_cell_with_them(received: Storage) -> None:
    refresh(received)
    with received.write() as unit:
        for window in on_worn_rails(2):
            faulty = replace(window.quality, sensor_fault=True)
            unit.windows.put(replace(window, start_ns=window.start_ns + DAY_NS, quality=faulty), 11.0, 2)
    estimate(received)
    assert refresh(received)["cells"] == 1
    with received.read() as unit:
        assert [one.rail.section for one in unit.rails.cells() if one.wheel.wheelset == "W2"] == ["S1"]
    assert wheels(received, 2).part.sections == ("S1",)


@on_sqlite
def test_without_known_rails_no_wheelset_gets_a_conicity(received: Storage) -> None:
    refresh(received, JobSettings())
    part = newest(received, "S2")
    assert part.reference is RailsReference.MEAN
    assert values(part.part) == pytest.approx([0.5 * WEAR] * len(values(part.part)), abs=0.01)
    assert not values(wheels(received, 0).part.conicity)
    assert not values(part.excess)


@on_sqlite
def test_rails_of_another_kind_hold_no_level_though_they_be_known(received: Storage) -> None:
    with received.write() as unit:
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "60E1", 0.025, 1.435, LENGTH))
    estimate(received)
    refresh(received, named("S1", "S2"))
    references = {code: newest(received, code).reference for code in ("S1", "S2")}
    assert set(references.values()) == {RailsReference.KNOWN_RAILS}
    assert values(newest(received, "S2").part) == pytest.approx([0.0] * len(values(newest(received, "S2").part)))
    assert any(abs(one) > 0.02 for one in values(newest(received, "S1").part))
    assert reason_of(received, "S1") is ReasonCode.KNOWN_RAILS_OTHER
    assert reason_of(received, "S2") is None


@on_sqlite
def test_measured_profiles_hold_the_level(received: Storage) -> None:
    """The profiles are not those of the run: what they say is what counts, and the rails are what is left."""
    wheel = wheel_profile("P8")
    with received.write() as unit:
        for number in (1, 2):
            unit.registry.add_measured_profiles(
                MeasuredProfiles(NAMES[number], DAY_NS, 10.0, wheel, wheel, 0.1e-3)  # mileage of the first interval
            )
    refresh(received, JobSettings())
    assert newest(received, "S1").reference is RailsReference.MEASURED_WHEELS


@on_sqlite
def test_what_contradicts_the_class_gives_no_cell(received: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    why = rail_cells.Reason(ReasonCode.YAW_SPRING_DIFFERS, "another spring")
    digests = GeometryStore.interval_digests
    monkeypatch.setattr(
        GeometryStore,
        "interval_digests",
        lambda *given: {place: replace(one, reason=why) for place, one in digests(*given).items()},
    )
    refresh(received)
    with received.read() as unit:
        cells = unit.rails.cells()
    assert {one.reason for one in cells} == {why}
    assert all(one.cell is None for one in cells)


@on_sqlite
def test_cells_of_an_interval_whose_geometry_is_refused_by_now_are_not_used(received: Storage) -> None:
    refresh(received)
    why = rail_cells.Reason(ReasonCode.YAW_SPRING_DIFFERS, "another spring")
    with received.write() as unit:
        (record,) = unit.geometries.intervals("W1")
        put_geometry(unit, replace(record, geometry=record.geometry.mismatched(why), input_digest="f" * 64))
    assert refresh(received)["cells"] == 2
    with received.read() as unit:
        assert {one.reason for one in unit.rails.cells(["W1"])} == {why}
        assert {one.reason for one in unit.rails.cells(["W2"])} == {None}


@on_sqlite
def test_the_limit_of_the_settings_makes_the_finding(received: Storage) -> None:
    found = {}
    for limit in (0.01, 0.3):
        rails = replace(KNOWN.rails, model=replace(RailsParameters(), limit=limit))
        refresh(received, replace(KNOWN, rails=rails))
        with received.read() as unit:
            record = unit.results.latest(SECTION_RAILS, "S2")
        assert record is not None
        assert record.value is not None
        found[limit] = (record.value.limit, record.value.exceeded)
    assert found[0.3][0] == 0.3
    assert found[0.3][1] is not True


@on_sqlite
def test_a_known_section_that_is_not_on_file_is_said(received: Storage, caplog: pytest.LogCaptureFixture) -> None:
    assert refresh(received, named("S1", "S-1"))["known_refused"] == 1
    assert "section S-1 is named as known" in caplog.text
    assert newest(received, "S2").reference is RailsReference.KNOWN_RAILS
    refresh(received, named("S-1"))
    assert newest(received, "S2").reference is RailsReference.MEAN
    assert [one.reason.text for one in newest(received, "S2").excess if one.reason and "S-1" in one.reason.text]


@on_sqlite
def test_known_sections_that_contradict_each_other_hold_nothing(received: Storage) -> None:
    with received.write() as unit:
        for number in EVERYWHERE:
            for window in turned_on_worn_rails(number):  # 0.14 more than on S1
                unit.windows.put(replace(window, start_ns=window.start_ns + DAY_NS), 11.0, 2)
    estimate(received)
    assert refresh(received, named("S1", "S2"))["known_refused"] == 2
    for section in ("S1", "S2"):
        assert reason_of(received, section) is ReasonCode.KNOWN_RAILS_DIFFER
        assert newest(received, section).reference is RailsReference.MEAN
        assert not values(newest(received, section).excess)
    assert not values(wheels(received, 0).part.conicity)


@on_sqlite
def test_a_wheelset_that_is_turned_in_a_mileage_interval_is_two(received: Storage) -> None:
    """It ran on S1 before, on S2 afterwards: it says nothing of what is between them."""
    refresh(received)
    turned = Reprofiling("W0", DAY_NS, 10.5)
    with received.write() as unit:
        unit.registry.add_reprofiling(turned, 1)
    estimate(received)
    refresh(received)
    with received.read() as unit:
        cells = unit.rails.cells()
    assert {(one.wheel.baseline, one.rail.section) for one in cells if one.wheel.wheelset == "W0"} == {
        (0, "S1"),
        (1, "S2"),
    }
    part = newest(received, "S2")
    assert values(part.part) == pytest.approx([WEAR] * len(values(part.part)), abs=0.015)
    assert wheels(received, 0).part.wheel.baseline == 1


@on_sqlite
def test_a_wheelset_that_nobody_said_was_turned_takes_nobody_in(received: Storage) -> None:
    """Its wheels are others on S2 than on S1, by 0.1: what is published, if anything, covers the truth."""
    with received.write() as unit:
        for window in turned_on_worn_rails(1):
            unit.windows.put(replace(window, start_ns=window.start_ns + DAY_NS), 11.0, 2)
    estimate(received)
    refresh(received)
    for one in newest(received, "S2").part:
        if one.value is None:
            assert one.reason is not None
        else:
            assert one.low is not None
            assert one.high is not None
            assert one.low <= WEAR <= one.high


@on_sqlite
def test_the_traffic_on_file_is_what_the_trend_is_given_by(received: Storage) -> None:
    refresh(received)
    with received.write() as unit:
        unit.tracks.add_section(replace(unit.tracks.section("S2"), tonnage_mgt_per_year=40.0))
    context = JobContext(received, StandingClock(10**15), "test", KNOWN)
    with received.read() as unit:
        inputs = anchor_inputs(unit, unit.rails.cells(), context)
    assert anchors(inputs, np.array([3e-3])).tonnage == {"S2": 40.0}
    assert refresh(received)["sections"] == 2  # it is solved again

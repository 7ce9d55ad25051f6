"""Recordings in any order, twice, late: the same windows, bin tables, geometries and alerts, bit for bit."""

from __future__ import annotations

import pytest
from one_database import url_on_sqlite
from sqlalchemy import select
from tiny_fleet import DEAD, WORN, Deployment, results, rows, whole_history

from estimation.values.geometry import GEOMETRY, GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.stores.results import RESULTS
from ingest.simulator.fleet import FleetReport

WRONG = Reason(ReasonCode.NOT_FINITE, "found to be wrong")


@url_on_sqlite
def test_another_order_and_twice_gives_the_same_results(
    fleet: Deployment, second_fleet: Deployment, report: FleetReport
) -> None:
    for deployed in (fleet, second_fleet):
        for number in (2, 0, 3, 1) if deployed is fleet else range(4):
            deployed.campaign_over([report.recordings[number]] * (2 if deployed is fleet else 1))
        deployed.run_jobs()
    fleet.receive(report.recordings)
    fleet.run_jobs()
    found, expected = results(fleet.storage), results(second_fleet.storage)
    assert len(found["windows"]) == 24
    for name, values in expected.items():
        assert found[name] == values, name


def versions(fleet: Deployment, serial: str) -> list[GeometryRecord]:
    with fleet.storage.read() as unit:
        return list(unit.geometries.intervals(serial))


def geometries(fleet: Deployment) -> set[int]:
    """Return the numbers of all geometries there have been."""
    with fleet.storage.read() as unit:
        of_stage = select(RESULTS.c.result_id).where(RESULTS.c.stage == GEOMETRY.stage)
        return set(unit.connection.scalars(of_stage))


@pytest.mark.slow
def test_a_late_recording_changes_the_geometries_it_belongs_to_and_no_other(
    fleet: Deployment, second_fleet: Deployment, report: FleetReport
) -> None:
    first, second, third, fourth = report.recordings
    for recording in (first, second, fourth):
        fleet.campaign_over([recording])
        fleet.run_jobs()
    before = {serial: versions(fleet, serial) for serial in (WORN, DEAD)}
    stored = geometries(fleet)
    fleet.campaign_over([third])
    fleet.run_jobs()
    after = {serial: versions(fleet, serial) for serial in (WORN, DEAD)}
    assert [r.recorded_ns for r in after[DEAD]] == [r.recorded_ns for r in before[DEAD]]  # dead by then
    kept = {(r.baseline, r.interval): r.recorded_ns for r in before[WORN]}
    now = {(r.baseline, r.interval): r.recorded_ns for r in after[WORN]}
    assert {key: now[key] for key in kept} == kept
    assert len(now) == len(kept) + 1
    grown = geometries(fleet)
    assert stored <= grown
    assert len(grown) == len(stored) + 2  # the interval that was missing, and the current one
    whole_history(second_fleet, report)
    assert results(fleet.storage)["geometries"] == results(second_fleet.storage)["geometries"]


def test_geometries_follow_windows_that_are_refused_later(second_fleet: Deployment, report: FleetReport) -> None:
    """Nothing that no window supports any more stays published, or in the trend."""
    fleet = second_fleet
    fleet.campaign_over(report.recordings)
    fleet.run_jobs()
    (one, *_), (other, *_) = ([r for r in versions(fleet, WORN) if r.baseline == b] for b in (1, 0))
    with fleet.storage.write() as unit:
        for window in unit.windows.list(WORN, one.from_ns, one.to_ns):
            unit.windows.mark(WORN, window.start_ns, type(window.state).REFUSED, WRONG)
    fleet.run_jobs()
    found = {(r.baseline, r.interval): r for r in versions(fleet, WORN)}
    gone = found[one.baseline, one.interval]
    assert (gone.geometry.status, gone.geometry.windows) == (Status.UNESTIMATED, 0)
    assert found[other.baseline, other.interval].recorded_ns == other.recorded_ns
    with fleet.storage.read() as unit:
        trend = unit.trends.latest(WORN)
        current = unit.geometries.current(WORN)
    assert trend is not None
    assert len(trend.trend.value) == 1
    assert current is not None
    assert current.from_ns > one.to_ns
    with fleet.storage.write() as unit:
        for window in unit.windows.list(WORN):
            unit.windows.mark(WORN, window.start_ns, type(window.state).REFUSED, WRONG)
    fleet.run_jobs()
    with fleet.storage.read() as unit:
        current = unit.geometries.current(WORN)
    assert current is not None
    assert current.geometry.status is Status.UNESTIMATED
    assert current.geometry.equivalent_conicity.value is None
    before = rows(fleet.storage)
    fleet.run_jobs()
    assert rows(fleet.storage) == before


def test_a_corrected_mileage_reaches_geometry_and_trend(second_fleet: Deployment, report: FleetReport) -> None:
    fleet = second_fleet
    fleet.campaign_over(report.recordings)
    fleet.run_jobs()
    with fleet.storage.read() as unit:
        before = [(r.mileage_km, r.geometry.equivalent_conicity) for r in unit.geometries.intervals(WORN, 1)]
        records = unit.windows.list(WORN)
        windows = [(unit.windows.load(WORN, record.start_ns), record.mileage_km + 100.0) for record in records]
    with fleet.storage.write() as unit:
        assert all(unit.windows.put(window, mileage, 1) for window, mileage in windows)
    fleet.run_jobs()
    with fleet.storage.read() as unit:
        after = [(r.mileage_km, r.geometry.equivalent_conicity) for r in unit.geometries.intervals(WORN, 1)]
        trend = unit.trends.latest(WORN)
    assert [km for km, _ in after] == pytest.approx([km + 100.0 for km, _ in before])
    assert [value for _, value in after] == [value for _, value in before]
    assert trend is not None
    assert trend.trend.mileage_km.tolist() == [km for km, _ in after]

"""The estimator that the settings name is what the jobs use, from one catalogue."""

from __future__ import annotations

from dataclasses import replace

import pytest
from one_database import url_on_sqlite
from tiny_fleet import WORN, Deployment

from api.comparison.study import geometry_by
from api.factory import estimation_settings, job_context
from api.schemas.geometry import geometry
from api.settings import load_settings
from estimation.errors import ParameterError
from estimation.values.geometry import BinStatus, GeometryRecord
from estimation.values.quantities import Status
from fleet_db.packed_values import pack_geometry
from ingest.simulator.fleet import FleetReport


def chosen(fleet: Deployment, estimator: str) -> Deployment:
    return replace(fleet, settings=fleet.settings.model_copy(update={"estimator": estimator}))


def stored(fleet: Deployment) -> tuple[GeometryRecord, list[GeometryRecord]]:
    with fleet.storage.read() as unit:
        current = unit.geometries.current(WORN)
        assert current is not None
        return current, list(unit.geometries.intervals(WORN))


@url_on_sqlite
def test_another_estimator_gives_another_geometry_and_names_itself(fleet: Deployment, report: FleetReport) -> None:
    fleet.campaign_over(report.recordings[:1])
    fleet.run_jobs()
    bins, _ = stored(fleet)
    chosen(fleet, "linear").run_jobs()  # no new window: the setting alone makes the geometry stale
    line, intervals = stored(fleet)
    assert (bins.estimator, line.estimator) == ("bins", "linear")
    assert geometry(line).estimator == "linear"
    assert {record.estimator for record in intervals} == {"linear"}
    assert line.input_digest != bins.input_digest
    assert line.geometry.parameter_key != bins.geometry.parameter_key
    values = {item.value for item in line.geometry.conicity if item.value is not None}
    assert line.geometry.status is Status.ESTIMATED
    assert max(values) - min(values) < 1e-9  # one slope
    assert len({item.value for item in bins.geometry.conicity}) > len(values)
    assert set(line.geometry.contact_angle_difference.status) == {BinStatus.UNOBSERVABLE}
    assert BinStatus.ESTIMATED in line.geometry.rolling_radius_difference.status
    chosen(fleet, "bins").run_jobs()
    again, _ = stored(fleet)
    assert again.geometry.equivalent_conicity == bins.geometry.equivalent_conicity


@url_on_sqlite
def test_the_same_estimator_again_changes_nothing(fleet: Deployment, report: FleetReport) -> None:
    line = chosen(fleet, "cubic")
    line.campaign_over(report.recordings[:1])
    line.run_jobs()
    before, _ = stored(line)
    runs = line.run_jobs()
    counts = next(run.counts for run in runs if run.job == "refresh_geometry")
    assert counts["wheelsets"] == 0
    assert stored(line)[0].recorded_ns == before.recorded_ns


def test_an_unknown_estimator_is_refused_naming_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TREADWATCH_ESTIMATOR", "kalman")
    with pytest.raises(ParameterError, match=r"TREADWATCH_ESTIMATOR.*no estimator 'kalman'; there are bins, linear"):
        estimation_settings(load_settings())


@url_on_sqlite
def test_a_comparison_takes_the_geometry_that_the_job_stored(fleet: Deployment, report: FleetReport) -> None:
    fleet.campaign_over(report.recordings[:1])
    fleet.run_jobs()
    stored_geometry = stored(fleet)[0].geometry
    context = job_context(fleet.settings, fleet.storage)
    compared = geometry_by(fleet.storage, context, WORN, "bins")
    assert compared is not None
    assert pack_geometry(compared) == pack_geometry(stored_geometry)
    line = geometry_by(fleet.storage, context, WORN, "linear")
    assert line is not None
    assert pack_geometry(line) != pack_geometry(stored_geometry)
    chosen(fleet, "linear").run_jobs()
    assert pack_geometry(stored(fleet)[0].geometry) == pack_geometry(line)

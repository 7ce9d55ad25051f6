"""The current geometry by each estimator, as ``treadwatch compare`` shows it; nothing of it is stored."""

from __future__ import annotations

from one_database import url_on_sqlite
from tiny_fleet import WORN, Deployment

from api.comparison.trial import geometry_by
from api.pipeline import job_context
from estimation.values.geometry import BinStatus, GeometryRecord
from estimation.values.quantities import Status
from fleet_db.packed_values import pack_geometry
from ingest.simulator.fleet import FleetReport


def stored(fleet: Deployment) -> GeometryRecord:
    with fleet.storage.read() as unit:
        current = unit.geometries.current(WORN)
    assert current is not None
    return current


@url_on_sqlite
def test_of_the_shipped_one_it_is_that_of_the_job_and_of_a_rival_another(
    fleet: Deployment, report: FleetReport
) -> None:
    fleet.campaign_over(report.recordings[:1])
    fleet.run_jobs()
    of_job, context = stored(fleet), job_context(fleet.settings, fleet.storage)
    shipped = geometry_by(fleet.storage, context, WORN, "bins")
    assert shipped is not None
    assert pack_geometry(shipped) == pack_geometry(of_job.geometry)
    line = geometry_by(fleet.storage, context, WORN, "linear")
    assert line is not None
    assert line.status is Status.ESTIMATED
    assert line.parameter_key == f"{shipped.parameter_key} linear"
    assert line.windows == shipped.windows
    values = {item.value for item in line.conicity if item.value is not None}
    assert max(values) - min(values) < 1e-9  # one slope
    assert len({item.value for item in shipped.conicity}) > len(values)
    assert set(line.contact_angle_difference.status) == {BinStatus.UNOBSERVABLE}
    assert BinStatus.ESTIMATED in line.rolling_radius_difference.status
    after = stored(fleet)
    assert (after.recorded_ns, after.input_digest) == (of_job.recorded_ns, of_job.input_digest)

"""An odometer that was reset to 0, or one garbled recording: refused with a code, an alert, and no other geometry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bad_recordings import message
from one_database import url_on_sqlite
from tiny_fleet import WORN, Deployment

from estimation.values.reasons import ReasonCode, code_of
from ingest import catalogue as kinds
from ingest.logs import read_log, write_blf
from ingest.simulator.fleet import FleetReport


@url_on_sqlite
def test_an_odometer_that_was_reset_moves_no_geometry_and_leaves_an_alert(
    fleet: Deployment, report: FleetReport, tmp_path: Path
) -> None:
    first, second, third, _ = report.recordings
    fleet.campaign_over([first, second])
    fleet.run_jobs()
    with fleet.storage.read() as unit:
        before = unit.geometries.current(WORN)
    reset = message(kinds.MOTION, kinds.VEHICLE_NODE, lambda s: s | {"odometer": s["odometer"] - s["odometer"][0]})
    path = tmp_path / third.path.name
    write_blf(path, reset(read_log(third.path)))
    fleet.receive([replace(third, path=path)])
    fleet.run_jobs()
    with fleet.storage.read() as unit:
        after = unit.geometries.current(WORN)
        codes = [code_of(window.reason) for window in unit.windows.list(WORN)]
        alerts = [alert.kind for alert in unit.alerts.all_open(WORN)]
    refused = codes.count(ReasonCode.ODOMETER_IMPLAUSIBLE)
    assert refused == len(codes) - codes.count(None) > 1
    assert before is not None
    assert after is not None
    assert (after.to_ns, after.mileage_km) == (before.to_ns, before.mileage_km)
    assert after.geometry.equivalent_conicity == before.geometry.equivalent_conicity
    assert after.parameters["windows_left_out"] == {"odometer_implausible": refused}
    assert "data_quality" in alerts

"""Twenty seconds left out of every journey: what is published is right at its amplitude, beside a gap too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tiny_fleet import DEAD, WORN, Deployment, true_conicity

from ingest.frames import take
from ingest.logs import read_log, write_blf
from ingest.simulator.fleet import FleetReport

STDS = 4.0
SECOND_NS = 10**9


def test_conicity_beside_a_gap_is_within_its_standard_deviation(
    second_fleet: Deployment, report: FleetReport, tmp_path: Path
) -> None:
    cut = []
    for recording in report.recordings:
        batch = read_log(recording.path)
        since = batch.t_ns - batch.t_ns[0]
        path = tmp_path / recording.path.name
        write_blf(path, take(batch, (since < 40 * SECOND_NS) | (since >= 60 * SECOND_NS)))
        cut.append(replace(recording, path=path))
    second_fleet.campaign_over(cut)
    second_fleet.run_jobs()
    worst, compared = 0.0, 0
    with second_fleet.storage.read() as unit:
        for serial in (WORN, DEAD):
            for record in unit.geometries.intervals(serial):
                geometry = record.geometry
                for amplitude, found in zip(geometry.amplitude, geometry.conicity, strict=True):
                    if found.value is None or found.std is None or amplitude < 1e-3:
                        continue
                    true = true_conicity(report.truth, serial, record.mileage_km, 1e3 * amplitude)
                    worst, compared = max(worst, abs(found.value - true) / found.std), compared + 1
    assert compared > 10
    assert worst < STDS

"""Jobs that are killed, that meet each other, or that meet damaged data; on both databases."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from due_geometries import due_geometries
from job_process import LEASE_S
from one_database import url_on_sqlite
from sqlalchemy import update
from tiny_fleet import DEAD, WORN, Deployment, results

from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.refresh_geometry import GEOMETRY
from estimation.jobs.settings import EstimationSettings, JobSettings
from estimation.values.reasons import ReasonCode
from estimation.values.runs import JobRun, JobTrigger
from estimation.values.windows import WindowState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.tables.windows import WindowBinTableRow
from ingest.simulator.fleet import FleetReport

SCRIPT = Path(__file__).with_name("job_process.py")
ONE_BY_ONE = EstimationSettings(batch=1)


def context_of(fleet: Deployment, storage: SqlStorage | None = None) -> JobContext:
    return JobContext(storage or fleet.storage, fleet.clock, "test", JobSettings(estimation=ONE_BY_ONE))


def run(fleet: Deployment, job: str, storage: SqlStorage | None = None) -> JobRun:
    return run_job(job_named(job), context_of(fleet, storage), JobTrigger.CLI)


def succeeded(fleet: Deployment, *jobs: str) -> None:
    for job in jobs:
        found = run(fleet, job)
        assert found.outcome == "succeeded", found


def killed(fleet: Deployment, url: str, job: str, commits: int) -> None:
    """Run a job in a process and kill it when it is about to commit for the ``commits``-th time."""
    command = [sys.executable, str(SCRIPT), url, str(fleet.settings.data_dir), job]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for _ in range(commits):
            assert process.stdout.readline() == "not committed\n"
        process.kill()
    assert process.returncode == -signal.SIGKILL
    time.sleep(LEASE_S + 0.1)  # until what it had claimed is free


def estimated(fleet: Deployment) -> tuple[set[tuple[str, int]], set[tuple[str, int]]]:
    """Return the windows that say they are estimated, and those that have a bin table."""
    with fleet.storage.read() as unit:
        windows = [window for serial in (WORN, DEAD) for window in unit.windows.list(serial)]
        tables = {(serial, one.record.start_ns) for serial in (WORN, DEAD) for one in unit.tables.tabled(serial)}
    said = {(w.wheelset, w.start_ns) for w in windows if w.state is WindowState.ESTIMATED}
    return said, tables


@pytest.mark.slow
def test_a_killed_job_leaves_nothing_half_written_and_the_next_run_completes(
    fleet: Deployment, second_fleet: Deployment, storage_url: str, report: FleetReport
) -> None:
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:3])
    # its begin, mileages (claim, result, end), sections, settings, 2 x (claim, result, end), and the third
    killed(fleet, storage_url, "estimate_windows", 14)
    said, tabled = estimated(fleet)
    assert said == tabled
    assert len(said) == 2
    succeeded(fleet, "estimate_windows")
    killed(fleet, storage_url, "refresh_geometry", 3)  # its begin, claim, and what was made of both wheelsets
    with fleet.storage.read() as unit:
        assert due_geometries(unit, GEOMETRY.inputs(context_of(fleet))) == [DEAD, WORN]
        for serial in (DEAD, WORN):
            assert unit.geometries.intervals(serial) == []
            assert unit.geometries.current(serial) is None
        assert [found.outcome for found in unit.jobs.page("refresh_geometry", None, 10)] == ["running"]
    succeeded(fleet, "refresh_geometry")
    succeeded(second_fleet, "estimate_windows", "refresh_geometry")
    assert results(fleet.storage) == results(second_fleet.storage)


@pytest.mark.parametrize("job", ["estimate_windows", "refresh_geometry"])
def test_two_runs_of_a_job_at_once_do_no_harm(
    fleet: Deployment, second_fleet: Deployment, storage_url: str, report: FleetReport, job: str
) -> None:
    before = () if job == "estimate_windows" else ("estimate_windows",)
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:2])
        succeeded(deployed, *before)
    other = SqlStorage(database_engine(storage_url), fleet.settings.data_dir)
    with closing(other), ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(lambda storage: run(fleet, job, storage), (fleet.storage, other)))
    assert [found.outcome for found in runs] == ["succeeded"] * 2, runs
    succeeded(second_fleet, job)
    assert results(fleet.storage) == results(second_fleet.storage)


@pytest.fixture
def received(fleet: Deployment, report: FleetReport) -> Deployment:
    fleet.receive(report.recordings[:1])
    return fleet


@pytest.mark.parametrize("damage", ["cut", "other", "gone"])
@url_on_sqlite
def test_a_damaged_window_is_refused_by_name_and_the_others_go_on(received: Deployment, damage: str) -> None:
    fleet = received
    with fleet.storage.read() as unit:
        victim, other, *_ = unit.windows.list(WORN)
        window = unit.windows.load(WORN, victim.start_ns)
    (path,) = fleet.settings.data_dir.rglob(f"{victim.content_digest}.window")
    (other_path,) = fleet.settings.data_dir.rglob(f"{other.content_digest}.window")
    whole = path.read_bytes()
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(whole[:-100] if damage == "cut" else other_path.read_bytes())
    found = run(fleet, "estimate_windows")
    assert found.outcome == "succeeded"
    assert (found.counts["estimated"], found.counts["refused"]) == (5, 1)
    with fleet.storage.read() as unit:
        refused = unit.windows.get(WORN, victim.start_ns)
    assert refused is not None
    assert refused.state is WindowState.REFUSED
    assert refused.reason is not None
    assert refused.reason.code is ReasonCode.FILE_DAMAGED
    assert path.name in refused.reason.text
    if damage == "gone":  # received again, it is made again and waits again
        with fleet.storage.write() as unit:
            unit.windows.put(window, victim.mileage_km, 1)
        assert run(fleet, "estimate_windows").counts["estimated"] == 1


@url_on_sqlite
def test_a_disk_that_is_not_there_refuses_no_window(received: Deployment) -> None:
    folder = received.settings.data_dir / "windows"
    away = folder.rename(folder.with_name("away"))
    found = run(received, "estimate_windows")
    assert found.outcome == "failed"
    assert str(folder) in (found.error or "")
    away.rename(folder)
    assert run(received, "estimate_windows").counts["estimated"] == 6


def test_a_damaged_bin_table_is_named_and_the_other_wheelsets_go_on(received: Deployment) -> None:
    fleet = received
    succeeded(fleet, "estimate_windows")
    with fleet.storage.read() as unit:
        victim = unit.windows.list(DEAD)[0]  # comes first
    tables = WindowBinTableRow.table
    with fleet.storage.engine.begin() as connection:
        key = (tables.c.wheelset == DEAD, tables.c.start_ns == victim.start_ns)
        connection.execute(update(tables).where(*key).values(packed=b"rubbish"))
    found = run(fleet, "refresh_geometry")
    assert (found.outcome, found.counts["quarantined"]) == ("succeeded", 1)
    with fleet.storage.read() as unit:
        (held,) = unit.quarantine.held("refresh_geometry")
        assert held.key == DEAD
        assert f"{DEAD}@{victim.start_ns}" in held.error
        assert unit.geometries.current(WORN) is not None
        assert unit.geometries.current(DEAD) is None
        assert due_geometries(unit, GEOMETRY.inputs(context_of(fleet))) == [DEAD]


def test_the_shape_of_a_batch_changes_no_result(
    fleet: Deployment, second_fleet: Deployment, report: FleetReport
) -> None:
    for deployed, settings in ((fleet, ONE_BY_ONE), (second_fleet, replace(ONE_BY_ONE, batch=64))):
        deployed.receive(report.recordings[:1])
        context = JobContext(deployed.storage, deployed.clock, "test", JobSettings(estimation=settings))
        assert run_job(job_named("estimate_windows"), context, JobTrigger.CLI).outcome == "succeeded"
    assert results(fleet.storage) == results(second_fleet.storage)


@url_on_sqlite
def test_windows_are_estimated_again_on_a_new_alignment_and_with_other_parameters(received: Deployment) -> None:
    fleet = received
    succeeded(fleet, "estimate_windows", "refresh_geometry")
    assert run(fleet, "estimate_windows").counts["requeued"] == 0
    with fleet.storage.write() as unit:
        track = unit.tracks.alignment("T-3")
        assert track is not None
        unit.tracks.add_alignment(replace(track, alignment=1.001 * track.alignment))
    succeeded(fleet, "refresh_alignment")
    # those whose positions have changed wait already
    assert run(fleet, "estimate_windows").counts["estimated"] == 6
    succeeded(fleet, "refresh_geometry")
    with fleet.storage.read() as unit:
        current = unit.geometries.current(WORN)
    assert current is not None
    assert current.track_versions == {"T-3": (2,)}
    settings = EstimationSettings()
    other = replace(settings, signals=replace(settings.signals, cutoff_wavelength=50.0))
    context = JobContext(fleet.storage, fleet.clock, "test", JobSettings(estimation=other))
    changed = run_job(job_named("estimate_windows"), context, JobTrigger.CLI).counts
    assert (changed["requeued"], changed["estimated"]) == (6, 6)

"""What a wheelset keeps of a year, by kind, before and after a purge with the days that are shipped.

Windows of a simulated recording go through receiver and jobs, and are put again over a year: ``WINDOWS_A_DAY`` of the
960 that 16 hours of running have, over the 960 km of these hours at 60 km/h. Roll-ups, geometries, trends, purge and
sealing are the real ones. Bytes that there are per window are scaled by 960 to ``WINDOWS_A_DAY``; roll-ups are not, for
there is one per 1,000 km. Of geometries and trends the bytes of a version are counted as often as their jobs make one:
each run of 16 hours while every version is kept, and one a day before.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from sqlalchemy import update

from api.factory import SystemClock, job_context, open_store, raw_store
from api.settings import Settings
from bench.report import BenchRow
from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.values.geometry import BinTable
from estimation.values.runs import JobTrigger
from estimation.values.track_epochs import EpochMember, FoldState, TrackEpoch
from estimation.values.windows import Window, WindowPosition, WindowRecord, WindowState
from fleet_db.keeping.purge import purge
from fleet_db.keeping.retention import DAY_NS, Retention
from fleet_db.keeping.table_sizes import database_size
from fleet_db.migrate import upgrade
from fleet_db.models import ChunkRow
from fleet_db.packed_values import pack_geometry
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import run_fleet
from ingest.simulator.scenario_file import load_scenario

DAYS, WINDOWS_A_DAY, ALL_A_DAY = 365, 4, 960
DAYS_AFTER = 10  # of them, after the purge
DAYS_A_RUN = 5  # of the jobs
KM_A_DAY, HOURS_A_DAY = 960.0, 16.0
SERIAL = "WS-1011"
MB = 1e6
REACH_MB = 200.0
GEOMETRIES_A_RUN = 2  # the current one, and that of the newest interval
JOB_S = {"geometries": 300.0, "trends": 300.0}  # a trend follows a geometry
PER_WINDOW = {
    "samples of windows": (),
    "bin tables": ("window_bin_tables",),
    "windows": ("windows", "window_positions", "track_epoch_windows"),
}
PER_INTERVAL = {"roll-ups": ("roll_ups", "roll_up_states", "rolling_sums", "taken_tables")}
VERSIONS = {"geometries": "geometry_estimates", "trends": "trends"}
Bytes = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Original:
    """A window of the recording, with its table and track version."""

    window: Window
    table: BinTable
    version: int | None


def rows() -> Iterator[BenchRow]:
    """Yield the bytes of a wheelset and year by kind, before and after the purge."""
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder), database_url=None, _env_file=None)
        upgrade(settings.url)
        with closing(open_store(settings)) as storage:
            context = job_context(settings, storage)
            year = _Year(context, storage, _recorded(context, storage, settings))
            end_ns = year.put(1, DAYS - DAYS_AFTER)
            before, geometry = _bytes(storage, Retention(every_estimate=None)), _current(storage)
            cpu_s = _purge(storage, end_ns)
            _purge(storage, year.put(DAYS - DAYS_AFTER + 1, DAYS))
            after, same = _bytes(storage, Retention()), geometry <= _current(storage)
            young = _of_the_last_days(storage)
    yield from _report(before, after, young, same=same)
    yield BenchRow("purge of the year", f"{cpu_s:.1f} CPU s", "", met=True)


def _purge(storage: SqlStorage, now_ns: int) -> float:
    """Purge with the shipped days; return its CPU seconds. The files are as old as their windows then."""
    for path in storage.data_dir.rglob("*.window"):
        os.utime(path, (1e9, 1e9))
    clock = time.process_time()
    purge(storage, Retention(), now_ns, lambda: None)
    return time.process_time() - clock


def _report(before: Bytes, after: Bytes, young: Bytes, *, same: bool) -> Iterator[BenchRow]:
    for kind in before:
        left = after[kind] - young.get(kind, 0.0)
        shown = f"{before[kind] / MB:,.1f} -> {after[kind] / MB:,.1f} MB, of which for good {left / MB:,.1f} MB"
        yield BenchRow(f"a wheelset and year: {kind}", shown, "", met=True)
    whole, left = sum(after.values()), sum(after.values()) - sum(young.values())
    yield BenchRow(
        "a year leaves behind when its days of retention are over",
        f"{left / MB:,.1f} MB",
        "200 MB",
        left < REACH_MB * MB,
    )
    yield BenchRow(
        f"all that a wheelset keeps after a year, of {sum(before.values()) / MB:,.0f} MB",
        f"{whole / MB:,.1f} MB",
        "200 MB",
        whole < REACH_MB * MB,
    )
    yield BenchRow("geometry before and after", "the same" if same else "differs", "the same", met=same)


def _recorded(context: JobContext, storage: SqlStorage, settings: Settings) -> Sequence[Original]:
    """Return the windows of the first vehicle's first campaign of demo_single on surveyed track, estimated."""
    plan = load_scenario("demo_single")
    plan = replace(
        plan,
        vehicles=plan.vehicles[:1],
        sessions=replace(plan.sessions, campaigns=1),
        section=replace(plan.section, surveyed=True),
    )
    with tempfile.TemporaryDirectory() as folder:
        report = run_fleet(plan, Path(folder), workers=1)
        with storage.write() as unit:
            load_registry(report.registry, unit, 1)
        receiver = Receiver(
            storage, raw_store(settings), default_catalogue(), SystemClock(), window_length_s=settings.window_length_s
        )
        for recording in report.recordings:
            receiver.receive_file(recording.path, recording.vehicle)
    for name in ("refresh_alignment", "estimate_windows"):
        run_job(job_named(name), context, JobTrigger.CLI)
    with storage.read() as unit:
        found = [
            Original(unit.windows.load(SERIAL, record.start_ns), table, version)
            for record, table, version in unit.tables.stream(SERIAL, 0, None)
        ]
    assert found, "no window of the recording was estimated"
    return found


@dataclass(slots=True)
class _Year:
    """Windows of a recording put over days, with what the jobs store of them."""

    context: JobContext
    storage: SqlStorage
    originals: Sequence[Original]
    newest: WindowRecord = field(init=False)

    def __post_init__(self) -> None:
        with self.storage.read() as unit:
            newest = unit.windows.latest(SERIAL)
        assert newest is not None
        self.newest = newest

    def put(self, first: int, last: int) -> int:
        """Put the windows of some days and run the jobs; return our time at the end, ns UTC."""
        at_ns = 0
        for day in range(first, last + 1):
            at_ns = self._put_day(day)
            if day % DAYS_A_RUN == 0 or day == last:
                at = replace(self.context, clock=_At(at_ns))
                for name in ("refresh_geometry", "refresh_trends"):
                    run_job(job_named(name), at, JobTrigger.CLI)
        with self.storage.write() as unit:  # the age of windows is counted from the newest recording
            unit.connection.execute(update(table_of(ChunkRow)).values(last_ns=at_ns))
        return at_ns + DAY_NS // 2

    def _put_day(self, day: int) -> int:
        """Put the windows of a day, placed and of an epoch; return the start of the last."""
        section = self.newest.track_section
        assert section is not None
        with self.storage.write() as unit:
            members = [self._put_window(unit, day, number) for number in range(WINDOWS_A_DAY)]
            last_ns = members[-1].record.start_ns
            version = self.originals[0].version
            epoch = TrackEpoch(
                section, len(unit.epochs.list(section)) + 1, "b" * 64, "d" * 64, last_ns, len(members), waits=False,
                after=FoldState(version, version), estimated_on=version, report=0, recorded_ns=last_ns,
            )  # fmt: skip
            unit.epochs.put(epoch, members)
        return last_ns

    def _put_window(self, unit: SqlUnitOfWork, day: int, number: int) -> EpochMember:
        one = self.originals[(day + number) % len(self.originals)]
        part = number / WINDOWS_A_DAY
        start_ns = self.newest.start_ns + day * DAY_NS + round(part * HOURS_A_DAY * 3600) * 1_000_000_000
        unit.windows.put(
            replace(one.window, start_ns=start_ns), self.newest.mileage_km + (day + part) * KM_A_DAY, start_ns
        )
        record = unit.windows.get(SERIAL, start_ns)
        assert record is not None
        unit.tables.put(SERIAL, start_ns, one.table, one.version, record.content_digest)
        unit.windows.mark(SERIAL, start_ns, WindowState.ESTIMATED)
        unit.tracks.put_position(WindowPosition(SERIAL, start_ns, record.content_digest, one.version))
        return EpochMember(record, "c" * 64, "a" * 64)


@dataclass(frozen=True, slots=True)
class _At:
    """A clock that stands."""

    at_ns: int

    def now_ns(self) -> int:
        """Return the time, ns UTC."""
        return self.at_ns


def _bytes(storage: SqlStorage, retention: Retention) -> dict[str, float]:
    """Return the bytes of a wheelset and year by kind."""
    with storage.read() as unit:
        tables = database_size(unit.connection, 1 << 40).tables
    scale = ALL_A_DAY / WINDOWS_A_DAY
    size = {name: float(one.table_bytes + one.index_bytes) for name, one in tables.items()}
    found = {kind: scale * sum(size[name] for name in names) for kind, names in PER_WINDOW.items()}
    found["samples of windows"] = scale * sum(path.stat().st_size for path in storage.data_dir.rglob("*.window"))
    found |= {kind: sum(size[name] for name in names) for kind, names in PER_INTERVAL.items()}
    every_days = DAYS if retention.every_estimate is None else retention.every_estimate
    for kind, name in VERSIONS.items():
        a_day = HOURS_A_DAY * 3600 / JOB_S[kind]
        days = every_days * a_day + DAYS - every_days
        versions = days * (GEOMETRIES_A_RUN if kind == "geometries" else 1)
        found[kind] = versions * size[name] / max(tables[name].rows, 1)
    return found


def _of_the_last_days(storage: SqlStorage) -> dict[str, float]:
    """Return the bytes that go when the days of retention of what is there are over."""
    kept = _bytes(storage, Retention())
    with storage.read() as unit:
        tables = database_size(unit.connection, 1 << 40).tables
        rows_of = {name: tables[name].table_bytes + tables[name].index_bytes for name in PER_WINDOW["windows"]}
    once = _bytes(storage, Retention(every_estimate=1e-9))
    places = rows_of["window_positions"] + rows_of["track_epoch_windows"]
    return {
        "samples of windows": kept["samples of windows"],
        "bin tables": kept["bin tables"],
        "windows": places * ALL_A_DAY / WINDOWS_A_DAY,
        **{kind: kept[kind] - once[kind] for kind in VERSIONS},
    }


def _current(storage: SqlStorage) -> frozenset[tuple[int | None, bytes]]:
    """Return the geometries of the intervals that are over, as they are stored."""
    with storage.read() as unit:
        found = unit.geometries.intervals(SERIAL)
    return frozenset((one.interval, pack_geometry(one.geometry)) for one in found[: DAYS - DAYS_AFTER - 20])

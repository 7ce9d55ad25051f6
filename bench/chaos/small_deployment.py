"""A deployment of one vehicle with two wheelsets, small enough to be broken hundreds of times; on either database."""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import psycopg
import sqlalchemy
from psycopg import sql

from api.factory import SystemClock, open_store, process_name, raw_store
from api.pipeline import job_context, receiver, scheduled_jobs
from api.settings import Settings
from bench.chaos.final_state import final_state
from bench.services import created
from estimation.jobs.job import run_job
from estimation.values.runs import JobOutcome, JobTrigger
from fleet_db.keeping.checks import check_deep
from fleet_db.keeping.kept_files import orphaned_recordings
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
from ingest.frames import take
from ingest.logs import write_blf
from ingest.vehicle_class_schema import shipped_class
from tests.ingest.vehicle_bus import START_NS, VEHICLE, Run, register
from tests.postgres_server import SAFE, PostgresServer, stoppable_server

WINDOW_S = 10.0
OF_RECEIVED = ("receipts", "windows", "bin tables", "geometries")
"""What is a function of what was received: not when it was stored, and in which order."""


@dataclass(frozen=True, slots=True)
class Databases:
    """A migrated SQLite file and a running PostgreSQL with a migrated database, both to be copied from."""

    folder: Path
    server: PostgresServer

    def new(self, kind: str) -> Settings:
        """Return the settings of a new deployment on ``sqlite`` or ``postgresql``, with its vehicle registered."""
        name = f"d{uuid.uuid4().hex[:12]}"
        home = self.folder / name
        home.mkdir()
        if kind == "sqlite":
            shutil.copyfile(self.folder / "migrated.sqlite", home / "treadwatch.sqlite")
            url = f"sqlite:///{home / 'treadwatch.sqlite'}"
        else:
            url = created(self.server.url, name, "migrated", PASSWORD)
        settings = Settings(database_url=url, data_dir=home, window_length_s=WINDOW_S, port=0, _env_file=None)
        with closing(open_store(settings)) as storage, storage.write() as unit:
            register(unit)
            unit.registry.add_vehicle_class(replace(shipped_class("coach"), code="multiple unit"), 1)
        return settings

    def drop(self, settings: Settings) -> None:
        """Remove a deployment."""
        shutil.rmtree(settings.data_dir)
        if not settings.url.startswith("sqlite"):
            name = str(sqlalchemy.make_url(settings.url).database)
            with psycopg.connect(self.server.url, autocommit=True) as connection:
                connection.execute(sql.SQL("DROP DATABASE {} WITH (FORCE)").format(sql.Identifier(name)))


@contextmanager
def databases(folder: Path) -> Iterator[Databases]:
    """Yield both databases, for the deployments of a part."""
    upgrade(f"sqlite:///{folder / 'migrated.sqlite'}")
    with stoppable_server(SAFE) as server:
        upgrade(created(server.url, "migrated", password=PASSWORD))
        yield Databases(folder, server)


PASSWORD = "not-for-the-log-4711"  # noqa: S105 - the server trusts everybody; it is looked for in the logs


def recordings(folder: Path, cuts: Sequence[float], seconds: float, start_ns: int = START_NS) -> list[Path]:
    """Write one journey of the vehicle as recordings that follow each other; cuts are shares of its frames."""
    frames = Run(seconds=seconds, start_ns=start_ns).frames()
    edges = [0, *sorted(round(cut * len(frames)) for cut in cuts), len(frames)]
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, (first, last) in enumerate(pairwise(edges)):
        if last > first:
            paths.append(folder / f"{VEHICLE}__{number:03}.blf")
            write_blf(paths[-1], take(frames, slice(first, last)))
    return paths


def ingest(settings: Settings, paths: Sequence[Path]) -> list[object]:
    """Receive recordings as ``treadwatch ingest`` does: what was left over first; return their outcomes."""
    with closing(open_store(settings)) as storage:
        taking = receiver(settings, storage, SystemClock())
        left = list(taking.decode_stored())
        taking.reassembler.work_off()
        return [*left, *(outcome for _, outcome in taking.receive_files([(path, VEHICLE) for path in paths]))]


def fork(work: Callable[[], object], log: Path) -> int:
    """Run ``work`` in a process of its own, which imports nothing again; return its number."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        work()
        code = 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    except BaseException as error:  # noqa: BLE001 - it is written where the part looks for it
        os.write(2, f"ended by {type(error).__name__}: {error}\n".encode())
    os._exit(code)


def wait_for(pids: Sequence[int]) -> list[int]:
    """Wait for processes to end; return their exit codes."""
    return [os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in pids]


def state(storage: SqlStorage) -> dict[str, str]:
    """Return digests of receipts, windows, bin tables, and geometries."""
    found = final_state(storage)
    return {name: found[name] for name in OF_RECEIVED}


def damaged(settings: Settings, storage: SqlStorage) -> list[str]:
    """Return what a deep check finds that is not harmless."""
    found = check_deep(storage, raw_store(settings), lambda _done, _total: None).findings
    return [str(one) for one in found if not one.harmless]


def faults(settings: Settings, storage: SqlStorage) -> list[str]:
    """Return what is wrong with a deployment in itself: torn files, rows without theirs, raw orphans, open runs."""
    raw = raw_store(settings)
    wrong = damaged(settings, storage)
    wrong += [f"orphaned: {one.place}" for one in orphaned_recordings(storage, raw, 0.0) if one.digest]
    with storage.read() as unit:
        windows = [(w.wheelset, w.start_ns) for axle in (1, 2) for w in unit.windows.list(f"WS-{axle}")]
        runs = unit.jobs.page(None, None, 1000)
    wrong += ["doubled window"] * (len(windows) - len(set(windows)))
    return wrong + ["a run without an end"] * sum(run.outcome is JobOutcome.RUNNING for run in runs)


def compared(
    both: Databases, broken: Settings, alone: Settings, paths: Sequence[Path], *, keep: bool = False
) -> list[str]:
    """Bring both to rest; return what differs, and what is wrong with the broken one in itself; both are removed."""
    log = both.folder / "end.log"
    ends = [wait_for([fork(partial(_to_the_end, deployment, paths), log)]) for deployment in (broken, alone)]
    wrong = ["the end was not reached"] * sum(codes != [0] for codes in ends)
    with closing(open_store(broken)) as first, closing(open_store(alone)) as second:
        was, should = state(first), state(second)
        wrong += [name for name in was if was[name] != should[name]] + faults(broken, first)
    for deployment in () if keep else (broken, alone):
        both.drop(deployment)
    return wrong


def _to_the_end(settings: Settings, paths: Sequence[Path]) -> None:
    ingest(settings, paths)
    estimate(settings)


def estimate(settings: Settings) -> None:
    """Run the jobs once, as ``treadwatch estimate`` does."""
    with closing(open_store(settings)) as storage:
        context = job_context(settings, storage)
        with storage.owned(JobTrigger.CLI, process_name(), context.lease_s) as owned:
            for job in scheduled_jobs(settings):
                run_job(job, job_context(settings, owned), JobTrigger.CLI)


def newest_run(settings: Settings) -> int:
    """Return the number of the newest run of a job."""
    with closing(open_store(settings)) as storage, storage.read() as unit:
        return max((run.run_id for run in unit.jobs.page(None, None, 1)), default=0)

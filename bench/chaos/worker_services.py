"""The services of a deployment with many workers, as real processes that may be harmed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import sqlalchemy
from sqlalchemy import select

from api.settings import Settings
from bench.chaos.cuttable_link import CuttableLink
from bench.chaos.small_deployment import until
from bench.dask_cluster import DaskCluster, dask_cluster
from bench.service_environment import environment_of
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.operation import WorkClaimRow, WorkLeaseRow

PROCESSES, DASK_WORKERS = 4, 2
LEASE_S = 2.0
EVERY_S = 2.0
START_S = 120.0
AT_WORK_S = 40.0
SCHEDULE = "from api.cli import main; main()"
QUICK = {"lease_s": LEASE_S, "jobs_every_s": EVERY_S, "database_silence_s": 1.0, "database_connect_timeout_s": 2}
KEPT = '[days]\nwindow_samples = "for ever"\nwindow_bin_tables = "for ever"\n'
"""The recordings are older than what is kept by default, and a purge would leave nothing to compare."""
CLAIMS, LEASES = table_of(WorkClaimRow), table_of(WorkLeaseRow)


@dataclass
class Services:
    """The scheduler of a deployment and its workers.

    Attributes:
        storage: Of the deployment, which nothing cuts off.
        settings: Of the processes.
        log: Of the scheduler.
        link: To the database; None with SQLite.
        cluster: Of Dask; None with processes of this machine.
    """

    storage: SqlStorage
    settings: Settings
    log: Path
    link: CuttableLink | None
    cluster: DaskCluster | None
    scheduler: subprocess.Popen[bytes] | None = field(default=None)

    def start_scheduler(self) -> None:
        """Start ``treadwatch schedule`` and wait until it has started."""
        before = self.said().count("scheduler started")
        with self.log.open("ab") as log:
            self.scheduler = subprocess.Popen(  # noqa: S603 - our own command
                [sys.executable, "-c", SCHEDULE, "schedule", "--wait"],
                env=environment_of(self.settings),
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        assert until(lambda: self.said().count("scheduler started") > before, START_S) is not None, self.said()

    def end_scheduler(self, number: signal.Signals) -> None:
        """Send a signal to the scheduler, and wait until it has ended."""
        assert self.scheduler is not None
        self.scheduler.send_signal(number)
        self.scheduler.wait(START_S)
        self.scheduler = None

    def said(self) -> str:
        """Return what the scheduler and the workers of Dask have written."""
        own = self.log.read_text(errors="replace") if self.log.exists() else ""
        return own + ("" if self.cluster is None else self.cluster.log("workers"))

    def at_work(self) -> list[int]:
        """Return the processes that hold claims and live, within some seconds; empty where none does."""
        give_up_s = time.monotonic() + AT_WORK_S
        while time.monotonic() < give_up_s:
            with self.storage.read() as unit:
                chosen = select(LEASES.c.holder).join(CLAIMS, CLAIMS.c.lease_id == LEASES.c.lease_id).distinct()
                holders = unit.connection.scalars(chosen).all()
            found = [int(match[1]) for holder in holders if (match := re.search(r"process (\d+)", holder))]
            if living := sorted(pid for pid in found if _lives(pid) and pid != self._scheduler_pid):
                return living
            time.sleep(0.01)
        return []

    def family(self) -> list[int]:
        """Return the scheduler with all processes that it has started."""
        found = [] if self._scheduler_pid is None else [self._scheduler_pid]
        for pid in found:
            with suppress(OSError):
                for children in Path(f"/proc/{pid}/task").glob("*/children"):
                    found += map(int, children.read_text(encoding="ascii").split())
        return found

    @property
    def _scheduler_pid(self) -> int | None:
        return None if self.scheduler is None else self.scheduler.pid


@contextmanager
def services(storage: SqlStorage, settings: Settings, folder: Path, *, dask: bool) -> Iterator[Services]:
    """Yield the running services of a deployment; none is left at the end.

    Args:
        folder: Of the logs; the database of a server is reached through a link.
        dask: Whether workers of Dask work, in place of processes of the scheduler.
    """
    kept = folder / "retention.toml"
    kept.write_text(KEPT, encoding="utf-8")
    chosen = settings.model_copy(update={**QUICK, "retention_file": kept})
    with ExitStack() as stack:
        link = None
        if settings.on_server:
            url = sqlalchemy.make_url(settings.url)
            link = CuttableLink(Path(str(url.query["host"])) / ".s.PGSQL.5432")
            stack.callback(link.close)
            linked = url.set(host="127.0.0.1", port=link.port, query={}).render_as_string(hide_password=False)
            chosen = chosen.model_copy(update={"database_url": linked})
        cluster = None
        if dask:
            cluster = stack.enter_context(dask_cluster(chosen, folder / "dask", DASK_WORKERS))
            chosen = chosen.model_copy(update={"dask_scheduler": cluster.address})
        else:
            chosen = chosen.model_copy(update={"workers": PROCESSES})
        found = Services(storage, chosen, folder / "scheduler.log", link, cluster)
        try:
            found.start_scheduler()
            yield found
        finally:
            for pid in found.family():
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            if found.scheduler is not None:
                found.scheduler.wait(START_S)


def _lives(pid: int) -> bool:
    try:
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False

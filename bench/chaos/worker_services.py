"""The services of a deployment with many workers, as real processes that may be harmed."""

from __future__ import annotations

import os
import re
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path

import sqlalchemy
from sqlalchemy import select

from api.settings import Settings
from bench.measuring import tree
from bench.services import START_S, DaskCluster, dask_cluster, started, until
from bench.small_fleets import kept_for_ever
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.operation import WorkClaimRow, WorkLeaseRow

RESET = struct.pack("ii", 1, 0)  # close without a farewell, as a network does


class Cut(Enum):
    """How a process is cut off: its connections are closed and refused, or stay and nothing comes through."""

    CLOSED = auto()
    SILENT = auto()


@dataclass(slots=True, eq=False)
class _Connection:
    """Both ends; what arrives at one goes out at the other while ``through`` is set, and waits otherwise."""

    client: socket.socket
    server: socket.socket
    through: threading.Event = field(default_factory=threading.Event)

    def close(self) -> None:
        for end in (self.client, self.server):
            with suppress(OSError):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self.through.set()


class CuttableLink:
    """Listens on loopback and hands on what comes to the socket file of a server."""

    def __init__(self, server: Path) -> None:
        self._server = server
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=128)
        self._cut: dict[int, Cut] = {}
        self._connections: set[_Connection] = set()
        self._lock = threading.Lock()
        threading.Thread(target=self._accept, name="link", daemon=True).start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listening.getsockname()[1])

    def cut_off(self, pid: int, how: Cut) -> int:
        """Cut a process off until it is restored; return how many connections it had."""
        with self._lock:
            self._cut[pid] = how
            found = self._of({pid: how})
        for one in found:
            one.close() if how is Cut.CLOSED else one.through.clear()
        return len(found)

    def restore(self, pid: int) -> None:
        """Let a process through again; what waited on silent connections arrives late."""
        with self._lock:
            found = self._of({pid: self._cut.pop(pid)})
        for one in found:
            one.through.set()

    def close(self) -> None:
        """End all connections."""
        self._listening.close()
        with self._lock:
            left = list(self._connections)
        for one in left:
            one.close()

    def _of(self, cut: Mapping[int, Cut]) -> list[_Connection]:
        ports = {port for pid in cut for port in _ports_of(pid)}
        return [one for one in self._connections if _peer(one.client) in ports]

    def _accept(self) -> None:
        while True:
            try:
                client, (_, port) = self._listening.accept()
            except OSError:
                return
            server = socket.socket(socket.AF_UNIX)
            try:
                server.connect(str(self._server))
            except OSError:  # the server is away
                client.close()
                server.close()
                continue
            self._begin(_Connection(client, server), port)

    def _begin(self, one: _Connection, port: int) -> None:
        with self._lock:
            how = next((how for pid, how in self._cut.items() if port in _ports_of(pid)), None)
            if how is not Cut.CLOSED:
                self._connections.add(one)
        if how is Cut.CLOSED:
            one.close()
            return
        if how is None:
            one.through.set()
        for source, sink in ((one.client, one.server), (one.server, one.client)):
            threading.Thread(target=self._hand_on, args=(one, source, sink), name="link", daemon=True).start()

    def _hand_on(self, one: _Connection, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while content := source.recv(65536):
                one.through.wait()
                sink.sendall(content)
        one.through.wait()
        with self._lock:
            self._connections.discard(one)
        one.close()


def _peer(end: socket.socket) -> int | None:
    try:
        return int(end.getpeername()[1])
    except OSError:
        return None


def _ports_of(pid: int) -> set[int]:
    inodes = set()
    with suppress(OSError):  # it is gone
        for file in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                inodes.add(str(file.readlink()).removeprefix("socket:[").removesuffix("]"))
    lines = Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]
    columns = [line.split() for line in lines]
    return {int(one[1].rpartition(":")[2], 16) for one in columns if one[9] in inodes}


PROCESSES, DASK_WORKERS = 4, 2
LEASE_S = 2.0
EVERY_S = 2.0
AT_WORK_S = 40.0
QUICK = {"lease_s": LEASE_S, "jobs_every_s": EVERY_S, "database_silence_s": 1.0, "database_connect_timeout_s": 2}
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
        self.scheduler = started(self.settings, "schedule", "--wait", log=self.log)
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
        return [] if self._scheduler_pid is None else tree(self._scheduler_pid)

    @property
    def _scheduler_pid(self) -> int | None:
        return None if self.scheduler is None else self.scheduler.pid


@contextmanager
def services(storage: SqlStorage, settings: Settings, folder: Path, *, dask: bool) -> Iterator[Services]:
    """Yield the running services of a deployment; none is left at the end.

    The database of a server is reached through a link. With ``dask`` its workers work, not those of the scheduler.
    """
    chosen = settings.model_copy(update={**QUICK, "retention_file": kept_for_ever(folder)})
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

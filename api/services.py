"""What the routes work with: one value a process, built by the factory; places to write, and jobs that are run now."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Annotated, cast

from fastapi import Depends, Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool

from api.access.gate import CallerDep
from api.accuracy import ContactCache
from api.answers import RepresentationCache
from api.uploads import Uploads
from estimation.errors import BusyError, ConflictError, NotFoundError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.storage import Clock
from estimation.values.runs import JobOutcome, JobRun, JobTrigger
from fleet_db.raw import RawStore
from fleet_db.rows import present
from fleet_db.session import BUSY_TIMEOUT_MS
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.topic.references import Publisher

MOST_WAITING = 16  # requests that may wait for a slot; more are refused at once

PATIENCE_S = 3.0  # how long a request waits for a slot, and in it for other processes that write


class WriterSlots:
    """Places for requests that write: they wait on the event loop, and not for long; reads never wait for them.

    A request that waits in a thread keeps the thread from those that read: two writers in a queue for a stuck one held
    up everything on the embedded database, which has two threads.
    """

    def __init__(self, at_once: int, patience_s: float) -> None:
        self._slots = asyncio.Semaphore(at_once)
        self._patience_s = patience_s
        self._most = at_once + MOST_WAITING
        self._present = 0

    @asynccontextmanager
    async def slot(self) -> AsyncIterator[None]:
        """Hold a place."""
        if self._present >= self._most:
            raise BusyError(f"{self._present} requests write or wait for it already")
        self._present += 1
        try:
            try:
                await asyncio.wait_for(self._slots.acquire(), self._patience_s)
            except TimeoutError:
                raise BusyError(f"other requests have been writing for {self._patience_s:g} s") from None
            try:
                yield
            finally:
                self._slots.release()
        finally:
            self._present -= 1


class JobRunner:
    """Runs one job at a time, in a thread of its own; built by the factory, closed with the app."""

    def __init__(self, context: JobContext, storage: SqlStorage, holder: str) -> None:
        self._holder = holder
        self._stopping = threading.Event()
        self._storage = storage
        self._context = replace(context, stopping=self._stopping.is_set)
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="job")
        self._starting = threading.Lock()
        self._running: Future[JobRun] | None = None

    def start(self, job: Job) -> JobRun:
        """Start a run and return its record as soon as it is committed; refused while it, or another one here, runs."""
        with self._starting:
            if self._running is not None and not self._running.done():
                raise ConflictError("a job that was started here is still running", kind="job", key=job.name)
            with self._storage.read() as unit:
                latest = unit.jobs.page(job.name, None, 1)
            for run in latest:
                if run.outcome is JobOutcome.RUNNING:
                    reason = f"job {job.name} is running (run {run.run_id})"
                    raise ConflictError(reason, kind="job-run", key=str(run.run_id))
            begun: Future[JobRun] = Future()
            self._running = self._executor.submit(self._run, job, begun)
            wait([begun, self._running], return_when=FIRST_COMPLETED)
            return begun.result() if begun.done() else self._running.result()

    def _run(self, job: Job, begun: Future[JobRun]) -> JobRun:
        with self._storage.owned(JobTrigger.API, self._holder, self._context.lease_s) as owned:
            patient = replace(owned, patience_s=BUSY_TIMEOUT_MS / 1000)  # requests do not wait for the job
            return run_job(job, replace(self._context, storage=patient), JobTrigger.API, started=begun.set_result)

    def close(self) -> None:
        """Ask the running job to stop at its next checkpoint and wait for it."""
        self._stopping.set()
        self._executor.shutdown(wait=True, cancel_futures=True)


@dataclass(frozen=True, slots=True)
class Services:
    """Database, raw recordings, time and jobs.

    ``check`` raises where the database is unreachable or at another migration; ``close`` closes the storage.
    """

    storage: SqlStorage
    raw: RawStore
    clock: Clock
    jobs: Mapping[str, Job]
    runner: JobRunner
    check: Callable[[], None]
    close: Callable[[], None]
    writers: WriterSlots
    cache: RepresentationCache
    uploads: Uploads
    references: Publisher | None  # of received chunks, where a topic is set
    one_reader: bool  # an embedded database, whose reads slow each other down in threads
    contacts: ContactCache = field(default_factory=ContactCache)

    def job(self, name: str) -> Job:
        """Return the job of this name."""
        return present(self.jobs.get(name), "job", name)


async def services_of(request: Request, caller: CallerDep) -> Services:
    """Return what the factory built; its storage shows the caller's fleets only."""
    services = cast("Services", request.app.state.services)
    return replace(services, storage=services.storage.seen_by(caller.fleets))


ServicesDep = Annotated[Services, Depends(services_of)]


async def writer_slot(services: ServicesDep) -> AsyncIterator[None]:
    """Hold a place among the requests that write; for the routes that do."""
    async with services.writers.slot():
        yield


def require_known(
    unit: SqlUnitOfWork,
    *,
    fleet: str | None = None,
    vehicle: str | None = None,
    wheelset: str | None = None,
    vehicle_class: str | None = None,
    fleet_alert: int | None = None,
) -> None:
    """Refuse filters that name nothing; to be asked where a page is empty, for one with rows shows that they do."""
    if fleet is not None and all(record.code != fleet for record in unit.registry.fleets()):
        raise NotFoundError("fleet", fleet)
    if vehicle is not None:
        unit.registry.vehicle(vehicle)
    if wheelset is not None:
        unit.registry.wheelset(wheelset)
    if vehicle_class is not None:
        present(unit.registry.vehicle_class(vehicle_class), "vehicle class", vehicle_class)
    if fleet_alert is not None and unit.alerts.get(fleet_alert).wheelset is not None:
        raise NotFoundError("fleet alert", str(fleet_alert))


def require_fleets(storage: SqlStorage, fleets: Iterable[str]) -> None:
    """Refuse a filter of fleets that are not there, or that the caller does not see: nothing would ever come."""
    if fleets:
        with storage.read() as unit:
            for fleet in sorted(fleets):
                require_known(unit, fleet=fleet)


Find = Callable[[SqlUnitOfWork, str], object]
_READING = frozenset({"GET", "HEAD"})


def _numbered(look_up: Callable[[SqlUnitOfWork, int], object]) -> Find:
    def find(unit: SqlUnitOfWork, text: str) -> object:
        return look_up(unit, int(text)) if text.isdecimal() and int(text) < 2**63 else None  # the route refuses others

    return find


SHARED: Find = lambda _unit, _name: None  # noqa: E731 - a name for what needs no look
FINDERS: Mapping[str, Find] = {
    "/v1/alerts/{alert_id}": _numbered(lambda unit, number: unit.alerts.get(number)),
    "/v1/fleets/{code}": lambda unit, code: require_known(unit, fleet=code),
    "/v1/vehicles/{code}": lambda unit, code: unit.registry.vehicle(code),
    "/v1/wheelsets/{serial}": lambda unit, serial: unit.registry.wheelset(serial),
    "/v1/jobs/{name}": SHARED,
    "/v1/keys/{prefix}": SHARED,
    "/v1/recordings/{digest}": lambda unit, digest: present(unit.chunks.get(digest), "recording", digest),
    "/v1/chunks/{sha256}": SHARED,  # it need not be there yet; the route looks at its vehicle
    "/v1/webhooks/{webhook_id}": _numbered(lambda unit, number: unit.webhooks.get(number)),
}
"""How the first object in a path is found, by the template of the path up to it."""


async def visible(request: Request, services: ServicesDep, caller: CallerDep) -> None:
    """Refuse a change to something that its caller does not see, as if it did not exist."""
    route: APIRoute = request.scope["route"]
    if caller.fleets is None or request.method in _READING or not request.path_params:
        return
    template, find = finder_of(route.path_format)
    name = template.rsplit("{", maxsplit=1)[-1].rstrip("}")

    def look() -> None:
        with services.storage.read() as unit:
            find(unit, request.path_params[name])

    await run_in_threadpool(look)


def finder_of(path: str) -> tuple[str, Find]:
    """Return the template of the first object in a path, and how it is found."""
    template = path[: path.index("}") + 1]
    if template not in FINDERS:
        raise LookupError(f"api/services.py does not say how {template} is found")
    return template, FINDERS[template]

"""What the routes work with: one value a process, built by the factory."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, cast

from fastapi import Depends, Request

from api.access.caller import CallerDep
from api.accuracy import ContactCache
from api.answers import RepresentationCache
from api.job_runner import JobRunner
from api.uploads.taking import Uploads
from api.writer_slots import WriterSlots
from estimation.errors import NotFoundError
from estimation.jobs.job import Job
from estimation.storage import Clock
from fleet_db.raw import RawStore
from fleet_db.storage import SqlStorage
from ingest.topic.publishing import Publisher


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
        """Return the job of this name.

        Raises:
            NotFoundError: There is none.
        """
        try:
            return self.jobs[name]
        except KeyError:
            raise NotFoundError("job", name) from None


async def services_of(request: Request, caller: CallerDep) -> Services:
    """Return what the factory built; its storage shows the caller's fleets only."""
    services = cast("Services", request.app.state.services)
    return replace(services, storage=services.storage.seen_by(caller.fleets))


ServicesDep = Annotated[Services, Depends(services_of)]


async def writer_slot(services: ServicesDep) -> AsyncIterator[None]:
    """Hold a place among the requests that write; for the routes that do.

    Raises:
        BusyError: None became free in time.
    """
    async with services.writers.slot():
        yield

"""The composition root: settings become a store, a clock, a job context, an app."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import unquote, urlsplit

from api.logs import traced
from api.rules_file import load_rules
from api.settings import PREFIX, Settings, known_sections, load_retention
from estimation.alerts.rule_book import RuleBook
from estimation.errors import InputError, MigrationError, ParameterError, StorageError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import Job, JobContext
from estimation.jobs.settings import JobSettings, KnownSection, RailsSettings
from estimation.numerics_version import NUMERICS_VERSION
from estimation.rails.cell import RailsParameters
from estimation.storage import Clock
from estimation.values.units import SECOND_NS
from fleet_db.keeping.purge import purge_job
from fleet_db.keeping.retention import Retention
from fleet_db.migrate import check_head
from fleet_db.raw import FileRawStore, RawStore
from fleet_db.session import ServerLimits, database_engine
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.intake.backlog import BacklogLimits, BacklogWatch, assemble_windows
from ingest.live.status import Backoff
from ingest.own_bus.loading import load_own_bus
from ingest.reassembly import ASSEMBLY
from ingest.receipts import Announce, ChunkStorage, to_nobody
from ingest.receiver import Receiver
from ingest.stored_settings import bus_choice, check_window_length, claim
from ingest.topic.client import Topic, load_properties
from ingest.topic.references import Publisher
from ingest.vehicle_class_schema import class_of_package

if TYPE_CHECKING:
    import uvicorn
    from fastapi import FastAPI

    from api.services import Services


Client = TypeVar("Client")


def topic_of(settings: Settings) -> Topic | None:
    """Return the topic; None where no brokers are set. An error in its properties names the line, never a value."""
    if settings.kafka_servers is None:
        return None
    properties = {} if settings.kafka_properties is None else load_properties(settings.kafka_properties)
    return Topic(settings.kafka_servers, settings.kafka_topic, properties)


def publisher(settings: Settings, storage_of: Callable[[], SqlStorage | None]) -> Publisher | None:
    """Return what publishes references to received chunks; None where no brokers are set."""

    def fleet_of(vehicle: str) -> str:
        storage = storage_of()
        if storage is None:
            return ""
        with storage.read() as unit:
            return unit.registry.vehicle(vehicle).fleet

    topic = topic_of(settings)
    return None if topic is None else with_named_setting(lambda: Publisher(topic, fleet_of))


@contextmanager
def publishing(settings: Settings, storage_of: Callable[[], SqlStorage | None]) -> Iterator[Announce]:
    """Yield what announces receipts on the topic, to nobody where none is set; what waits at the end is published."""
    references = publisher(settings, storage_of)
    if references is None:
        yield to_nobody
        return
    with closing(references):
        yield references.publish


def with_named_setting(make: Callable[[], Client]) -> Client:
    """Return a client; a refusal of its configuration names the setting."""
    try:
        return make()
    except InputError as error:
        raise ParameterError(error.reason, field=f"{PREFIX}KAFKA_PROPERTIES") from None


FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 10.0  # between attempts to reach it; each is twice the one before

Service = TypeVar("Service")

_log = logging.getLogger(__name__)


def once_the_database_answers(make: Callable[[], Service], settings: Settings, stopping: Event) -> Service | None:
    """Return what needs the database as soon as a server answers, SQLite at once; None after a stop."""
    delays, waited = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S), False
    while not stopping.is_set():
        try:
            made = make()
        except MigrationError:
            raise
        except StorageError as error:
            if not settings.on_server:
                raise
            if not waited:
                _log.warning("the start waits for the database: %s", error)
            waited = True
        else:
            if waited:
                _log.info("the database answers, the start goes on")
            return made
        stopping.wait(delays.failed())
    return None


MEGABYTE = 1_000_000
RECEIPT_PATIENCE_S = 20.0  # how long receipts of uploads wait for another process that writes to the embedded database
AT_ONCE_S = 1.0  # a database server that answers within this time is there before the REST API listens
WRITERS = 16  # requests that write at once on a database server; the others are left for those that read


class SystemClock:
    """The machine's clock."""

    def now_ns(self) -> int:
        """Return nanoseconds UTC since the Unix epoch."""
        return time.time_ns()


def code_version() -> str:
    """Return what estimates carry as provenance: the version of the numerics.

    Two estimates with the same code version came from the same mathematics, also between releases.
    """
    return f"numerics {NUMERICS_VERSION}"


def process_name(number: int | None = None) -> str:
    """Return what others read of a process of this machine where it holds something."""
    return f"{socket.gethostname()}, process {os.getpid() if number is None else number}"


def open_store(settings: Settings) -> SqlStorage:
    """Return the store of this deployment; refused at another migration, of other windows, or out of reach."""
    limits = ServerLimits(
        settings.database_connect_timeout_s, settings.database_silence_s, settings.database_statement_timeout_s
    )
    storage = SqlStorage(database_engine(settings.url, limits), settings.data_dir, class_of_package)
    try:
        check_head(storage.engine)
        with storage.read() as unit:
            check_window_length(unit, _length_ns(settings))
    except ParameterError as error:
        storage.close()
        raise ParameterError(error.reason, field=f"{PREFIX}WINDOW_LENGTH_S") from None
    except Exception:
        storage.close()
        raise
    return storage


def raw_store(settings: Settings) -> RawStore:
    """Return where raw recordings are kept; a bucket is not asked yet, but its credentials must be there."""
    place = urlsplit(settings.raw_store or "")
    if place.scheme in {"", "file"}:
        return FileRawStore(Path(unquote(place.path)) if place.path else settings.data_dir / "raw")
    from api.bucket import bucket_store  # noqa: PLC0415 - most deployments have none

    return bucket_store(settings)


def job_context(settings: Settings, storage: SqlStorage) -> JobContext:
    """Return what the jobs of this deployment may touch."""
    rules = RuleBook() if settings.rules_file is None else load_rules(settings.rules_file)
    chosen = JobSettings(rules=rules, rails=rails_settings(settings))
    holder = process_name()
    return JobContext(storage, SystemClock(), code_version(), chosen, holder=holder, lease_s=settings.lease_s)


def rails_settings(settings: Settings) -> RailsSettings:
    """Return the settings of wheels and rails apart that this deployment asks for."""
    known = known_sections(settings.rails_known_sections or "")
    model = replace(RailsParameters(), limit=settings.rails_limit)
    return RailsSettings(frozenset(KnownSection(code, on_ns) for code, on_ns in known), model)


def retention_of(settings: Settings) -> Retention:
    """Return how long this deployment keeps what."""
    return Retention() if settings.retention_file is None else load_retention(settings.retention_file)


def scheduled_jobs(settings: Settings) -> tuple[Job, ...]:
    """Return the jobs in the order in which one hands its results to the next, at the intervals of this deployment."""
    assembly = partial(assemble_windows, lambda context: receiver(settings, _sql_storage(context), context.clock))
    title = "Assemble windows again whose recordings, registry or files have changed"
    jobs = (Job(ASSEMBLY, title, every_s=60.0, run=assembly), *ALL_JOBS)
    if settings.jobs_every_s is not None:
        jobs = tuple(replace(job, every_s=settings.jobs_every_s) for job in jobs)
    return tuple(traced(job) for job in jobs)


def upkeep_jobs(settings: Settings) -> tuple[Job, ...]:
    """Return the jobs of the schedule that estimate nothing."""
    return (traced(purge_job(retention_of(settings), raw_store(settings), _sql_storage)),)


def receiver(
    settings: Settings,
    storage: SqlStorage,
    clock: Clock,
    catalogues: Sequence[Path] = (),
    *,
    deleted_taken_by: str | None = None,
    announce: Announce = to_nobody,
) -> Receiver:
    """Return what takes recordings in and makes their windows; deleted ones only where somebody wants them back."""
    buses = [load_own_bus(path) for path in catalogues or settings.catalogue_files]
    chosen = claim(storage, bus_choice(default_catalogue(), buses), _length_ns(settings), clock.now_ns())
    return Receiver(
        storage,
        raw_store(settings),
        chosen,
        clock,
        window_length_s=settings.window_length_s,
        deleted_taken_by=deleted_taken_by,
        announce=announce,
    )


def _length_ns(settings: Settings) -> int:
    return round(settings.window_length_s * SECOND_NS)


def _sql_storage(context: JobContext) -> SqlStorage:
    if not isinstance(context.storage, SqlStorage):
        raise TypeError(f"windows are assembled in an SqlStorage, not in {type(context.storage).__name__}")
    return context.storage


def open_services(settings: Settings) -> Services:
    """Return what the routes work with; refuses where :func:`open_store` or :func:`job_context` do."""
    # the receiver and the scheduler are built in this module too and do not wait for the web framework
    from api.answers import RepresentationCache  # noqa: PLC0415 - the same
    from api.services import PATIENCE_S, JobRunner, Services, WriterSlots  # noqa: PLC0415 - the same
    from api.uploads import UploadLimits, Uploads  # noqa: PLC0415 - the same

    storage = replace(open_store(settings), patience_s=PATIENCE_S)
    context = job_context(settings, storage)
    one_reader = not settings.on_server
    references = publisher(settings, lambda: storage)
    raw, announce = raw_store(settings), to_nobody if references is None else references.publish
    chunks = ChunkStorage(replace(storage, patience_s=RECEIPT_PATIENCE_S), raw, context.clock, announce)
    limits = UploadLimits(
        settings.max_chunk_mb * MEGABYTE, settings.max_uploads, settings.upload_timeout_s, settings.body_timeout_s
    )
    return Services(
        raw=raw,
        storage=storage,
        clock=context.clock,
        jobs={job.name: job for job in (*scheduled_jobs(settings), *upkeep_jobs(settings))},
        runner=JobRunner(context, storage, process_name()),
        check=partial(check_head, storage.engine),
        close=storage.close,
        writers=WriterSlots(1 if one_reader else WRITERS, PATIENCE_S),
        cache=RepresentationCache(),
        uploads=Uploads(raw, chunks, backlog_watch(settings, storage, raw), limits),
        references=references,
        one_reader=one_reader,
    )


def backlog_watch(settings: Settings, storage: SqlStorage, raw: RawStore) -> BacklogWatch:
    """Return what says whether more chunks may come, which are received where ``raw`` wants them."""
    limits = BacklogLimits(settings.backlog_chunks, settings.backlog_mb * MEGABYTE, settings.free_disk_mb * MEGABYTE)
    return BacklogWatch(storage, raw.receiving, limits)


def create_app(settings: Settings) -> FastAPI:
    """Return the REST application of this deployment; refuses where :func:`open_services` does."""
    from api.access.guard import plan_of  # noqa: PLC0415 - the same
    from api.app import build_app  # noqa: PLC0415 - the same
    from api.http_server import limits_of  # noqa: PLC0415 - the same
    from api.webhooks.sending import sender_of  # noqa: PLC0415 - the same

    access, sender = plan_of(settings), sender_of(settings)
    return build_app(open_services(settings), limits_of(settings), access, sender)


def create_server(settings: Settings) -> uvicorn.Server:
    """Return the server of the REST application, which answers running requests before it ends on a signal."""
    from api.http_server import http_server  # noqa: PLC0415 - the same

    return http_server(create_app(settings), settings)


def serve(settings: Settings, stopping: Event) -> None:
    """Serve the REST application until a signal; it listens while the server of its database is away."""
    from api.access.guard import plan_of  # noqa: PLC0415 - the same
    from api.app import build_app  # noqa: PLC0415 - the same
    from api.http_server import check_address, http_server, keep_what_is_loaded, limits_of  # noqa: PLC0415 - the same
    from api.webhooks.sending import sender_of  # noqa: PLC0415 - the same

    access, sender = plan_of(settings), sender_of(settings)
    check_address(settings)
    with ThreadPoolExecutor(1, "start") as beside:
        opening = beside.submit(once_the_database_answers, partial(open_services, settings), settings, stopping)
        wait([opening], timeout=AT_ONCE_S if settings.on_server else None)
        app = build_app(None, limits_of(settings), access, sender)
        server = http_server(app, settings)
        opening.add_done_callback(partial(_join, app, server))
        try:
            if not server.should_exit:
                keep_what_is_loaded()
                server.run()
        finally:
            stopping.set()
        opening.result()


def _join(app: FastAPI, server: uvicorn.Server, opening: Future[Services | None]) -> None:
    app.state.services = None if opening.exception() else opening.result()
    if app.state.services is None:
        server.should_exit = True

"""The composition root of what receives and estimates: settings become a receiver, jobs and what jobs may touch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from api.factory import SystemClock, code_version, process_name, raw_store, retention_of
from api.logs import traced
from api.rules_file import load_rules
from api.settings import PREFIX, Settings, known_sections
from estimation.alerts.rule_book import RuleBook
from estimation.errors import InputError, ParameterError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import Job, JobContext
from estimation.jobs.settings import JobSettings, KnownSection, RailsSettings
from estimation.rails.parameters import RailsParameters
from estimation.storage import Clock
from fleet_db.keeping.purge import purge_job
from fleet_db.raw import RawStore
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.intake.backlog import BacklogLimits, BacklogWatch, assemble_windows
from ingest.own_bus.loading import load_own_bus
from ingest.reassembly import ASSEMBLY
from ingest.receipts import Announce, to_nobody
from ingest.receiver import Receiver
from ingest.stored_settings import bus_choice, claim
from ingest.topic.client import Topic, load_properties
from ingest.topic.references import Publisher

Client = TypeVar("Client")

MEGABYTE = 1_000_000
RECEIPT_PATIENCE_S = 20.0  # how long receipts of uploads wait for another process that writes to the embedded database


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
    chosen = claim(storage, bus_choice(default_catalogue(), buses), settings.window_length_ns, clock.now_ns())
    return Receiver(
        storage,
        raw_store(settings),
        chosen,
        clock,
        window_length_s=settings.window_length_s,
        deleted_taken_by=deleted_taken_by,
        announce=announce,
    )


def backlog_watch(settings: Settings, storage: SqlStorage, raw: RawStore) -> BacklogWatch:
    """Return what says whether more chunks may come, which are received where ``raw`` wants them."""
    limits = BacklogLimits(settings.backlog_chunks, settings.backlog_mb * MEGABYTE, settings.free_disk_mb * MEGABYTE)
    return BacklogWatch(storage, raw.receiving, limits)


def job_context(settings: Settings, storage: SqlStorage) -> JobContext:
    """Return what the jobs of this deployment may touch."""
    rules = RuleBook() if settings.rules_file is None else load_rules(settings.rules_file)
    chosen = JobSettings(rules=rules, rails=rails_settings(settings))
    holder = process_name()
    return JobContext(storage, SystemClock(), code_version(), chosen, holder=holder, lease_s=settings.lease_s)


def rails_settings(settings: Settings) -> RailsSettings:
    """Return the settings of wheels and rails apart that this deployment asks for."""
    sections = known_sections(settings.rails_known_sections or "")
    model = replace(RailsParameters(), limit=settings.rails_limit)
    return RailsSettings(frozenset(KnownSection(code, on_ns) for code, on_ns in sections), model)


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


def _sql_storage(context: JobContext) -> SqlStorage:
    if not isinstance(context.storage, SqlStorage):
        raise TypeError(f"windows are assembled in an SqlStorage, not in {type(context.storage).__name__}")
    return context.storage

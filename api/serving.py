"""The composition root of the REST API: settings become what its routes work with, the application and its server."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from threading import Event

import uvicorn
from fastapi import FastAPI

from api.answers import RepresentationCache
from api.app import build_app
from api.factory import once_the_database_answers, open_store, process_name, raw_store
from api.http_server import check_address, http_server, keep_what_is_loaded
from api.pipeline import (
    MEGABYTE,
    RECEIPT_PATIENCE_S,
    backlog_watch,
    job_context,
    publisher,
    scheduled_jobs,
    upkeep_jobs,
)
from api.services import PATIENCE_S, JobRunner, Services, WriterSlots
from api.settings import Settings
from api.uploads import UploadLimits, Uploads
from fleet_db.migrate import check_head
from ingest.receipts import ChunkStorage, to_nobody

AT_ONCE_S = 1.0  # a database server that answers within this time is there before the REST API listens
WRITERS = 16  # requests that write at once on a database server; the others are left for those that read


def open_services(settings: Settings) -> Services:
    """Return what the routes work with; refuses where :func:`open_store` or :func:`job_context` do."""
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


def create_app(settings: Settings) -> FastAPI:
    """Return the REST application of this deployment; refuses where :func:`open_services` does."""
    app = build_app(settings)
    app.state.services = open_services(settings)
    return app


def create_server(settings: Settings) -> uvicorn.Server:
    """Return the server of the REST application, which answers running requests before it ends on a signal."""
    return http_server(create_app(settings), settings)


def serve(settings: Settings, stopping: Event) -> None:
    """Serve the REST application until a signal; it listens while the server of its database is away."""
    app = build_app(settings)
    check_address(settings)
    with ThreadPoolExecutor(1, "start") as beside:
        opening = beside.submit(once_the_database_answers, partial(open_services, settings), settings, stopping)
        wait([opening], timeout=AT_ONCE_S if settings.on_server else None)
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

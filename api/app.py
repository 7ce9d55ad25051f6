"""The REST application: routes, problems, middleware; built from services, never at import."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import AsyncIterator, MutableMapping
from contextlib import asynccontextmanager
from importlib.metadata import version
from importlib.resources import files
from typing import Any

import anyio.to_thread
import orjson
from fastapi import Depends, FastAPI
from fastapi.routing import APIRoute
from prometheus_client import CollectorRegistry

from api import contract, problems
from api.access.gate import authorise
from api.access.guard import allow_pages, guard_of
from api.feed.watch import FeedWatch, WaitingPlaces, ending
from api.measures import Measured, reference_measures
from api.metrics import RequestMeasures, stored_measures, upload_measures
from api.middleware import HeadMiddleware, RequestContextMiddleware
from api.openapi.document import document, scopes_of
from api.page import routes as page
from api.routes import (
    access,
    accuracy,
    alerts,
    chunks,
    dated_records,
    design_contact,
    geometry,
    health,
    jobs,
    opinions,
    recordings,
    registry_assets,
    registry_decisions,
    tracks,
    vehicles,
    webhooks,
    worklist,
)
from api.services import Services, visible
from api.settings import Settings
from api.webhooks.delivering import INTERVAL_S, PATIENCE_S, deliver
from api.webhooks.sending import TRIALS, sender_of
from estimation.errors import TreadwatchError

RESOURCES = (
    chunks.router,  # first: a request is compared with one path after the other, and these are the most
    vehicles.fleets_router,
    vehicles.router,
    worklist.router,
    worklist.plans_router,
    dated_records.router,
    dated_records.vehicles_router,
    registry_assets.router,
    registry_decisions.router,
    geometry.router,
    opinions.router,
    design_contact.router,
    accuracy.router,
    alerts.feed_router,  # before the alerts, whose path it would be taken for
    alerts.router,
    alerts.actions_router,
    jobs.router,
    jobs.quarantine_router,
    tracks.router,
    access.router,
    webhooks.router,
    recordings.router,
    recordings.corrections_router,
)
# Requests that work at the same time slow each other down: Python runs one of them, and all others wait as long.
EMBEDDED_THREADS = 2  # of SQLite: one to read, one that may wait to write
SERVER_THREADS = 4  # of a database server: some that wait for it
SWITCH_S = 0.001
"""How long a thread that works may keep the others waiting, s: answers are to leave while lists are being read."""
COMMITTED = "openapi.json"  # beside this file; a test compares it with the routes


def describe() -> FastAPI:
    """Return the app as far as its OpenAPI document needs it: without services."""

    def name_operation(route: APIRoute) -> str:
        return route.name

    def waits_for_news(scope: MutableMapping[str, Any]) -> bool:  # a trace of such a request would say nothing
        return bool(scope.get("path", "").endswith("/feed/stream") or b"wait_s=" in scope.get("query_string", b""))

    app = FastAPI(
        title="treadwatch",
        version=version("treadwatch"),
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        generate_unique_id_function=name_operation,
        lifespan=_lifespan,
        telemetry={"operation_spans": False, "exclude": waits_for_news},
    )
    for router in RESOURCES:
        app.include_router(
            router,
            dependencies=[Depends(contract.media_type), Depends(authorise), Depends(visible)],
            responses=problems.described(401, 403, 406, 422, 429, 500, 503),
        )
    app.include_router(health.router)
    app.include_router(page.router)
    problems.install(app)
    return app


def document_text() -> str:
    """Return the OpenAPI document as it is to be committed."""
    described = document(describe(), scopes_of(RESOURCES))
    return orjson.dumps(described, option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS).decode() + "\n"


def committed_document() -> bytes:
    """Return the OpenAPI document that is committed: to derive it again would take most of the start of the service."""
    return files("api").joinpath(COMMITTED).read_bytes()


def build_app(settings: Settings) -> FastAPI:
    """Return the app; until it has its ``state.services`` all but ``/healthz`` and ``/metrics`` is refused."""
    app = describe()
    registry = CollectorRegistry(auto_describe=False)
    registry.register(Measured(lambda: stored_measures(app.state.services)))
    registry.register(Measured(lambda: upload_measures(app.state.services)))
    registry.register(
        Measured(lambda: reference_measures(None if (ours := app.state.services) is None else ours.references))
    )
    app.state.services = None
    app.state.registry = registry
    app.state.document = committed_document()
    app.state.contracts = contract.contracts_of(orjson.loads(app.state.document))
    guard = guard_of(settings, lambda: app.state.services.storage)
    app.state.access_book = guard.book
    app.state.feed_watch = FeedWatch(lambda: None if (ours := app.state.services) is None else ours.storage, ending)
    app.state.waiting_places = WaitingPlaces(settings.max_streams, guard.streams)
    registry.register(Measured(app.state.waiting_places.measures))
    app.state.webhook_sender = sender_of(settings)
    app.state.webhook_trials = asyncio.Semaphore(TRIALS)
    app.add_middleware(HeadMiddleware)
    app.add_middleware(RequestContextMiddleware, measures=RequestMeasures(registry), settings=settings, access=guard)
    allow_pages(app, guard.origins)
    return app


def _deliver_to_webhooks(app: FastAPI, stopping: threading.Event) -> None:
    """Deliver from when a webhook is on file; until then neither a lock nor a session is held for it."""
    while not _is_webhook_on_file(app.state.services):
        if stopping.wait(INTERVAL_S):
            return
    deliver(app.state.services, app.state.webhook_sender, stopping)


def _is_webhook_on_file(services: Services | None) -> bool:
    if services is None:
        return False
    try:
        with services.storage.read() as unit:
            return bool(unit.webhooks.active())
    except TreadwatchError:
        return True  # whoever delivers says what is waited for


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    sys.setswitchinterval(SWITCH_S)
    embedded = app.state.services is not None and app.state.services.one_reader  # an embedded one is never waited for
    threads = anyio.to_thread.current_default_thread_limiter()
    threads.total_tokens = EMBEDDED_THREADS if embedded else SERVER_THREADS
    stopping = threading.Event()
    webhooks = threading.Thread(target=_deliver_to_webhooks, args=(app, stopping), name="webhooks", daemon=True)
    webhooks.start()
    yield
    stopping.set()
    await anyio.to_thread.run_sync(webhooks.join, 2 * PATIENCE_S)  # a silent database must not hold the end up
    await anyio.to_thread.run_sync(app.state.access_book.close)
    services: Services | None = app.state.services
    if services is not None:
        await anyio.to_thread.run_sync(services.runner.close)
        if services.uploads.opened:
            await anyio.to_thread.run_sync(services.uploads.close)
        if services.references is not None:
            await anyio.to_thread.run_sync(services.references.close)
        services.close()

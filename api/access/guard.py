"""Everything of access that stands around the requests of one app."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fastapi import FastAPI
from starlette.datastructures import MutableHeaders
from starlette.middleware.cors import CORSMiddleware

from api.access.book import AccessBook
from api.access.gate import Gate
from api.access.plan import AccessPlan
from api.access.rates import StreamPlaces
from api.access.recording import Recorder, recorder_of
from api.access.security_headers import security_headers
from fleet_db.storage import SqlStorage

SHOWN = ["ETag", "Idempotency-Replayed", "Link", "Location", "Retry-After", "X-Request-Id"]
SENT = ["Authorization", "Content-Type", "Idempotency-Key", "If-Match", "If-None-Match", "Last-Event-ID"]


@dataclass(frozen=True, slots=True)
class Access:
    """What the middleware asks before a request, and does before its answer."""

    gate: Gate
    recorder: Recorder
    book: AccessBook
    streams: StreamPlaces
    origins: frozenset[str]
    https: bool

    def protect(self, headers: MutableHeaders) -> None:
        """Add to an answer what browsers are to do with it."""
        for name, value in security_headers(https=self.https, shared=bool(self.origins)).items():
            headers.setdefault(name, value)


def guard_of(plan: AccessPlan, storage: Callable[[], SqlStorage]) -> Access:
    """Return what guards one app."""
    book = AccessBook(storage)
    return Access(
        gate=plan.gate(storage, book),
        recorder=recorder_of(book),
        book=book,
        streams=StreamPlaces(plan.streams_per_key),
        origins=plan.hosts.origins,
        https=plan.https,
    )


def allow_pages(app: FastAPI, origins: frozenset[str]) -> None:
    """Let pages of these origins read answers (CORS); those of no other can."""
    if origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=sorted(origins),
            allow_methods=["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"],
            allow_headers=SENT,
            expose_headers=SHOWN,
            max_age=600,
        )

"""Everything of access that stands around the requests of one app, as the settings of a deployment ask for it."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from http import HTTPStatus

from fastapi import FastAPI
from starlette.datastructures import MutableHeaders
from starlette.middleware.cors import CORSMiddleware
from starlette.types import Scope

from api.access.gate import READING, Gate, Hosts, Rate, StreamPlaces, address_of, known_caller
from api.access.key_ring import KeyRing, Provider, Tokens
from api.http_server import is_upload
from api.settings import PREFIX, Settings
from estimation.errors import ParameterError, TreadwatchError
from fleet_db.records import AuditEntry
from fleet_db.storage import SqlStorage

GATHER_S = 1.0  # refusals and uses are gathered for so long, so that they cost one transaction
WAITING = 10_000  # entries that wait to be written; beyond, they are lost, and the log says so
USED_EVERY_NS = 60_000_000_000  # when a key was used last is written at most this often, in nanoseconds
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Use:
    prefix: str
    at_ns: int


@dataclass(frozen=True, slots=True)
class _Change:
    entry: AuditEntry
    written: Future[None]


@dataclass(slots=True)
class AccessBook:
    """Writes in one thread, which starts with the first thing to write."""

    storage: Callable[[], SqlStorage]
    _queue: queue.Queue[AuditEntry | _Change | _Use | None] = field(
        default_factory=lambda: queue.Queue(maxsize=WAITING)
    )
    _used: dict[str, int] = field(default_factory=dict)
    _thread: threading.Thread | None = None

    def used(self, prefix: str, at_ns: int) -> None:
        """Note that a key was used; written at most once a minute."""
        if at_ns - self._used.get(prefix, 0) >= USED_EVERY_NS:
            self._used[prefix] = at_ns
            self._put(_Use(prefix, at_ns))

    def refused(self, entry: AuditEntry) -> None:
        """Note a refusal; written within a second."""
        self._put(entry)

    def changed(self, entry: AuditEntry) -> Future[None]:
        """Note a change; return what ends when it is written."""
        written: Future[None] = Future()
        if not self._put(_Change(entry, written)):
            written.set_result(None)
        return written

    def close(self) -> None:
        """Write what waits, and end."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None

    def _put(self, item: AuditEntry | _Change | _Use) -> bool:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="access-book", daemon=True)
            self._thread.start()
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            _log.error("the audit log cannot keep up; an entry is lost: %s", item)
            return False
        return True

    def _run(self) -> None:
        going_on = True
        while going_on:
            batch, going_on = self._gather()
            if batch:
                self._write(batch)

    def _gather(self) -> tuple[list[AuditEntry | _Change | _Use], bool]:
        """Return what is to be written together, as soon as somebody waits for it, and whether more may come."""
        batch: list[AuditEntry | _Change | _Use] = []
        until_s: float | None = None
        while len(batch) < WAITING:
            try:
                item = self._queue.get(timeout=None if until_s is None else max(0.0, until_s - time.monotonic()))
            except queue.Empty:
                return batch, True
            if item is None:
                return batch, False
            batch.append(item)
            if until_s is None:
                until_s = time.monotonic() + GATHER_S
            if isinstance(item, _Change):
                until_s = time.monotonic()  # with what else is there already
        return batch, True

    def _write(self, batch: list[AuditEntry | _Change | _Use]) -> None:
        entries = [item.entry if isinstance(item, _Change) else item for item in batch if not isinstance(item, _Use)]
        used = {item.prefix: item.at_ns for item in batch if isinstance(item, _Use)}
        try:
            with self.storage().write() as unit:
                unit.audit.add(entries)
                unit.api_keys.used(used)
        except TreadwatchError as error:
            _log.error("entries of the audit log could not be written: %s: %s", error, entries)
        finally:
            for item in batch:
                if isinstance(item, _Change):
                    item.written.set_result(None)


REFUSALS = frozenset({HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN})
_OF_ADDRESS = 60.0  # refusals of one address that are recorded in a minute: a stranger must not fill the disk


@dataclass(frozen=True, slots=True)
class Recorder:
    """Decides what is recorded, and has it written."""

    book: AccessBook
    refusals: Rate
    now_ns: Callable[[], int] = time.time_ns

    async def answered(self, scope: Scope, status: int, headers: Mapping[str, str], request_id: str) -> None:
        """Record how a request was answered, before its answer is sent: no change is answered that is not recorded.

        An upload is recorded in its receipt, with its sender: an entry beside each would be more rows than all else.
        """
        changed = scope["method"] not in READING and status < HTTPStatus.MULTIPLE_CHOICES and not is_upload(scope)
        if changed and "idempotency-replayed" not in headers:
            entry = self._entry(scope, status, headers, request_id)
            await asyncio.wrap_future(self.book.changed(entry))
        elif status in REFUSALS and self.refusals.take(address_of(scope) or "", time.monotonic()) is None:
            self.book.refused(self._entry(scope, status, headers, request_id))

    def _entry(self, scope: Scope, status: int, headers: Mapping[str, str], request_id: str) -> AuditEntry:
        caller = known_caller(scope)
        return AuditEntry(
            at_ns=self.now_ns(),
            owner=None if caller is None else caller.name,
            key_prefix=None if caller is None else caller.key_prefix,
            method=str(scope["method"])[:16],
            path=_written(scope["path"]),
            status=status,
            object=_written(headers.get("location", scope["path"])),
            address=address_of(scope),
            request_id=request_id,
        )


def _written(path: str) -> str:
    """Return a path as it may be stored: bounded, without the query, and with control characters escaped."""
    shown = "".join(sign if sign.isprintable() else f"%{ord(sign):02X}" for sign in path.partition("?")[0])
    return shown[:500]


PAGE_POLICY = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
"""Scripts and styles of our own files only, none inline; no frame around it."""
HTTPS_ONLY = "max-age=31536000"


def security_headers(*, https: bool, shared: bool) -> Mapping[str, str]:
    """Return the headers of an answer."""
    headers = {
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Content-Security-Policy": PAGE_POLICY,
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "cross-origin" if shared else "same-origin",
    }
    if https:
        headers["Strict-Transport-Security"] = HTTPS_ONLY
    return headers


IN_WORDS = "open to everyone who reaches this address"
MINUTE_S = 60.0


def is_loopback(host: str) -> bool:
    """Return whether an address to listen on is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def listed(value: str | None) -> list[str]:
    """Return the parts of a setting with commas between them."""
    return [part for item in (value or "").split(",") if (part := item.strip())]


def _provider(settings: Settings) -> Provider | None:
    needed = {"issuer": settings.oidc_issuer, "audience": settings.oidc_audience, "keys": settings.oidc_keys}
    if not any(needed.values()):
        return None
    for name, value in needed.items():
        if value is None:
            others = ", ".join(f"{PREFIX}OIDC_{other.upper()}" for other in needed if other != name)
            raise ParameterError(f"is needed with {others}", field=f"{PREFIX}OIDC_{name.upper()}")
    return Provider(
        issuer=str(settings.oidc_issuer),
        audience=str(settings.oidc_audience),
        keys=str(settings.oidc_keys),
        owner_claim=settings.oidc_owner_claim,
        scopes_claim=settings.oidc_scopes_claim,
        fleets_claim=settings.oidc_fleets_claim,
        leeway_s=settings.oidc_leeway_s,
    )


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


def guard_of(settings: Settings, storage: Callable[[], SqlStorage]) -> Access:
    """Return what guards one app; refuses what is open beyond loopback, and half an issuer of tokens."""
    if settings.access == "open" and not is_loopback(settings.host):
        reason = f"is open, and {settings.host} is reached from beyond this machine: use keys, or say '{IN_WORDS}'"
        raise ParameterError(reason, field=f"{PREFIX}ACCESS")
    book, provider, failures = AccessBook(storage), _provider(settings), settings.failed_keys_per_minute
    names = frozenset(name.lower() for name in listed(settings.hosts))
    origins = frozenset(origin.rstrip("/").lower() for origin in listed(settings.origins))
    gate = Gate(
        hosts=Hosts(names, origins),
        metrics=settings.metrics,
        docs=settings.docs,
        keys=KeyRing(storage) if settings.access == "keys" else None,
        tokens=None if provider is None else Tokens(provider),
        note_use=book.used,
        requests=Rate(settings.requests_per_s, settings.requests_burst),
        failures=Rate(failures / MINUTE_S, max(1.0, failures)),
    )
    return Access(
        gate=gate,
        recorder=Recorder(book, Rate(_OF_ADDRESS / MINUTE_S, _OF_ADDRESS)),
        book=book,
        streams=StreamPlaces(settings.streams_per_key),
        origins=origins,
        https=settings.https,
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

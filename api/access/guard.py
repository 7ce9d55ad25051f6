"""Everything of access that stands around the requests of one app, as the settings of a deployment ask for it."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from fastapi import FastAPI
from starlette.datastructures import MutableHeaders
from starlette.middleware.cors import CORSMiddleware

from api.access.book import AccessBook, Recorder, recorder_of
from api.access.gate import Gate, Hosts, Opened, Rate, StreamPlaces
from api.access.key_ring import KeyRing
from api.access.oidc import Provider, Tokens
from api.settings import PREFIX, Settings
from estimation.errors import ParameterError
from fleet_db.storage import SqlStorage

PAGE_POLICY = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
"""Scripts and styles of our own files only, none inline; no frame around it."""
HTTPS_ONLY = "max-age=31536000"


def security_headers(*, https: bool, shared: bool) -> Mapping[str, str]:
    """Return the headers of an answer."""
    found = {
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Content-Security-Policy": PAGE_POLICY,
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "cross-origin" if shared else "same-origin",
    }
    if https:
        found["Strict-Transport-Security"] = HTTPS_ONLY
    return found


IN_WORDS = "open to everyone who reaches this address"
MINUTE_S = 60.0


@dataclass(frozen=True, slots=True)
class AccessPlan:
    """What a deployment has decided; the default needs keys."""

    with_keys: bool = True
    hosts: Hosts = field(default_factory=Hosts)
    doors: Opened = field(default_factory=Opened)
    provider: Provider | None = None
    requests_per_s: float = 50.0
    requests_burst: int = 500
    failed_keys_per_minute: float = 10.0
    streams_per_key: int = 10
    https: bool = False

    def gate(self, storage: Callable[[], SqlStorage], book: AccessBook) -> Gate:
        """Return the gate of one app."""
        return Gate(
            hosts=self.hosts,
            doors=self.doors,
            keys=KeyRing(storage) if self.with_keys else None,
            tokens=None if self.provider is None else Tokens(self.provider),
            note_use=book.used,
            requests=Rate(self.requests_per_s, self.requests_burst),
            failures=Rate(self.failed_keys_per_minute / MINUTE_S, max(1.0, self.failed_keys_per_minute)),
        )


def plan_of(settings: Settings) -> AccessPlan:
    """Return what a deployment has decided; refuses what is open beyond loopback, and half an issuer of tokens."""
    if settings.access == "open" and not is_loopback(settings.host):
        raise ParameterError(
            f"is open, and {settings.host} is reached from beyond this machine: use keys, or say '{IN_WORDS}'",
            field=f"{PREFIX}ACCESS",
        )
    return AccessPlan(
        with_keys=settings.access == "keys",
        hosts=Hosts(
            frozenset(name.lower() for name in listed(settings.hosts)),
            frozenset(origin.rstrip("/").lower() for origin in listed(settings.origins)),
        ),
        doors=Opened(settings.metrics, settings.docs),
        provider=_provider(settings),
        requests_per_s=settings.requests_per_s,
        requests_burst=settings.requests_burst,
        failed_keys_per_minute=settings.failed_keys_per_minute,
        streams_per_key=settings.streams_per_key,
        https=settings.https,
    )


def is_loopback(host: str) -> bool:
    """Return whether an address to listen on is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def listed(value: str | None) -> list[str]:
    """Return the parts of a setting with commas between them."""
    return [part for one in (value or "").split(",") if (part := one.strip())]


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

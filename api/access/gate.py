"""Who comes in: which hosts and callers are let in, and what each may do."""

from __future__ import annotations

import math
import time
from collections import Counter, OrderedDict
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from http import HTTPMethod
from typing import Annotated, Literal, cast
from urllib.parse import urlsplit

from fastapi import Depends, Request
from fastapi.routing import APIRoute
from starlette import types
from starlette.datastructures import Headers

from api.access.key_ring import ANYONE, Caller, KeyRing, Tokens
from api.access.keys import prefix_of
from api.problems import ProblemError
from api.settings import LOOPBACK
from estimation.errors import TreadwatchError

BUCKETS = 10_000  # keys or addresses that are remembered; beyond, the one not seen for longest is forgotten


@dataclass(slots=True)
class _Bucket:
    tokens: float
    at_s: float


@dataclass(slots=True)
class Rate:
    """So many a second on average, and so many at once; for one thread."""

    per_s: float
    burst: float
    _buckets: OrderedDict[str, _Bucket] = field(default_factory=OrderedDict)

    def take(self, name: str, now_s: float) -> float | None:
        """Take one; return None, or after how many seconds there will be one."""
        bucket = self._filled(name, now_s)
        if bucket.tokens < 1.0:
            return math.ceil((1.0 - bucket.tokens) / self.per_s)
        bucket.tokens -= 1.0
        return None

    def wait_s(self, name: str, now_s: float) -> float | None:
        """Return after how many seconds there will be one to take; None where there is one now. Takes none."""
        tokens = self._filled(name, now_s).tokens
        return None if tokens >= 1.0 else math.ceil((1.0 - tokens) / self.per_s)

    def _filled(self, name: str, now_s: float) -> _Bucket:
        bucket = self._buckets.setdefault(name, _Bucket(self.burst, now_s))
        self._buckets.move_to_end(name)
        if len(self._buckets) > BUCKETS:
            self._buckets.popitem(last=False)
        bucket.tokens = min(self.burst, bucket.tokens + (now_s - bucket.at_s) * self.per_s)
        bucket.at_s = now_s
        return bucket


@dataclass(slots=True)
class StreamPlaces:
    """The places of one process; for one event loop."""

    per_key: int
    _held: Counter[str] = field(default_factory=Counter)

    @contextmanager
    def place(self, caller: Caller) -> Iterator[None]:
        """Hold a place for as long as a stream is open."""
        name = caller.identity or ""
        if caller.identity is not None and self._held[name] >= self.per_key:
            detail = f"limit streams_per_key: at most {self.per_key} streams of a key; close one"
            raise ProblemError(429, "too-many-requests", detail, headers={"Retry-After": "10"})
        self._held[name] += 1
        try:
            yield
        finally:
            self._held[name] -= 1
            if not self._held[name]:
                del self._held[name]


Door = Literal["key", "open", "off"]
"""How a path is passed: ``key`` needs a key, ``open`` needs none, ``off`` is shut."""

HEALTH = frozenset({"/healthz", "/readyz"})
PAGE = frozenset({"/", "/favicon.ico"})  # the page itself holds nothing of a fleet: it asks for a key and reads with it
PAGE_FILES = "/assets/"
DOCUMENTS = frozenset({"/openapi.json", "/docs"})
DOCUMENT_FILES = "/docs/"
METRICS = "/metrics"


def door_of(metrics: Door, docs: Door, scope: types.Scope) -> Door:
    """Return how the path of a request is passed; with a key where nothing else is said."""
    path: str = scope["path"]
    if path in HEALTH or path in PAGE or path.startswith(PAGE_FILES):
        return "open"  # also where the method is not allowed, which is then the answer
    if scope["method"] not in READING:
        return "key"
    if path == METRICS:
        return metrics
    return docs if path in DOCUMENTS or path.startswith(DOCUMENT_FILES) else "key"


READING = frozenset({HTTPMethod.GET, HTTPMethod.HEAD, HTTPMethod.OPTIONS})


@dataclass(frozen=True, slots=True)
class Hosts:
    """The names and origins that are let through."""

    names: frozenset[str] = frozenset()
    origins: frozenset[str] = frozenset()  # origins of pages, such as `https://maintenance.example`, beside our own

    def check(self, scope: types.Scope) -> None:
        """Refuse a request under another name, or a change that a page of another origin asks for."""
        headers = Headers(scope=scope)
        host = headers.get("host")
        if host is not None and not self._ours(host, scope):
            detail = "the service is not reached under this name; name it in TREADWATCH_HOSTS"
            raise ProblemError(421, "unknown-host", detail)
        origin = headers.get("origin")
        if origin is None or scope["method"] in READING or origin in self.origins:
            return
        if host is None or urlsplit(origin).netloc.lower() != host.lower():
            detail = "pages of another origin may not change anything here; name it in TREADWATCH_ORIGINS"
            raise ProblemError(403, "foreign-origin", detail)

    def _ours(self, host: str, scope: types.Scope) -> bool:
        name = host_name(host)
        here = scope.get("server")
        return name in LOOPBACK or name in self.names or (here is not None and name == str(here[0]).lower())


def host_name(host: str) -> str | None:
    """Return the name in a ``Host`` header, in lower case and without its port; None where it is none."""
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port
    except ValueError:
        return None
    return parts.hostname.rstrip(".") if parts.hostname and parts.netloc == host and "@" not in host else None


_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="treadwatch"'}
_REFUSED = {"WWW-Authenticate": 'Bearer realm="treadwatch", error="invalid_token"'}
_SEND = "send a valid key or token: Authorization: Bearer ..."
STILL_GOOD = "treadwatch.still_good"
LONGEST_TOKEN = 8192


@dataclass(frozen=True, slots=True)
class Gate:
    """Decides who asks, and refuses who may not; where ``keys`` is None, access is open."""

    hosts: Hosts
    metrics: Door
    docs: Door
    keys: KeyRing | None
    tokens: Tokens | None
    note_use: Callable[[str, int], None]
    requests: Rate
    failures: Rate
    now_ns: Callable[[], int] = time.time_ns

    async def admit(self, scope: types.Scope) -> None:
        """Let a request in and name its caller."""
        self.hosts.check(scope)
        door = door_of(self.metrics, self.docs, scope)
        if door == "off":
            raise ProblemError(404, "not-found", "Not Found")
        if self.keys is None or door == "open":
            name_caller(scope, ANYONE)
            return
        caller = await self._caller(scope, self.keys)
        name_caller(scope, caller)
        scope[STILL_GOOD] = partial(self._still_good, Headers(scope=scope)["authorization"].partition(" ")[2].strip())
        wait_s = self.requests.take(caller.identity or "", time.monotonic())
        if wait_s is not None:
            raise _too_often("requests_per_s", f"{self.requests.per_s:g} requests a second of a key", wait_s)
        for_all = scope["path"] == METRICS and scope["method"] in READING
        if for_all and ("read" not in caller.scopes or caller.fleets is not None):
            raise ProblemError(403, "forbidden", "this needs a key of all fleets with the scope 'read'")

    async def _caller(self, scope: types.Scope, keys: KeyRing) -> Caller:
        given = Headers(scope=scope).get("authorization")
        if given is None:
            raise ProblemError(401, "unauthenticated", _SEND, headers=_CHALLENGE)
        scheme, _, token = given.partition(" ")
        token = token.strip()
        address = address_of(scope) or ""
        remembered = keys.remembers(token)
        wait_s = None if remembered else self.failures.wait_s(address, time.monotonic())
        if wait_s is not None:
            raise _too_often(
                "failed_keys_per_minute", f"{60 * self.failures.per_s:g} wrong keys a minute of an address", wait_s
            )
        caller = await self._find(token, keys) if scheme.lower() == "bearer" and len(token) <= LONGEST_TOKEN else None
        if caller is None:
            self.failures.take(address, time.monotonic())
            raise ProblemError(401, "unauthenticated", _SEND, headers=_REFUSED)
        return caller

    async def _still_good(self, token: str) -> bool:
        """Return whether a key or token that was let in would be let in now; where that cannot be read, it would."""
        try:
            return self.keys is not None and await self._find(token, self.keys) is not None
        except TreadwatchError:
            return True

    async def _find(self, token: str, keys: KeyRing) -> Caller | None:
        if prefix_of(token) is None:
            return None if self.tokens is None else await self.tokens.find(token)
        now_ns = self.now_ns()
        key = await keys.find(token, now_ns)
        if key is None:
            return None
        self.note_use(key.prefix, now_ns)
        return Caller(key.owner, key.scopes, key.fleets, f"key {key.prefix}")


async def require_still_good(scope: types.Scope) -> None:
    """Refuse a request that has waited for long, where its caller would not be let in any more."""
    if not await still_good(scope):
        detail = "the key or token was revoked, or has expired, while the request waited"
        raise ProblemError(401, "unauthenticated", detail, headers=_REFUSED)


async def still_good(scope: types.Scope) -> bool:
    """Return whether the caller of a request that goes on for long would be let in now."""
    ask: Callable[[], Awaitable[bool]] | None = scope.get(STILL_GOOD)
    return ask is None or await ask()


def address_of(scope: types.Scope) -> str | None:
    """Return the address that a request came from; None where the server does not know it."""
    client = scope.get("client")
    return None if client is None else str(client[0])


def _too_often(name: str, limit: str, wait_s: float) -> ProblemError:
    detail = f"limit {name}: at most {limit}; try again"
    return ProblemError(429, "too-many-requests", detail, headers={"Retry-After": f"{wait_s:.0f}"})


_PLACE = "treadwatch.caller"


def name_caller(scope: types.Scope, caller: Caller) -> None:
    """Let a request be that of a caller; to be called once it is known."""
    scope[_PLACE] = caller


def known_caller(scope: types.Scope) -> Caller | None:
    """Return who asks; None where nobody is known yet, as of a request that is refused."""
    return cast("Caller | None", scope.get(_PLACE))


async def _caller_of(request: Request) -> Caller:
    caller = known_caller(request.scope)
    if caller is None:
        raise LookupError("the request did not pass api.access.gate")
    return caller


CallerDep = Annotated[Caller, Depends(_caller_of)]


class Scope(StrEnum):
    """What a key or a token allows; each stands for itself alone."""

    READ = "read"
    ACT = "act"
    INGEST = "ingest"
    ADMIN = "admin"


SCOPE_OF = "treadwatch_scope"
"""Attribute of a dependency under which the document and the tests find the scope of an operation."""
_READING = frozenset({HTTPMethod.GET.value, HTTPMethod.HEAD.value})


def requires(scope: Scope, *, all_fleets: bool = False) -> Callable[[CallerDep], None]:
    """Return a dependency that refuses callers without a scope."""

    def check(caller: CallerDep) -> None:
        _refuse_without(caller, scope)
        if all_fleets and caller.fleets is not None:
            raise ProblemError(403, "forbidden", "this needs a key of all fleets")

    setattr(check, SCOPE_OF, scope)
    return check


def _refuse_without(caller: Caller, scope: Scope) -> None:
    if scope not in caller.scopes:
        raise ProblemError(403, "forbidden", f"this needs the scope '{scope}'")


def scope_of(route: APIRoute) -> Scope | None:
    """Return the scope of an operation: the one that it declares, `read` where it only reads; None is a mistake."""
    declared = {
        scope for depends in route.dependencies if (scope := getattr(depends.dependency, SCOPE_OF, None)) is not None
    }
    if len(declared) == 1:
        return Scope(declared.pop())
    return Scope.READ if not declared and (route.methods or set()) <= _READING else None


async def authorise(request: Request, caller: CallerDep) -> None:
    """Refuse callers who lack the scope of the operation; for every route of the API."""
    route: APIRoute = request.scope["route"]
    scope = scope_of(route)
    if scope is None:
        raise LookupError(f"{route.path_format} declares no scope: dependencies=[Depends(requires(Scope....))]")
    _refuse_without(caller, scope)

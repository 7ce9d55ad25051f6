"""The HTTP server: uvicorn, with limits on what a client may take."""

from __future__ import annotations

import asyncio
import errno
import gc
import resource
import socket
from asyncio import Protocol
from collections import Counter, OrderedDict
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any, cast

import uvicorn
from fastapi import FastAPI
from prometheus_client.core import GaugeMetricFamily, Metric
from starlette.types import Scope
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from api.measures import Measured, counter
from api.settings import PREFIX, Settings
from estimation.errors import ParameterError

MAX_HEAD_BYTES = 16 << 10  # request line and headers of one request
REQUESTS = 100  # requests that are answered at the same time; beyond, 503
SEND_TIMEOUT_S = 30.0  # how long a client may leave an answer unread, in seconds
ACCEPTED_AT_ONCE = 8
"""Connections that are accepted in one turn of the event loop; those they displace are closed a few turns later."""
RESERVED_DESCRIPTORS = 64 + 5 * ACCEPTED_AT_ONCE
"""For the database, the data folder, the log, the server itself, and connections that are being closed."""


def is_upload(scope: Scope) -> bool:
    """Return whether a request sends a chunk, whose route takes the body piece by piece."""
    return bool(scope["method"] == "PUT" and scope["path"].startswith("/v1/chunks/"))


def open_connections(wanted: int) -> int:
    """Return how many connections may be open: ``wanted``, or fewer where the process may open fewer files."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if descriptors == resource.RLIM_INFINITY:
        return wanted
    return max(1, min(wanted, descriptors - RESERVED_DESCRIPTORS))


_LATE = b"HTTP/1.1 408 Request Timeout\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class Cut(StrEnum):
    """Why a connection was closed by the service."""

    HEADERS_LATE = "headers-late"
    DISPLACED = "displaced"
    REFUSED = "refused"
    ANSWER_UNREAD = "answer-unread"


@dataclass(slots=True)
class Connections:
    """The open connections of one server."""

    limit: int
    header_timeout_s: float  # how long one may wait for the headers of a request
    cut: Counter[Cut] = field(default_factory=Counter)
    _open: set[LimitedConnection] = field(default_factory=set)
    _waiting: OrderedDict[LimitedConnection, None] = field(default_factory=OrderedDict)

    def __len__(self) -> int:
        return len(self._open)

    def admit(self, newcomer: LimitedConnection) -> None:
        """Take a connection in; where all are taken, cut the one that has waited for longest, else the newcomer."""
        if len(self._open) >= self.limit:
            if not self._waiting:
                newcomer.cut(Cut.REFUSED)
                return
            next(iter(self._waiting)).cut(Cut.DISPLACED)
        self._open.add(newcomer)
        self._waiting[newcomer] = None

    def wait(self, connection: LimitedConnection) -> None:
        """Note that a connection waits for its client from now on; the first such note counts."""
        if connection in self._open:
            self._waiting.setdefault(connection)

    def work(self, connection: LimitedConnection) -> None:
        """Note that a connection is busy."""
        self._waiting.pop(connection, None)

    def leave(self, connection: LimitedConnection) -> None:
        """Note that a connection is gone."""
        self._open.discard(connection)
        self._waiting.pop(connection, None)


class LimitedConnection(H11Protocol):
    """One HTTP connection that is cut when its client keeps it waiting."""

    def __init__(
        self,
        connections: Connections,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._all = connections
        self._due: dict[Cut, asyncio.TimerHandle] = {}

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as in the base class
        """Start to wait for the first request."""
        super().connection_made(transport)
        self._all.admit(self)
        self._note()

    def data_received(self, data: bytes) -> None:
        """Hand over what came; the wait ends with the last line of the headers."""
        super().data_received(data)
        self._note()

    def on_response_complete(self) -> None:
        """Start to wait for the next request."""
        super().on_response_complete()
        self._note()

    def pause_writing(self) -> None:
        """Give the client a time to read what was sent."""
        super().pause_writing()
        self._cut_later(Cut.ANSWER_UNREAD, SEND_TIMEOUT_S)

    def resume_writing(self) -> None:
        """Go on sending."""
        super().resume_writing()
        self._keep(Cut.ANSWER_UNREAD)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._forget()
        super().connection_lost(exc)

    def cut(self, why: Cut) -> None:
        """Close the connection at once; where its client was in the middle of the headers, with an answer."""
        self._forget()
        self._all.cut[why] += 1
        if why is Cut.HEADERS_LATE and self.conn.trailing_data[0] and not self.transport.is_closing():
            self.transport.write(_LATE)  # what does not fit into the socket's buffer is lost
        self.transport.abort()

    def _forget(self) -> None:
        self._all.leave(self)
        for why in tuple(self._due):
            self._keep(why)

    def _cut_later(self, why: Cut, seconds: float) -> None:
        if why not in self._due:
            self._due[why] = self.loop.call_later(seconds, self.cut, why)

    def _keep(self, why: Cut) -> None:
        if why in self._due:
            self._due.pop(why).cancel()

    def _note(self) -> None:
        if self.transport.is_closing():
            return
        if self.cycle is None or self.cycle.response_complete:
            self._all.wait(self)
            self._cut_later(Cut.HEADERS_LATE, self._all.header_timeout_s)
            return
        self._keep(Cut.HEADERS_LATE)
        if self.cycle.more_body and not self.cycle.response_started:
            self._all.wait(self)  # for the body, on which the application has its own limit of time
        else:
            self._all.work(self)


WAITING_TO_BE_ACCEPTED = 2048  # connections that the system holds until they are accepted


class HttpServer(uvicorn.Server):
    """Accepts a few connections at a time, however many wait: the event loop would take all, and run out of files."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen."""
        await super().startup(sockets)
        for server in self.servers:
            for listening in server.sockets:
                with listening.dup() as same:  # its queue need not be as short as what is accepted at once
                    same.listen(WAITING_TO_BE_ACCEPTED)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams and long polls, then wait for what else is being answered."""
        app: FastAPI = self.config.app  # type: ignore[assignment] # given by http_server, below
        app.state.feed_watch.stop()
        await super().shutdown(sockets)


def check_address(settings: Settings) -> None:
    """Refuse an address on which nobody can listen, before anything is opened for it; names the setting."""
    try:
        addresses = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, address in addresses:
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        why = "another process listens there" if taken else error.strerror
        field = f"{PREFIX}PORT" if taken else f"{PREFIX}HOST"
        raise ParameterError(f"nobody can listen on {settings.host}:{settings.port}: {why}", field=field) from None


def http_server(app: FastAPI, settings: Settings) -> HttpServer:
    """Return the server of an app, which answers running requests before it ends on a signal."""
    connections = Connections(open_connections(settings.max_connections), settings.header_timeout_s)

    def measures() -> list[Metric]:
        cut = {reason.value: connections.cut[reason] for reason in Cut}
        return [
            GaugeMetricFamily("treadwatch_http_connections", "Open connections.", value=len(connections)),
            counter("treadwatch_http_connections_cut", "Connections closed early.", "reason", cut),
        ]

    app.state.registry.register(Measured(measures))
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=cast("type[Protocol]", partial(LimitedConnection, connections)),
        loop="asyncio",  # the one whose way to accept is known here
        ws="none",
        backlog=ACCEPTED_AT_ONCE,
        h11_max_incomplete_event_size=MAX_HEAD_BYTES,
        log_config=None,
        access_log=False,
        proxy_headers=settings.trusted_proxies is not None,
        forwarded_allow_ips=settings.trusted_proxies or "",
        server_header=False,
        timeout_graceful_shutdown=settings.shutdown_timeout_s,
    )
    return HttpServer(config)


def keep_what_is_loaded() -> None:
    """Exempt every object that lives now from garbage collection.

    A full collection goes through all modules, routes and tables, and keeps every request waiting meanwhile: 150-250 ms
    here, 10-30 ms without what was loaded at the start. For processes that serve until they end: what is exempt and
    becomes garbage later stays.
    """
    gc.collect()
    gc.freeze()

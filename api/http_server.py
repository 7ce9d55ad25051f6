"""The HTTP server: uvicorn, with limits on what a client may take."""

from __future__ import annotations

import errno
import socket
from asyncio import Protocol
from functools import partial
from typing import cast

import uvicorn
from fastapi import FastAPI

from api.connections import ConnectionMeasures, Connections, LimitedConnection
from api.http_limits import ACCEPTED_AT_ONCE, MAX_HEAD_BYTES, open_connections
from api.settings import PREFIX, Settings
from estimation.errors import ParameterError

WAITING_TO_BE_ACCEPTED = 2048
"""Connections that the system holds until they are accepted."""


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
    """Refuse an address on which nobody can listen, before anything is opened for it.

    Raises:
        ParameterError: The port is taken, or the address is not of this machine.
    """
    try:
        found = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, address in found:
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        why = "another process listens there" if taken else error.strerror
        field = f"{PREFIX}PORT" if taken else f"{PREFIX}HOST"
        raise ParameterError(f"nobody can listen on {settings.host}:{settings.port}: {why}", field=field) from None


def http_server(app: FastAPI, settings: Settings) -> HttpServer:
    """Return the server of an app, which answers running requests before it ends on a signal.

    Args:
        app: Its ``state.registry`` gets the measures of the connections.
        settings: Where to listen, what a client may take, how long to wait at the end.
    """
    connections = Connections(open_connections(settings.max_connections), settings.header_timeout_s)
    app.state.registry.register(ConnectionMeasures(connections))
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

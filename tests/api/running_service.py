"""A server on a port of its own, in a thread of the test's process."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import httpx
import uvicorn

from api.serving import create_server
from api.settings import Settings
from fleet_db.storage import SqlStorage


@dataclass(frozen=True)
class Service:
    """A running server, a client of it, and the storage behind it."""

    url: str
    client: httpx.Client
    storage: SqlStorage


@contextmanager
def running(settings: Settings) -> Iterator[str]:
    """Yield the URL of a server."""
    service: uvicorn.Server = create_server(settings)
    thread = threading.Thread(target=service.run)
    thread.start()
    try:
        while not service.started:
            assert thread.is_alive()
            time.sleep(0.01)
        port = service.servers[0].sockets[0].getsockname()[1]
        yield f"http://127.0.0.1:{port}"
    finally:
        service.should_exit = True
        thread.join(30)
        assert not thread.is_alive()

"""A receiver of webhooks on loopback: it keeps what comes and answers as a test says."""

from __future__ import annotations

import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass(frozen=True)
class Received:
    """One request."""

    path: str
    headers: Mapping[str, str]
    body: bytes


@dataclass
class Answer:
    """What a receiver answers: status, headers, how long it waits before, and whether it never stops talking."""

    status: int = 204
    headers: Mapping[str, str] = field(default_factory=dict)
    wait_s: float = 0.0
    endless: bool = False


@dataclass
class Receiver:
    """A running receiver: ``answer`` may be changed while it runs."""

    port: int = 0
    answer: Answer = field(default_factory=Answer)
    received: list[Received] = field(default_factory=list)
    said_bytes: int = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/hook"

    def ids(self) -> list[str]:
        return [one.headers["webhook-id"] for one in self.received]

    def wait_for(self, count: int) -> list[Received]:
        """Return what has come once it is so much."""
        until = time.monotonic() + 30.0
        while len(self.received) < count:
            assert time.monotonic() < until, f"{len(self.received)} of {count} came"
            time.sleep(0.02)
        return self.received


@contextmanager
def receiving(context: ssl.SSLContext | None = None, before: Callable[[], None] = lambda: None) -> Iterator[Receiver]:
    """Yield a receiver; it calls ``before`` when a request is there, before it answers."""
    receiver, ending = Receiver(), threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            headers = {name.lower(): value for name, value in self.headers.items()}
            receiver.received.append(Received(self.path, headers, body))
            answer = receiver.answer
            before()
            ending.wait(answer.wait_s)
            self.send_response(answer.status)
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.end_headers()
            while answer.endless and not ending.is_set():
                receiver.said_bytes += self.wfile.write(b"x" * 65_536)

        def log_message(self, *_: object) -> None:
            """Keep the test's output clean."""

    class Server(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: object) -> None:
            """Clients that go away are part of the tests."""

    server = Server(("127.0.0.1", 0), Handler)
    if context is not None:
        server.socket = context.wrap_socket(server.socket, server_side=True)
    receiver.port = server.server_address[1]
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield receiver
    finally:
        ending.set()
        server.shutdown()
        thread.join()
        server.server_close()

"""What may stand between a deployment and its bucket: a line that changes or holds bytes, stores that answer badly."""

from __future__ import annotations

import hashlib
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Line:
    """A line to a port of this machine.

    Attributes:
        change: Applied to what is sent to the server.
        most_bytes: Sent to the server at most, of all connections; the rest is held back.
    """

    to_port: int
    change: Callable[[bytes], bytes] = lambda piece: piece
    most_bytes: float = float("inf")
    port: int = 0
    held: threading.Event = field(default_factory=threading.Event)
    _sent: int = 0

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def serve(self, listening: socket.socket, ended: ExitStack) -> None:
        while True:
            try:
                client, _ = listening.accept()
            except OSError:
                return
            server = ended.enter_context(socket.create_connection(("127.0.0.1", self.to_port)))
            ended.enter_context(client)
            threading.Thread(target=self._up, args=(client, server), daemon=True).start()
            threading.Thread(target=_down, args=(server, client), daemon=True).start()

    def _up(self, client: socket.socket, server: socket.socket) -> None:
        with suppress(OSError):
            while piece := client.recv(1 << 16):
                if self._sent + len(piece) > self.most_bytes:
                    self.held.set()
                    return
                self._sent += len(piece)
                server.sendall(self.change(piece))
            server.shutdown(socket.SHUT_WR)


def _down(server: socket.socket, client: socket.socket) -> None:
    with suppress(OSError):
        while piece := server.recv(1 << 16):
            client.sendall(piece)
        client.shutdown(socket.SHUT_WR)


@contextmanager
def line(to_port: int, **how: object) -> Iterator[Line]:
    """Yield a line that is open until the block ends."""
    with ExitStack() as ended, socket.create_server(("127.0.0.1", 0)) as listening:
        found = Line(to_port, port=listening.getsockname()[1], **how)  # type: ignore[arg-type]
        serving = threading.Thread(target=found.serve, args=(listening, ended), daemon=True)
        serving.start()
        yield found
        listening.shutdown(socket.SHUT_RDWR)  # ends the accept
        serving.join(10.0)


@dataclass
class Carelessness:
    """A store that checks nothing: it keeps what it makes of the bytes, and calls it what it likes.

    Attributes:
        keep: From what came to what is kept.
        tag: From what is kept to its ETag.
        status: With which it refuses every request; 0 for none.
    """

    keep: Callable[[bytes], bytes] = lambda content: content
    tag: Callable[[bytes], str] = lambda content: hashlib.md5(content, usedforsecurity=False).hexdigest()
    status: int = 0
    kept: dict[str, bytes] = field(default_factory=dict)
    requests: list[str] = field(default_factory=list)
    port: int = 0

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.port}"


class _Server(ThreadingHTTPServer):
    """Serves one careless store."""

    daemon_threads = True

    def __init__(self, store: Carelessness) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.store = store


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Server

    def do_PUT(self) -> None:
        content = self.rfile.read(int(self.headers["Content-Length"]))
        store = self.server.store
        if not self._refused():
            store.kept[self.path] = store.keep(content)
            self._answer(200, b"", store.tag(store.kept[self.path]))

    def do_GET(self) -> None:
        if self._refused():
            return
        content = self.server.store.kept.get(self.path)
        if content is None:
            self._answer(404, b"<Error><Code>NoSuchKey</Code></Error>")
            return
        tag, asked = self.server.store.tag(content), self.headers.get("Range")
        if asked is None:
            self._answer(200, content, tag)
            return
        first, last = (int(part) for part in asked.removeprefix("bytes=").split("-"))
        end = min(last + 1, len(content))
        self._answer(206, content[first:end], tag, f"bytes {first}-{end - 1}/{len(content)}")

    do_HEAD = do_GET  # noqa: N815 - the server calls it so

    def _refused(self) -> bool:
        store = self.server.store
        store.requests.append(self.command)
        if store.status:
            self._answer(store.status, b"<Error><Code>SlowDown</Code><Message>secret</Message></Error>")
        return bool(store.status)

    def _answer(self, status: int, body: bytes, tag: str = "", of: str = "") -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Last-Modified", "Tue, 24 Nov 2026 08:00:00 GMT")
        for name, value in (("ETag", f'"{tag}"' if tag else ""), ("Content-Range", of)):
            if value:
                self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def careless_store(**how: object) -> Iterator[Carelessness]:
    """Yield a store over HTTP, as S3 speaks it, until the block ends."""
    found = Carelessness(**how)  # type: ignore[arg-type]
    with _Server(found) as server:
        found.port = server.server_address[1]
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        try:
            yield found
        finally:
            server.shutdown()

"""Uploads for tests: bytes with their path, sent whole, in part, or over a bare socket."""

from __future__ import annotations

import hashlib
import socket
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx
from scipy.stats import uniform

from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage


@dataclass(frozen=True)
class Upload:
    """Bytes of a chunk and where they are sent to."""

    content: bytes
    vehicle: str = "V-9"

    @property
    def digest(self) -> str:
        return hashlib.sha256(self.content).hexdigest()

    @property
    def path(self) -> str:
        return f"/v1/chunks/{self.digest}?vehicle={self.vehicle}&format=blf"

    def put(self, client: httpx.Client, **headers: str) -> httpx.Response:
        return client.put(
            self.path, content=self.content, headers={"Content-Type": "application/octet-stream"} | headers
        )

    def head(self, length: int | None = None) -> bytes:
        """Return the head of a request of its own, with this content length; None sends the body in chunks."""
        size = "Transfer-Encoding: chunked" if length is None else f"Content-Length: {length}"
        return f"PUT {self.path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{size}\r\n\r\n".encode()


def upload(seed: int, size: int = 100_000, vehicle: str = "V-9") -> Upload:
    """Return random bytes, which no reader takes for a log."""
    return Upload(uniform.rvs(size=size // 8 + 1, random_state=seed).tobytes()[:size], vehicle)


def connected(url: str) -> socket.socket:
    """Return a connection to a service."""
    parts = urlsplit(url)
    assert parts.hostname is not None
    return socket.create_connection((parts.hostname, parts.port or 80), timeout=30)


def answer_of(connection: socket.socket) -> tuple[int, bytes]:
    """Return status and the rest of what a service answers until it closes or falls silent."""
    content = b""
    while b"\r\n\r\n" not in content or not content.rstrip().endswith(b"}"):
        piece = connection.recv(65536)
        if not piece:
            break
        content += piece
    return int(content.split(b" ", 2)[1]), content


def storage_in(folder: Path, url: str | None = None) -> SqlStorage:
    """Return the migrated storage of a service in a folder."""
    data = folder / "data"
    data.mkdir(parents=True, exist_ok=True)
    address = url or f"sqlite:///{(data / 'treadwatch.sqlite').resolve()}"
    upgrade(address)
    return SqlStorage(database_engine(address), data)


def raw_files(folder: Path) -> list[str]:
    """Return the names of all files in the raw store of a service, but for its mark."""
    found = (folder / "data" / "raw").rglob("*")
    return sorted(path.name for path in found if path.is_file() and path.name != "treadwatch-raw-store")

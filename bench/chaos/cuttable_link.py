"""A link between processes and a database server, which is cut for one process and leaves the others alone."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path

RESET = struct.pack("ii", 1, 0)  # close without a farewell, as a network does


class Cut(Enum):
    """How a process is cut off: its connections are closed and refused, or stay and nothing comes through."""

    CLOSED = auto()
    SILENT = auto()


@dataclass(slots=True, eq=False)
class _Connection:
    """Both ends; what arrives at one goes out at the other while ``through`` is set, and waits otherwise."""

    client: socket.socket
    server: socket.socket
    through: threading.Event = field(default_factory=threading.Event)

    def close(self) -> None:
        for end in (self.client, self.server):
            with suppress(OSError):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self.through.set()


class CuttableLink:
    """Listens on loopback and hands on what comes to the socket file of a server."""

    def __init__(self, server: Path) -> None:
        self._server = server
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=128)
        self._cut: dict[int, Cut] = {}
        self._connections: set[_Connection] = set()
        self._lock = threading.Lock()
        threading.Thread(target=self._accept, name="link", daemon=True).start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listening.getsockname()[1])

    def cut_off(self, pid: int, how: Cut) -> int:
        """Cut a process off until it is restored; return how many connections it had.

        Args:
            how: Closed or silent.
        """
        with self._lock:
            self._cut[pid] = how
            found = self._of({pid: how})
        for one in found:
            one.close() if how is Cut.CLOSED else one.through.clear()
        return len(found)

    def restore(self, pid: int) -> None:
        """Let a process through again; what waited on silent connections arrives late."""
        with self._lock:
            found = self._of({pid: self._cut.pop(pid)})
        for one in found:
            one.through.set()

    def close(self) -> None:
        """End all connections."""
        self._listening.close()
        with self._lock:
            left = list(self._connections)
        for one in left:
            one.close()

    def _of(self, cut: Mapping[int, Cut]) -> list[_Connection]:
        """Return the connections of processes."""
        ports = {port for pid in cut for port in _ports_of(pid)}
        return [one for one in self._connections if _peer(one.client) in ports]

    def _accept(self) -> None:
        while True:
            try:
                client, (_, port) = self._listening.accept()
            except OSError:
                return
            server = socket.socket(socket.AF_UNIX)
            try:
                server.connect(str(self._server))
            except OSError:  # the server is away
                client.close()
                server.close()
                continue
            self._begin(_Connection(client, server), port)

    def _begin(self, one: _Connection, port: int) -> None:
        with self._lock:
            how = next((how for pid, how in self._cut.items() if port in _ports_of(pid)), None)
            if how is not Cut.CLOSED:
                self._connections.add(one)
        if how is Cut.CLOSED:
            one.close()
            return
        if how is None:
            one.through.set()
        for source, sink in ((one.client, one.server), (one.server, one.client)):
            threading.Thread(target=self._hand_on, args=(one, source, sink), name="link", daemon=True).start()

    def _hand_on(self, one: _Connection, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while content := source.recv(65536):
                one.through.wait()
                sink.sendall(content)
        one.through.wait()
        with self._lock:
            self._connections.discard(one)
        one.close()


def _peer(end: socket.socket) -> int | None:
    try:
        return int(end.getpeername()[1])
    except OSError:
        return None


def _ports_of(pid: int) -> set[int]:
    """Return the local TCP ports of a process."""
    inodes = set()
    with suppress(OSError):  # it is gone
        for file in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                inodes.add(str(file.readlink()).removeprefix("socket:[").removesuffix("]"))
    lines = Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]
    columns = [line.split() for line in lines]
    return {int(one[1].rpartition(":")[2], 16) for one in columns if one[9] in inodes}

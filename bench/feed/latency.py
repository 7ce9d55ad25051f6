"""Streams: the time from the end of a commit in another process to each client."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

_NOTE = re.compile(rb'"note":"(\d+-\d+)"')
PAUSE_S = 0.5
AGAIN_S = 0.5
_OPEN: list[asyncio.StreamWriter] = []


def measured_s(
    url: str, key: str, folder: Path, database_url: str | None, *, clients: int, writer: int, events: int
) -> list[float]:
    """Return the delay of every event at every client, s; raises where one is missing.

    Args:
        writer: Number of the one who commits; no other part of the bench has it, for notes are to differ.
        events: Commits, one by one.
    """
    return asyncio.run(_measure(url, key, folder, database_url, clients, writer, events))


async def _measure(
    url: str, key: str, folder: Path, database_url: str | None, clients: int, writer: int, events: int
) -> list[float]:
    received: list[dict[bytes, int]] = [{} for _ in range(clients)]
    connections = await asyncio.gather(*(_connected(url, key) for _ in range(clients)))
    listening = [asyncio.create_task(_listen(one, got, events)) for one, got in zip(connections, received, strict=True)]
    command = ["-m", "bench.feed.events", str(folder), database_url or "", str(writer), str(events), str(PAUSE_S)]
    committing = await asyncio.create_subprocess_exec(sys.executable, *command, stdout=subprocess.PIPE)
    printed, _ = await committing.communicate()
    committed = {note: int(at_ns) for note, at_ns in (line.split() for line in printed.splitlines())}
    await asyncio.wait_for(asyncio.gather(*listening), timeout=60)
    return [(got[note] - at_ns) / 1e9 for got in received for note, at_ns in committed.items()]


async def _connected(url: str, key: str) -> asyncio.StreamReader:
    """Return a stream behind its first block; a service that has too much to do is asked again."""
    address = urlsplit(url)
    path = "/v1/alerts/feed/stream?after=latest"
    while True:
        reader, writer = await asyncio.open_connection(address.hostname, address.port, limit=1 << 20)
        head = f"GET {path} HTTP/1.1\r\nHost: {address.netloc}\r\nAccept: text/event-stream\r\n{key}\r\n\r\n"
        writer.write(head.encode())
        if b" 200 " in await reader.readline():
            while not (await reader.readline()).startswith(b"id:"):
                pass
            _OPEN.append(writer)  # closed with the process: a stream whose writer is forgotten is closed
            return reader
        writer.close()
        await asyncio.sleep(AGAIN_S)


async def _listen(reader: asyncio.StreamReader, got: dict[bytes, int], events: int) -> None:
    while len(got) < events:
        line = await reader.readline()
        if not line:
            raise ConnectionError("a stream has ended")
        found = _NOTE.search(line)
        if found is not None:
            got.setdefault(found[1], time.time_ns())

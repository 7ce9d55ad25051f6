"""A poller that may be killed at any time: effect and cursor are one line of its file, written at once."""

from __future__ import annotations

import json
import os
import sys
import urllib.parse
import urllib.request
from pathlib import Path

PAGE = 7


def kept(file: Path) -> tuple[list[str], str | None]:
    """Return the notes of the events that a poller has handed over, and its cursor; a torn last line is not there."""
    notes: list[str] = []
    cursor = None
    for line in file.read_bytes().splitlines(keepends=True) if file.exists() else ():
        if line.endswith(b"\n"):
            page = json.loads(line)
            notes += page["notes"]
            cursor = page["cursor"]
    return notes, cursor


def poll_for_ever(url: str, key: str, file: Path) -> None:
    """Poll, with a wait, and keep each page."""
    _, cursor = kept(file)
    whole = file.read_bytes().rpartition(b"\n") if file.exists() else (b"", b"", b"")
    handle = os.open(file, os.O_WRONLY | os.O_CREAT)
    os.ftruncate(handle, len(whole[0]) + len(whole[1]))
    os.lseek(handle, 0, os.SEEK_END)
    while True:
        query = {"limit": str(PAGE), "wait_s": "1"} | ({} if cursor is None else {"after": cursor})
        request = urllib.request.Request(f"{url}/v1/alerts/feed?{urllib.parse.urlencode(query)}")  # noqa: S310 - our own service
        request.add_header(*key.split(": ", maxsplit=1))
        with urllib.request.urlopen(request, timeout=30) as answer:  # noqa: S310 - the same
            page = json.load(answer)
        cursor = page["next_cursor"]
        line = {"notes": [item["note"] for item in page["items"]], "cursor": cursor}
        os.write(handle, json.dumps(line).encode() + b"\n")


if __name__ == "__main__":
    poll_for_ever(sys.argv[1], sys.argv[2], Path(sys.argv[3]))

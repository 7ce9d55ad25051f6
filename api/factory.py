"""The one place where things are joined: settings become a store, a clock, a job context, an app."""

from __future__ import annotations

import hashlib
import time
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable


class SystemClock:
    """The machine's clock."""

    def now_ns(self) -> int:
        """Return nanoseconds UTC since the Unix epoch."""
        return time.time_ns()


def _sources(folder: Traversable) -> list[tuple[str, bytes]]:
    found: list[tuple[str, bytes]] = []
    for entry in sorted(folder.iterdir(), key=lambda item: item.name):
        if entry.is_dir():
            found += [(f"{entry.name}/{name}", text) for name, text in _sources(entry)]
        elif entry.name.endswith(".py"):
            found.append((entry.name, entry.read_bytes()))
    return found


@cache
def code_version() -> str:
    """Return what estimates carry as provenance: the release and a digest of the estimation's own sources.

    Two estimates with the same code version came from the same mathematics, also between releases.
    """
    digest = hashlib.sha256()
    for name, text in _sources(files("estimation")):
        digest.update(name.encode() + b"\0" + text + b"\0")
    return f"{version('treadwatch')}+{digest.hexdigest()[:12]}"

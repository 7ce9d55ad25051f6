"""A recording between its arrival and the commit of its windows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from estimation.errors import ConflictError
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlUnitOfWork
from ingest.assembly import SpanAssembly
from ingest.recordings import Recording

UNDECODABLE = frozenset({ChunkState.REJECTED, ChunkState.SET_ASIDE, ChunkState.DELETED})
"""States of recordings that count for no window."""


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """A file whose bytes are durable, read if it can be read."""

    path: Path
    vehicle: str
    digest: str
    recording: Recording | Exception


@dataclass(frozen=True, slots=True)
class Decoded:
    """What a recording makes: receipts, its own first, and the windows that it touches, where it has a place."""

    receipts: tuple[ChunkRecord, ...]
    assembly: SpanAssembly | None


def printable_name(path: Path) -> str:
    """Return the name of a file as it is kept with the receipt: what is no text in it is replaced."""
    name = path.name.encode("utf-8", "replace").decode()
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)


def read_or_raise(recording: Recording | Exception) -> Recording:
    """Return what was read; raise what was raised at reading."""
    if isinstance(recording, Exception):
        raise recording
    return recording


def check_undecided(unit: SqlUnitOfWork, receipts: Iterable[ChunkRecord]) -> None:
    """Raise where a recording was reassigned, deleted, set aside or rejected while its windows were assembled.

    Raises:
        ConflictError: One was; names it.
    """
    for receipt in receipts:
        now = unit.chunks.get(receipt.digest)
        if now is None or now.vehicle != receipt.vehicle or now.state in UNDECODABLE:
            raise ConflictError(f"recording {receipt.digest[:12]} changed meanwhile", kind="chunk", key=receipt.digest)

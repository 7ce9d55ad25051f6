"""The raw recordings that the rows of a database refer to, in whatever store they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, select

from fleet_db.atomic_files import write_atomically
from fleet_db.raw import LostRecordingError, RawStore, recording_name
from fleet_db.rows import table_of
from fleet_db.tables import ChunkRow

CHUNKS = table_of(ChunkRow)
RAW = "raw"
"""Folder of them in a backup."""


@dataclass(frozen=True, slots=True)
class KeptRecording:
    """A recording that a row refers to.

    Attributes:
        digest, suffix, size: Of its bytes.
        owner: Whose it is, for messages.
    """

    digest: str
    suffix: str
    size: int
    owner: str

    @property
    def name(self) -> str:
        """In its store, with its folder."""
        return recording_name(self.digest, self.suffix)

    def fault(self, raw: RawStore) -> str | None:
        """Return what is wrong with it in a store, None where nothing is; raises PassingFaultError as its ``check``."""
        fault = raw.fault(self.digest, self.suffix, self.size)
        return None if fault is None else fault.reason


def kept_recordings(connection: Connection) -> Iterator[KeptRecording]:
    """Yield every recording that the rows refer to."""
    chunks = select(CHUNKS.c.digest, CHUNKS.c.suffix, CHUNKS.c.size_bytes, CHUNKS.c.vehicle)
    for row in connection.execute(chunks.where(CHUNKS.c.purged_ns.is_(None)).order_by(CHUNKS.c.digest)):
        owner = f"recording {row.digest[:12]} of vehicle {row.vehicle}"
        yield KeptRecording(row.digest, row.suffix, row.size_bytes, owner)


def copy_recording(kept: KeptRecording, source: RawStore, target: RawStore) -> str | None:
    """Copy a recording from one store to another and look at what was copied; return what is wrong with it.

    Args:
        kept: Which; it stays as it is where it is whole in the target.
        source, target: The stores: that of the installation, or that of a backup.

    Raises:
        PassingFaultError: It cannot be read or written now.
    """
    if target.holds(kept.digest, kept.suffix) and kept.fault(target) is None:
        return None
    try:
        with source.whole(kept.digest, kept.suffix, kept.size) as path:
            target.put_file(path)
    except LostRecordingError as fault:
        return fault.reason
    return kept.fault(target)


def not_listed(recordings: Sequence[KeptRecording], raw: RawStore) -> list[tuple[KeptRecording, str]]:
    """Return the recordings that a store does not list with their size, each with what is wrong; nothing is read.

    Args:
        recordings: That must be there.

    Raises:
        PassingFaultError: It cannot be listed now.
    """
    sizes = {item.digest: item.size_bytes for item in raw.listed() if item.digest}
    wrong = []
    for kept in recordings:
        found = sizes.get(kept.digest)
        if found is None:
            wrong.append((kept, "is missing"))
        elif found != kept.size:
            wrong.append((kept, f"has {found} bytes, not {kept.size}"))
    return wrong


def write_digests(path: Path, recordings: Sequence[KeptRecording]) -> None:
    """Write digest and name of recordings as ``sha256sum --check`` reads them, durably.

    Args:
        recordings: Of a store that is not copied.
    """
    write_atomically(path, "".join(f"{one.digest}  {one.name}\n" for one in recordings).encode(), durable=True)

"""Where the tests keep raw recordings: in a folder beside the samples of windows."""

from __future__ import annotations

from pathlib import Path

from fleet_db.keeping.restore import Installation
from fleet_db.raw import FileRawStore
from fleet_db.storage import SqlStorage


def raw_of(storage: SqlStorage) -> FileRawStore:
    """Return the recordings of a storage."""
    return FileRawStore(storage.data_dir / "raw")


def installation(url: str, folder: Path) -> Installation:
    """Return what a restore fills, with its recordings in a folder."""
    return Installation(url, folder, FileRawStore(folder / "raw"))

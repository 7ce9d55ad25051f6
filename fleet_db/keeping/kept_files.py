"""The samples of windows that the rows of a database refer to, as files."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, select

from estimation.errors import DamagedError, StorageError
from fleet_db.atomic_files import sync_directory, write_atomically
from fleet_db.raw import LostRecordingError, RawItem, RawStore, recording_name
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.windows import WindowRow
from fleet_db.telemetry import WindowFiles, unpack_window, window_digest

WINDOWS = table_of(WindowRow)
SAMPLES = "windows"  # folder of them in a data folder or backup


@dataclass(frozen=True, slots=True)
class KeptFile:
    """A file that a row refers to."""

    digest: str  # that the window in it must have
    size: int  # in bytes
    path: Path  # relative to the data folder
    owner: str  # whose it is, for messages

    def fault(self, folder: Path) -> str | None:
        """Return what is wrong with this file in a data folder or backup, None where nothing is."""
        place = folder / self.path
        try:
            found = place.stat().st_size
            if found != self.size:
                return f"has {found} bytes, not {self.size}"
            whole = window_digest(unpack_window(place.read_bytes(), where=str(place))) == self.digest
        except FileNotFoundError:
            return "is missing"
        except DamagedError:
            return "is damaged"
        except OSError as error:
            raise StorageError(f"{place}: cannot be read: {error.strerror}") from error
        return None if whole else "holds other content than its name says"


def kept_files(connection: Connection) -> Iterator[KeptFile]:
    """Yield every file that the rows refer to, each once."""
    samples = WindowFiles(Path(SAMPLES))
    columns = (WINDOWS.c.content_digest, WINDOWS.c.sample_bytes, WINDOWS.c.wheelset, WINDOWS.c.start_ns)
    of_samples = select(*columns).where(WINDOWS.c.samples_purged_ns.is_(None)).order_by(WINDOWS.c.content_digest)
    found = connection.execution_options(yield_per=2000).execute(of_samples)
    last = ""
    for row in found:
        if row.content_digest != last:
            owner = f"window {row.wheelset}@{row.start_ns}"
            yield KeptFile(row.content_digest, row.sample_bytes, samples.path(row.content_digest), owner)
        last = row.content_digest


def copy_kept(file: KeptFile, source: Path, target: Path) -> str | None:
    """Copy a file between data folder and backup, durably, unless it is there; return what is wrong with the copy."""
    place = target / file.path
    if file.fault(target) is None:
        return None
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".copying-", dir=place.parent) as folder:
            copy = KeptFile(file.digest, file.size, Path(place.name), file.owner)
            part = Path(folder) / place.name
            shutil.copyfile(source / file.path, part)
            fault = copy.fault(Path(folder))
            if fault is not None:
                return fault
            _synchronise(part)
            part.replace(place)
        sync_directory(place.parent)
        sync_directory(place.parent.parent)
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        raise StorageError(f"{file.path}: cannot be copied: {error.strerror}") from error
    return None


def _synchronise(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


CHUNKS = table_of(ChunkRow)
RAW = "raw"  # folder of them in a backup


@dataclass(frozen=True, slots=True)
class KeptRecording:
    """A recording that a row refers to."""

    digest: str
    suffix: str
    size: int  # bytes
    owner: str  # whose it is, for messages

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
    """Copy a recording between stores unless it is there whole; return what is wrong with the copy."""
    if target.holds(kept.digest, kept.suffix) and kept.fault(target) is None:
        return None
    try:
        with source.whole(kept.digest, kept.suffix, kept.size) as path:
            target.put_file(path)
    except LostRecordingError as fault:
        return fault.reason
    return kept.fault(target)


def not_listed(recordings: Sequence[KeptRecording], raw: RawStore) -> list[tuple[KeptRecording, str]]:
    """Return the recordings that a store does not list with their size, each with what is wrong; nothing is read."""
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
    """Write digest and name of recordings as ``sha256sum --check`` reads them, durably."""
    write_atomically(path, "".join(f"{one.digest}  {one.name}\n" for one in recordings).encode(), durable=True)


LEAST_AGE_S = 3600.0  # a file may be older than its row by the length of the transaction that stores it


def orphaned_samples(storage: SqlStorage, least_age_s: float = LEAST_AGE_S) -> list[Path]:
    """Return the files of windows that no row refers to, relative to the data folder; younger ones do not count."""
    files = sorted(_old_files(storage.data_dir, least_age_s))  # before the rows: these only grow more
    kept = select(WINDOWS.c.content_digest).where(WINDOWS.c.samples_purged_ns.is_(None)).distinct()
    with storage.read() as unit:
        known = frozenset(unit.connection.scalars(kept))
    return [path for path in files if path.name.partition(".")[0] not in known]


def orphaned_recordings(storage: SqlStorage, raw: RawStore, least_age_s: float = LEAST_AGE_S) -> list[RawItem]:
    """Return what is in the store of raw recordings and no row refers to."""
    before_s = time.time() - least_age_s
    items = sorted((one for one in raw.listed() if one.changed_s <= before_s), key=lambda one: one.place)
    with storage.read() as unit:
        known = frozenset(unit.connection.scalars(select(CHUNKS.c.digest).where(CHUNKS.c.purged_ns.is_(None))))
    return [one for one in items if one.digest not in known]


def _old_files(data_dir: Path, least_age_s: float) -> Iterator[Path]:
    """Yield the files that have not been changed for a while; by the clock of the file system and this machine."""
    before, folder = time.time() - least_age_s, data_dir / SAMPLES
    try:
        for path in folder.rglob("*"):
            try:
                if path.parent != folder and path.is_file() and path.stat().st_mtime <= before:
                    yield path.relative_to(data_dir)
            except FileNotFoundError:
                continue  # replaced or removed meanwhile
    except OSError as error:
        raise StorageError(f"{folder}: cannot be read: {error.strerror}") from error

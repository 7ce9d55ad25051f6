"""The files and recordings that the rows of a database refer to, and those that no row does."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sqlalchemy import Connection, select

from estimation.errors import DamagedError, StorageError
from fleet_db.atomic_files import sync_directory, synchronise
from fleet_db.raw import LostRecordingError, RawItem, RawStore
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.windows import WindowRow
from fleet_db.telemetry import WindowFiles, unpack_window, window_digest

WINDOWS, CHUNKS = table_of(WindowRow), table_of(ChunkRow)
SAMPLES = "windows"  # folder of them in a data folder or backup
RAW = "raw"  # folder of recordings in a backup


@dataclass(frozen=True, slots=True)
class Holdings:
    """Where kept files are, in a deployment or a backup: those of windows in a folder, recordings in a store."""

    folder: Path
    raw: RawStore


@dataclass(frozen=True, slots=True)
class KeptFile:
    """A file that a row refers to."""

    digest: str  # that the window in it must have
    size: int  # in bytes
    path: Path  # relative to the data folder
    owner: str  # whose it is, for messages

    def at(self, _place: Holdings) -> str:
        """Return where it is, for messages."""
        return str(self.path)

    def fault(self, place: Holdings) -> str | None:
        """Return what is wrong with it, None where nothing is; raises StorageError where it cannot be read now."""
        file = place.folder / self.path
        try:
            size_bytes = file.stat().st_size
            if size_bytes != self.size:
                return f"has {size_bytes} bytes, not {self.size}"
            whole = window_digest(unpack_window(file.read_bytes(), where=str(file))) == self.digest
        except FileNotFoundError:
            return "is missing"
        except DamagedError:
            return "is damaged"
        except OSError as error:
            raise StorageError(f"{file}: cannot be read: {error.strerror}") from error
        return None if whole else "holds other content than its name says"

    def copy(self, source: Holdings, target: Holdings) -> str | None:
        """Copy it durably unless it is there whole; return what is wrong with the copy."""
        if self.fault(target) is None:
            return None
        file = target.folder / self.path
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(prefix=".copying-", dir=file.parent) as folder:
                part = Path(folder) / file.name
                shutil.copyfile(source.folder / self.path, part)
                fault = replace(self, path=Path(file.name)).fault(replace(target, folder=Path(folder)))
                if fault is not None:
                    return fault
                synchronise(part)
                part.replace(file)
            sync_directory(file.parent)
            sync_directory(file.parent.parent)
        except FileNotFoundError:
            return "is missing"
        except OSError as error:
            raise StorageError(f"{self.path}: cannot be copied: {error.strerror}") from error
        return None


@dataclass(frozen=True, slots=True)
class KeptRecording:
    """A recording that a row refers to."""

    digest: str
    suffix: str
    size: int  # bytes
    owner: str  # whose it is, for messages

    def at(self, place: Holdings) -> str:
        """Return where it is, for messages."""
        return place.raw.place(self.digest, self.suffix)

    def fault(self, place: Holdings) -> str | None:
        """Return what is wrong with it, None where nothing is; raises PassingFaultError as ``RawStore.check``."""
        fault = place.raw.fault(self.digest, self.suffix, self.size)
        return None if fault is None else fault.reason

    def copy(self, source: Holdings, target: Holdings) -> str | None:
        """Copy it unless it is there whole; return what is wrong with the copy."""
        if target.raw.holds(self.digest, self.suffix) and self.fault(target) is None:
            return None
        try:
            with source.raw.whole(self.digest, self.suffix, self.size) as path:
                target.raw.put_file(path)
        except LostRecordingError as fault:
            return fault.reason
        return self.fault(target)


Kept = KeptFile | KeptRecording
Progress = Callable[[int, int], None]
"""Called with (done, total) files."""


def copy_all(kept: Sequence[Kept], source: Holdings, target: Holdings, progress: Progress) -> list[tuple[Kept, str]]:
    """Copy files and recordings; return those that are missing or damaged, each with what is wrong."""
    wrong: list[tuple[Kept, str]] = []
    for done, file in enumerate(kept, start=1):
        fault = file.copy(source, target)
        wrong += [] if fault is None else [(file, fault)]
        progress(done, len(kept))
    return wrong


def lines_of(wrong: Sequence[tuple[Kept, str]], place: Holdings) -> tuple[str, ...]:
    """Return a line for each that is missing or damaged."""
    return tuple(f"{file.at(place)} {fault} ({file.owner})" for file, fault in wrong)


def kept_files(connection: Connection) -> Iterator[KeptFile]:
    """Yield every file that the rows refer to, each once."""
    samples = WindowFiles(Path(SAMPLES))
    columns = (WINDOWS.c.content_digest, WINDOWS.c.sample_bytes, WINDOWS.c.wheelset, WINDOWS.c.start_ns)
    of_samples = select(*columns).where(WINDOWS.c.samples_purged_ns.is_(None)).order_by(WINDOWS.c.content_digest)
    rows = connection.execution_options(yield_per=2000).execute(of_samples)
    last = ""
    for row in rows:
        if row.content_digest != last:
            owner = f"window {row.wheelset}@{row.start_ns}"
            yield KeptFile(row.content_digest, row.sample_bytes, samples.path(row.content_digest), owner)
        last = row.content_digest


def kept_recordings(connection: Connection) -> Iterator[KeptRecording]:
    """Yield every recording that the rows refer to."""
    chunks = select(CHUNKS.c.digest, CHUNKS.c.suffix, CHUNKS.c.size_bytes, CHUNKS.c.vehicle)
    for row in connection.execute(chunks.where(CHUNKS.c.purged_ns.is_(None)).order_by(CHUNKS.c.digest)):
        owner = f"recording {row.digest[:12]} of vehicle {row.vehicle}"
        yield KeptRecording(row.digest, row.suffix, row.size_bytes, owner)


def not_listed(recordings: Sequence[KeptRecording], raw: RawStore) -> list[tuple[Kept, str]]:
    """Return the recordings that a store does not list with their size, each with what is wrong; nothing is read."""
    sizes = {item.digest: item.size_bytes for item in raw.listed() if item.digest}
    wrong: list[tuple[Kept, str]] = []
    for kept in recordings:
        size_bytes = sizes.get(kept.digest)
        if size_bytes is None:
            wrong.append((kept, "is missing"))
        elif size_bytes != kept.size:
            wrong.append((kept, f"has {size_bytes} bytes, not {kept.size}"))
    return wrong


LEAST_AGE_S = 3600.0  # a file may be older than its row by the length of the transaction that stores it


def orphaned_samples(storage: SqlStorage, least_age_s: float = LEAST_AGE_S) -> list[Path]:
    """Return the files of windows that no row refers to, relative to the data folder; younger ones do not count."""
    files = sorted(_old_files(storage.data_dir, least_age_s))  # before the rows: these only grow more
    kept = select(WINDOWS.c.content_digest).where(WINDOWS.c.samples_purged_ns.is_(None)).distinct()
    with storage.read() as unit:
        referred_to = frozenset(unit.connection.scalars(kept))
    return [path for path in files if path.name.partition(".")[0] not in referred_to]


def orphaned_recordings(storage: SqlStorage, raw: RawStore, least_age_s: float = LEAST_AGE_S) -> list[RawItem]:
    """Return what is in the store of raw recordings and no row refers to."""
    before_s = time.time() - least_age_s
    items = sorted((item for item in raw.listed() if item.changed_s <= before_s), key=lambda item: item.place)
    with storage.read() as unit:
        referred_to = frozenset(unit.connection.scalars(select(CHUNKS.c.digest).where(CHUNKS.c.purged_ns.is_(None))))
    return [item for item in items if item.digest not in referred_to]


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

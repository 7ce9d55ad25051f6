"""Raw recordings as files under one folder: on the disk before they are reported as stored."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from estimation.errors import PassingFaultError
from fleet_db.atomic_files import passing_faults, sha256_of, sync_directory, write_atomically
from fleet_db.raw import (
    MARK_NAME,
    IncomingFile,
    LostRecordingError,
    RawItem,
    RawStore,
    RawTotal,
    check_size,
    damaged,
    missing,
    recording_name,
)
from fleet_db.storage import SqlStorage, SqlUnitOfWork


class FileRawStore(RawStore):
    """Recordings under one folder, received in it and named by a rename; it is made with the first one."""

    def __init__(self, directory: Path) -> None:
        super().__init__(directory, str(directory), saved_by_backup=True)
        self.directory = directory

    def path(self, digest: str, suffix: str) -> Path:
        """Return where the recording of this digest is; raises ParameterError as :meth:`RawStore.place`."""
        return self.directory / recording_name(digest, suffix)

    def place(self, digest: str, suffix: str) -> str:
        """Return the path of a recording."""
        return str(self.path(digest, suffix))

    def incoming(self, suffix: str) -> IncomingFile:
        """Return a file in the folder."""
        return IncomingFile(self.directory, suffix)

    def put(self, files: Sequence[IncomingFile]) -> None:
        """Give files their names, then force all names to the disk; a whole file of a name stays."""
        directories: set[Path] = set()
        for file in files:
            path = self.path(file.digest, file.suffix)
            with passing_faults(path):
                if not (path.is_file() and sha256_of(path) == file.digest):
                    path.parent.mkdir(parents=True, exist_ok=True)
                    file.path.replace(path)
            directories |= {path.parent, self.directory}  # also of one that was there: who put it may not have got here
        for directory in sorted(directories):
            with passing_faults(directory):
                sync_directory(directory)

    def file_of(self, placed: IncomingFile) -> Path:
        """Return the recording itself."""
        return self.path(placed.digest, placed.suffix)

    def holds(self, digest: str, suffix: str) -> bool:
        """Whether there is a file of this name."""
        return self.path(digest, suffix).is_file()

    def size(self, digest: str, suffix: str) -> int:
        """Return the size of the file."""
        path = self.path(digest, suffix)
        with passing_faults(path):
            return path.stat().st_size

    def check(self, digest: str, suffix: str, size_bytes: int | None = None) -> None:
        """Read the file."""
        path = self.path(digest, suffix)
        try:
            check_size(path.stat().st_size, size_bytes, path)
            whole = sha256_of(path) == digest
        except FileNotFoundError:
            raise missing(path) from None
        except OSError as error:  # of this file: the others may be whole
            raise LostRecordingError(f"cannot be read: {error.strerror}", file=path) from error
        if not whole:
            raise damaged(path)

    def lost(self, digest: str, suffix: str) -> bool:
        """Whether the file is missing or damaged; not where the folder is not there."""
        return self.directory.is_dir() and super().lost(digest, suffix)

    @contextmanager
    def whole(self, digest: str, suffix: str, size_bytes: int) -> Iterator[Path]:
        """Open a block with the file itself."""
        self.check(digest, suffix, size_bytes)
        yield self.path(digest, suffix)

    def remove(self, digest: str, suffix: str) -> None:
        """Delete the file."""
        path = self.path(digest, suffix)
        with passing_faults(path):
            path.unlink(missing_ok=True)

    def listed(self) -> Iterator[RawItem]:
        """Yield every file below the folder, but for what is beside the recordings in the folder itself."""
        for path in self.directory.rglob("*"):
            left = path.name.startswith(".")
            if path.parent == self.directory and not left:
                continue
            with passing_faults(path):
                try:
                    status = path.stat() if path.is_file() else None
                except FileNotFoundError:
                    continue  # replaced or removed meanwhile
            if status is not None:
                digest = "" if left else path.name.partition(".")[0]
                yield RawItem(str(path), digest, status.st_size, status.st_mtime)

    def remove_old(self, item: RawItem, least_age_s: float) -> int | None:
        """Delete a file by its path."""
        path = Path(item.place)
        with passing_faults(path):
            return unlink_old(path, least_age_s)

    def total(self, enough: int) -> RawTotal:
        """Return what is there, by whole folders until enough files were looked at."""
        with passing_faults(self.directory):
            return total_of(self.directory, enough)

    def read_mark(self) -> str | None:
        """Return what is in the file of the mark."""
        with passing_faults(self.directory):
            try:
                return (self.directory / MARK_NAME).read_text(encoding="ascii", errors="replace").strip() or None
            except FileNotFoundError:
                return None

    def write_mark(self, mark: str) -> None:
        """Write the file of the mark."""
        with passing_faults(self.directory):
            write_atomically(self.directory / MARK_NAME, f"{mark}\n".encode(), durable=True)


def unlink_old(path: Path, least_age_s: float) -> int | None:
    """Delete a file unless it was written or used again less than this age ago; return its size, None if it stays."""
    try:
        found = path.stat()
        if found.st_mtime > time.time() - least_age_s:
            return None
        path.unlink()
    except FileNotFoundError:
        return None
    return found.st_size


def total_of(directory: Path, enough: int) -> RawTotal:
    """Return the files below a folder, if it is there, by whole subfolders until enough are seen: names are digests."""
    try:
        below = sorted(entry.path for entry in os.scandir(directory) if entry.is_dir())
        files = size = seen = 0
        for folder in below:
            sizes = [entry.stat().st_size for entry in os.scandir(folder) if entry.is_file()]
            files, size, seen = files + len(sizes), size + sum(sizes), seen + 1
            if files >= enough:
                break
    except FileNotFoundError:
        return RawTotal(0, 0, estimated=False)
    scale = len(below) / seen if seen else 1.0
    return RawTotal(round(files * scale), round(size * scale), estimated=seen < len(below))


LOOKED_FOR = 10  # so many of the oldest and of the newest receipts are looked for in a store without the mark


def check_raw_store(storage: SqlStorage, raw: RawStore, now_ns: int) -> str:
    """Return the mark of the raw store, made at its first use; PassingFaultError: it is not that of this database."""
    found = raw.read_mark()
    with storage.read() as unit:
        known = unit.raw_marks.get()
        if found is not None and found == known:
            return found
        if not _belongs(unit, raw):
            raise not_mounted(raw)
    with storage.write() as unit:
        mark = found or unit.raw_marks.get() or uuid.uuid4().hex
        if unit.raw_marks.get() != mark:
            unit.raw_marks.set(mark, now_ns)
    if found is None:
        raw.write_mark(mark)
    return mark


def not_mounted(raw: RawStore) -> PassingFaultError:
    """Return the refusal of a store that is not that of the database."""
    reason = (
        "holds no recording of this database and not its mark: is it mounted? Is it the right one?"
        " Nothing is written there until it is the store of the recordings again"
    )
    return PassingFaultError(reason, file=raw.url)


def _belongs(unit: SqlUnitOfWork, raw: RawStore) -> bool:
    some = unit.chunks.ends(LOOKED_FOR)
    return not some or any(raw.holds(record.digest, record.suffix) for record in some)

"""A folder that others put logs into: each file is stored with its receipt once it is complete, then moved on.

A file is complete when its size and its time have not changed for a while. Nothing is kept in memory that matters:
after a kill the next start stores a file again that had its receipt and was not moved, which changes nothing.
"""

from __future__ import annotations

import stat
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from estimation.errors import ConflictError, InputError
from fleet_db.atomic_files import passing_faults, write_atomically
from fleet_db.locks import locked_file
from fleet_db.raw import RawStore, pieces_of
from ingest.intake.backlog import BacklogWatch, Behind
from ingest.logs.formats import format_of
from ingest.receipts import Arrival, Chunk, ChunkStorage, Stored

DONE, REFUSED = "done", "refused"
REASON_SUFFIX = ".reason.txt"
UNFINISHED = (".part", ".partial", ".tmp", ".filepart")  # endings that programs give a file while they write it
AT_ONCE = 16  # files that get their receipts in one transaction
LOCK = ".treadwatch-drop-folder"


@dataclass(frozen=True, slots=True)
class DropSettings:
    """Of a drop folder."""

    folder: Path  # watched; ``done`` and ``refused`` are made in it
    quiet_s: float  # a file that has not changed for so long is complete, s
    most_bytes: int  # size of a file at most
    vehicle_of: Callable[[Path], str]  # by the path of a file; raises InputError where it does not show


@dataclass(frozen=True, slots=True)
class Look:
    """What one look did: files stored, known already, refused; how many wait to be complete; which limit is reached."""

    stored: int = 0
    known: int = 0
    refused: tuple[str, ...] = ()
    incomplete: int = 0
    behind: Behind | None = None


@dataclass(slots=True)
class _Seen:
    size: int
    changed_ns: int
    inode: int
    since_s: float = field(compare=False)


@dataclass(slots=True)
class DropFolder:
    """Watches a folder."""

    settings: DropSettings
    raw: RawStore
    storage: ChunkStorage
    backlog: BacklogWatch
    now_s: Callable[[], float] = time.monotonic
    _seen: dict[Path, _Seen] = field(default_factory=dict)

    def look(self) -> Look:
        """Take in what is complete, and return what was done.

        Raises PassingFaultError or StorageError where folder, raw store or database are away: no file is lost.
        """
        complete, incomplete = self._complete()
        stored, known, refused = 0, 0, []
        behind: Behind | None = None
        while complete and behind is None:
            batch, complete = complete[:AT_ONCE], complete[AT_ONCE:]
            arrivals: list[tuple[Path, Arrival]] = []
            try:
                for path in batch:
                    behind = behind or self.backlog.behind(self._seen[path].size)
                    if behind is not None:
                        break
                    try:
                        arrivals.append((path, self._read(path)))
                    except InputError as error:
                        refused.append(self._refuse(path, error.reason))
                for path, answer in self._stored(arrivals):
                    if isinstance(answer, Stored):
                        stored, known = stored + (not answer.known), known + answer.known
                        self._move(path, DONE)
                    else:
                        refused.append(self._refuse(path, answer.reason))
            finally:
                for _, arrival in arrivals:
                    arrival.file.discard()
        return Look(stored, known, tuple(refused), incomplete, behind)

    def _complete(self) -> tuple[list[Path], int]:
        now_s, files = self.now_s(), dict[Path, _Seen]()
        with passing_faults(self.settings.folder):
            for path in self.settings.folder.iterdir():
                if path.name.startswith(".") or path.suffix.lower() in UNFINISHED:
                    continue
                status = path.lstat()
                if not stat.S_ISREG(status.st_mode):
                    continue
                seen = _Seen(status.st_size, status.st_mtime_ns, status.st_ino, now_s)
                before = self._seen.get(path)
                files[path] = before if before is not None and before == seen else seen
        self._seen = files
        complete = [path for path, one in files.items() if now_s - one.since_s >= self.settings.quiet_s]
        complete.sort(key=lambda path: (files[path].changed_ns, path))
        return complete, len(files) - len(complete)

    def _read(self, path: Path) -> Arrival:
        if self._seen[path].size > self.settings.most_bytes:
            raise InputError(f"is larger than {self.settings.most_bytes:,} bytes", file=path)
        if self._seen[path].size == 0:
            raise InputError("is empty", file=path)
        vehicle, suffix = self.settings.vehicle_of(path), format_of(path).suffix
        chunk = Chunk(vehicle, suffix, path.name, f"folder {self.settings.folder.name}")
        incoming = self.raw.incoming(suffix)
        try:
            for piece in pieces_of(path):
                incoming.write(piece)
            incoming.finish()
        except BaseException:
            incoming.discard()
            raise
        return Arrival(incoming, chunk)

    def _stored(self, arrivals: Sequence[tuple[Path, Arrival]]) -> list[tuple[Path, Stored | ConflictError]]:
        """Store what is still as it was when it was read; the others have been written to, and wait again."""
        same = []
        for path, arrival in arrivals:
            with suppress(FileNotFoundError):
                status = path.lstat()
                now = _Seen(status.st_size, status.st_mtime_ns, status.st_ino, 0.0)
                if self._seen[path] == now and arrival.file.size_bytes == status.st_size:
                    same.append((path, arrival))
        if not same:
            return []
        answers = self.storage.store([arrival for _, arrival in same])
        return [(path, answer) for (path, _), answer in zip(same, answers, strict=True)]

    def _refuse(self, path: Path, reason: str) -> str:
        place = self._move(path, REFUSED)
        write_atomically(place.with_name(f"{place.name}{REASON_SUFFIX}"), f"{reason}\n".encode(), durable=False)
        return f"{path.name}: {reason}"

    def _move(self, path: Path, folder: str) -> Path:
        target = path.parent / folder
        with passing_faults(target):
            target.mkdir(exist_ok=True)
            place, number = target / path.name, 1
            while place.exists():
                number += 1
                place = target / f"{path.stem}.{number}{path.suffix}"
            path.replace(place)
        self._seen.pop(path, None)
        return place


@contextmanager
def held_folder(folder: Path) -> Iterator[None]:
    """Hold a folder, so that one process watches it."""
    with passing_faults(folder), locked_file(folder / LOCK) as locked:
        if not locked:
            raise ConflictError(f"another process watches {folder}")
        yield

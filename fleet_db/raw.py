"""Raw recordings, addressed by their content: what every store of them promises, wherever the bytes are."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from estimation.errors import InputError, ParameterError, PassingFaultError
from fleet_db.atomic_files import passing_faults, sha256_of, sync_directory, unlink_old, write_atomically
from fleet_db.storage import SqlStorage

PIECE_BYTES = 1 << 20
PREFIX = ".incoming-"  # what a killed process leaves begins so; a purge deletes it


class IncomingFile(AbstractContextManager["IncomingFile"]):
    """A file that grows until it is finished; what is not placed in the raw store by then is deleted at the end.

    It is made with the first piece, as its folder, and is on the disk once it is finished: where it is ``durable``.
    """

    def __init__(self, directory: Path, suffix: str, *, durable: bool = True) -> None:
        self._directory = directory
        self._durable = durable
        self.suffix = suffix
        self._hash = hashlib.sha256()
        self._file: io.FileIO | None = None
        self.path = directory
        self.size_bytes = 0
        self.finished = False

    @property
    def digest(self) -> str:
        """The sha256 of what was written, in hexadecimal."""
        return self._hash.hexdigest()

    def write(self, piece: bytes | bytearray) -> None:
        """Write the next piece. Raises PassingFaultError."""
        with passing_faults(self._directory), memoryview(piece) as unwritten:
            file = self._file or self._made()
            written = 0
            while written < len(unwritten):
                written += file.write(unwritten[written:]) or 0
        self._hash.update(piece)
        self.size_bytes += len(piece)

    def finish(self) -> None:
        """Put what was written on the disk, where it is to be durable, and close the file. Raises PassingFaultError."""
        with passing_faults(self._directory):
            file = self._file or self._made()  # of no bytes
            if self._durable:
                os.fsync(file.fileno())
            file.close()
        self.finished = True

    def discard(self) -> None:
        """Delete the file unless it was placed."""
        if self._file is not None:
            self._file.close()
            self.path.unlink(missing_ok=True)

    def _made(self) -> io.FileIO:
        self._directory.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=PREFIX, suffix=self.suffix, dir=self._directory)
        self.path, self._file = Path(name), io.FileIO(handle, "wb")
        return self._file

    def __exit__(self, *_: object) -> None:
        self.discard()


def pieces_of(source: Path) -> Iterator[bytes]:
    """Yield the bytes of a file of others; raises InputError where it cannot be read."""
    try:
        with source.open("rb") as stream:
            while piece := stream.read(PIECE_BYTES):
                yield piece
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=source) from error


MISSING, DAMAGED = "is missing", "is damaged: its content has another digest"
MARK_NAME = "treadwatch-raw-store"  # what a store holds beside recordings: the mark by which a database knows it


class LostRecordingError(PassingFaultError):
    """A recording is missing or damaged: a copy of it can be put there, or it can be received again."""


@dataclass(frozen=True, slots=True)
class RawItem:
    """What a store lists: a recording, or what a killed process left."""

    place: str  # path or URL
    digest: str  # that its name says; empty for what a killed process left
    size_bytes: int  # of it
    changed_s: float  # when it was written last, s since the Unix epoch by the clock of the store


@dataclass(frozen=True, slots=True)
class RawTotal:
    """How many recordings a store holds, and their bytes; estimated where not all were looked at."""

    items: int
    size_bytes: int
    estimated: bool


class RawStore(ABC):
    """Where raw recordings are.

    What was put is durable, whole and readable when :meth:`put` returns. Nobody ever sees a part of a recording. The
    same bytes again change nothing, but replace a damaged recording.
    """

    def __init__(self, receiving: Path, url: str, *, saved_by_backup: bool) -> None:
        self.receiving = receiving  # folder of this machine in which recordings are received before they are put
        self.url = url  # without any secret
        self.saved_by_backup = saved_by_backup  # whether a backup copies the recordings, because nothing else does

    @abstractmethod
    def place(self, digest: str, suffix: str) -> str:
        """Return the path or URL of a recording, for messages; raises as :func:`recording_name`."""

    @abstractmethod
    def incoming(self, suffix: str) -> IncomingFile:
        """Return a file to receive a recording of this format in; nothing of it is on the disk yet."""

    @abstractmethod
    def put(self, files: Sequence[IncomingFile]) -> None:
        """Put finished files, which may be moved, under their digests. Raises PassingFaultError: some may be there."""

    @abstractmethod
    def file_of(self, placed: IncomingFile) -> Path:
        """Return the file of this machine with the bytes of what was just put, as long as ``placed`` is open."""

    @abstractmethod
    def holds(self, digest: str, suffix: str) -> bool:
        """Whether something is under the name of a recording; raises PassingFaultError where that cannot be said."""

    @abstractmethod
    def size(self, digest: str, suffix: str) -> int:
        """Return the size of a recording, bytes; raises PassingFaultError where it is not there, or cannot be asked."""

    @abstractmethod
    def check(self, digest: str, suffix: str, size_bytes: int | None = None) -> None:
        """Read a recording; LostRecordingError: it is missing or another; PassingFaultError: it cannot be read now."""

    @abstractmethod
    def whole(self, digest: str, suffix: str, size_bytes: int) -> AbstractContextManager[Path]:
        """Open a block with a file of this machine that holds a recording; raises as :meth:`check`."""

    @abstractmethod
    def remove(self, digest: str, suffix: str) -> None:
        """Remove a recording; one that is not there is removed already. Raises PassingFaultError."""

    @abstractmethod
    def listed(self) -> Iterator[RawItem]:
        """Yield every recording, and what killed processes left; not the mark. Raises PassingFaultError."""

    @abstractmethod
    def remove_old(self, item: RawItem, least_age_s: float) -> int | None:
        """Remove something listed that is this old now; return its size, None if it stays. Raises PassingFaultError."""

    @abstractmethod
    def total(self, enough: int) -> RawTotal:
        """Return what is there; where there are more than ``enough``, by a part of them. Raises PassingFaultError."""

    @abstractmethod
    def read_mark(self) -> str | None:
        """Return the mark; None where there is none. Raises PassingFaultError."""

    @abstractmethod
    def write_mark(self, mark: str) -> None:
        """Write the mark, durably. Raises PassingFaultError."""

    def fault(self, digest: str, suffix: str, size_bytes: int | None = None) -> LostRecordingError | None:
        """Return what is wrong with a recording, None where it is whole; raises PassingFaultError as :meth:`check`."""
        try:
            self.check(digest, suffix, size_bytes)
        except LostRecordingError as fault:
            return fault
        return None

    def lost(self, digest: str, suffix: str) -> bool:
        """Whether a recording is missing or damaged; not where the store cannot be read now."""
        try:
            return self.fault(digest, suffix) is not None
        except PassingFaultError:
            return False

    def put_bytes(self, data: bytes, suffix: str) -> str:
        """Put ``data``; return its digest. Raises PassingFaultError where that cannot be done now."""
        with self.incoming(suffix) as incoming:
            incoming.write(data)
            incoming.finish()
            self.put([incoming])
            return incoming.digest

    def put_file(self, source: Path) -> str:
        """Put the file ``source``; return its digest. Raises as :meth:`taken_in`."""
        with self.taken_in(source) as (digest, _):
            return digest

    @contextmanager
    def taken_in(self, source: Path, admit: Callable[[str], None] = lambda _digest: None) -> Iterator[tuple[str, Path]]:
        """Put a file of somebody else; open a block with its digest and a file of this machine with these bytes.

        What ``admit`` raises of the digest leaves nothing behind. Raises InputError as :func:`pieces_of`, and
        PassingFaultError where it cannot be put now.
        """
        with self.incoming(source.suffix.lower()) as incoming:
            for piece in pieces_of(source):
                incoming.write(piece)
            incoming.finish()
            admit(incoming.digest)
            self.put([incoming])
            yield incoming.digest, self.file_of(incoming)


def recording_name(digest: str, suffix: str) -> str:
    """Return the name of a recording in its store, with its folder; raises ParameterError of any other text."""
    if len(digest) != hashlib.sha256().digest_size * 2 or set(digest) - set("0123456789abcdef"):
        raise ParameterError(f"{digest!r} is no sha256", field="digest")
    if not (suffix.startswith(".") and suffix[1:].isalnum()):
        raise ParameterError(f"{suffix!r} is no plain file ending", field="suffix")
    return f"{digest[:2]}/{digest}{suffix}"


def check_size(size_found: int, size_bytes: int | None, place: Path | str) -> None:
    """Raise LostRecordingError where a recording has another size than it must have, if that is known."""
    if size_bytes is not None and size_found != size_bytes:
        raise LostRecordingError(f"has {size_found} bytes, not {size_bytes}", file=place)


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
            raise LostRecordingError(MISSING, file=path) from None
        except OSError as error:  # of this file: the others may be whole
            raise LostRecordingError(f"cannot be read: {error.strerror}", file=path) from error
        if not whole:
            raise LostRecordingError(DAMAGED, file=path)

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
            unfinished = path.name.startswith(".")
            if path.parent == self.directory and not unfinished:
                continue
            with passing_faults(path):
                try:
                    status = path.stat() if path.is_file() else None
                except FileNotFoundError:
                    continue  # replaced or removed meanwhile
            if status is not None:
                digest = "" if unfinished else path.name.partition(".")[0]
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
    mark_found = raw.read_mark()
    with storage.read() as unit:
        mark_known = unit.raw_marks.get()
        if mark_found is not None and mark_found == mark_known:
            return mark_found
        some = unit.chunks.ends(LOOKED_FOR)
        if some and not any(raw.holds(record.digest, record.suffix) for record in some):
            reason = (
                "holds no recording of this database and not its mark: is it mounted? Is it the right one?"
                " Nothing is written there until it is the store of the recordings again"
            )
            raise PassingFaultError(reason, file=raw.url)
    with storage.write() as unit:
        mark = mark_found or unit.raw_marks.get() or uuid.uuid4().hex
        if unit.raw_marks.get() != mark:
            unit.raw_marks.set(mark, now_ns)
    if mark_found is None:
        raw.write_mark(mark)
    return mark

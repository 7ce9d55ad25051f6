"""The spool of one vehicle: a bounded folder of pieces that grow at their end and are removed after their receipt.

What is in the spool is removed for no other reason. When it is full, what comes is refused. Pieces hold records, each
with its length and checksum, so that every whole one is found whatever was cut off: a head (mark, bytes of the body,
CRC-32 of length and body) and a body, two counts of dropped frames, then frames of 21 bytes, all little endian.
"""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import threading
import zlib
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from estimation.errors import ConflictError, StorageError
from fleet_db.atomic_files import sync_directory
from ingest.frames import DATA_BYTES

MARK = b"TWf1"
FRAME = np.dtype([("t_ns", "<i8"), ("arbitration_id", "<u4"), ("dlc", "u1"), ("data", "u1", (DATA_BYTES,))])
FRAME_BYTES = FRAME.itemsize

_HEAD = struct.Struct("<4sII")
_COUNTS = struct.Struct("<QQ")
_FRAME = struct.Struct("<qIB8s")
_LONGEST_BODY = 1 << 21  # a longer one is no record: a damaged length must not hide what follows


@dataclass(frozen=True, slots=True)
class Record:
    """Frames that were written together."""

    frames: bytes
    dropped: int = 0  # frames that were dropped behind these
    dropped_total: int = 0  # of this vehicle up to here, by this process and those before it


@dataclass(frozen=True, slots=True)
class Contents:
    """What a file of records holds."""

    records: tuple[Record, ...]
    end: int  # the byte behind the last of them
    skipped: int  # bytes before that which are damaged


def pack_frame(t_ns: int, arbitration_id: int, dlc: int, data: bytes) -> bytes:
    """Return the bytes of a frame."""
    return _FRAME.pack(t_ns, arbitration_id, dlc, data)


def encode(record: Record) -> bytes:
    """Return the bytes of a record."""
    body = _COUNTS.pack(record.dropped, record.dropped_total) + record.frames
    return _HEAD.pack(MARK, len(body), _checksum(body)) + body


def decode(content: bytes) -> Contents:
    """Return every whole record of a file, in order; what is torn or damaged is skipped."""
    records: list[Record] = []
    at = end = skipped = 0
    while (start := content.find(MARK, at)) >= 0:
        record, following = _record(content, start)
        if record is None:
            at = start + 1
            continue
        skipped += start - end
        records.append(record)
        at = end = following
    return Contents(tuple(records), end, skipped)


def _record(content: bytes, at: int) -> tuple[Record | None, int]:
    body_at = at + _HEAD.size
    if body_at > len(content):
        return None, at
    _, length, checksum = _HEAD.unpack_from(content, at)
    end = body_at + length
    frames_length = length - _COUNTS.size
    if end > len(content) or length > _LONGEST_BODY or frames_length < 0 or frames_length % FRAME_BYTES:
        return None, at
    body = content[body_at:end]
    if _checksum(body) != checksum:
        return None, at
    dropped, total = _COUNTS.unpack_from(body)
    return Record(body[_COUNTS.size :], dropped, total), end


def _checksum(body: bytes) -> int:
    return zlib.crc32(body, zlib.crc32(len(body).to_bytes(4, "little")))


class FrameBuffer:
    """Frames in memory, oldest first. When it is full the newest are dropped."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._lock = threading.Lock()
        self._frames = bytearray()
        self.dropped = 0  # frames, since the start
        self._handed_over = 0

    @property
    def size_bytes(self) -> int:
        """Bytes that wait."""
        return len(self._frames)

    def add(self, frame: bytes) -> None:
        """Keep a packed frame, or count it as dropped; never waits for a disk."""
        with self._lock:
            if len(self._frames) + FRAME_BYTES <= self._limit:
                self._frames += frame
            else:
                self.dropped += 1

    def count_dropped(self, frames: int) -> None:
        """Count frames that were dropped before they came here."""
        with self._lock:
            self.dropped += frames

    def take(self, limit_bytes: int) -> tuple[bytes, int]:
        """Return the oldest frames, of so many bytes at most, and how many were dropped behind them."""
        with self._lock:
            frames = bytes(self._frames[:limit_bytes])
            del self._frames[:limit_bytes]
            if self._frames or not frames:
                return frames, 0
            dropped = self.dropped - self._handed_over
            self._handed_over = self.dropped
            return frames, dropped


_SLOT = struct.Struct("<QQQ")  # write number, total, recorded
_CHECKSUM = struct.Struct("<I")
_SLOT_BYTES = 512  # a sector, which a disk writes as a whole. The two are written in turn: one is whole at any time.


@dataclass(frozen=True, slots=True)
class DropCount:
    """Frames that were dropped: all of them, and those of them that a record in the spool mentions."""

    total: int = 0
    recorded: int = 0


class DropCountFile:
    """The count on the disk."""

    def __init__(self, path: Path) -> None:
        self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        content = os.pread(self._handle, 2 * _SLOT_BYTES, 0)
        if len(content) < 2 * _SLOT_BYTES:
            os.pwrite(self._handle, bytes(2 * _SLOT_BYTES - len(content)), len(content))
            os.fsync(self._handle)
        slots = [(0, 0, 0)]
        for at in (0, _SLOT_BYTES):
            slot = content[at : at + _SLOT.size]
            if len(content) >= at + _SLOT.size + _CHECKSUM.size:
                (checksum,) = _CHECKSUM.unpack_from(content, at + _SLOT.size)
                slots += [_SLOT.unpack(slot)] if zlib.crc32(slot) == checksum else []
        self._number, *counts = max(slots)
        self.count = DropCount(*counts)

    def write(self, count: DropCount) -> None:
        """Put a count on the disk; where that fails (OSError) the count before is still there."""
        if count == self.count:
            return
        slot = _SLOT.pack(self._number + 1, count.total, count.recorded)
        at = (self._number + 1) % 2 * _SLOT_BYTES
        os.pwrite(self._handle, slot + _CHECKSUM.pack(zlib.crc32(slot)), at)
        os.fsync(self._handle)
        self._number += 1
        self.count = count

    def close(self) -> None:
        """Close the file."""
        os.close(self._handle)


PIECE_SUFFIX = ".frames"
SET_ASIDE_SUFFIX = ".aside"


@dataclass(frozen=True, slots=True)
class Piece:
    """A file of the spool that grows no more."""

    path: Path
    size_bytes: int


@dataclass(frozen=True, slots=True)
class TakenOver:
    """What an earlier process left."""

    pieces: int
    torn_bytes: int  # behind the last whole record: written when the process was killed
    damaged_bytes: int  # elsewhere: the disk


def spool_folder(parent: Path, vehicle: str) -> Path:
    """Return the folder of a vehicle."""
    name = quote(vehicle, safe=" ")
    return parent / (f"%2E{name[1:]}" if name.startswith(".") else name)


class Spool:
    """The spool of one vehicle, held by this process alone; raises ConflictError where another one holds it.

    One thread appends and closes pieces, another one takes the closed ones; both may ask for sizes.
    """

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self._folder = folder
        self._limit = limit_bytes
        self._lock = threading.Lock()
        self._waiting: deque[Piece] = deque()
        self._aside_bytes = 0
        self.pieces_aside = 0  # that could not be stored whatever was tried; the next start tries again
        self._open: _OpenPiece | None = None
        self._next = 1
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._holder = _hold(folder)
            self._drops = DropCountFile(folder / "dropped")
        except OSError as error:
            raise StorageError(f"the spool {folder} cannot be used: {error.strerror}") from error

    @property
    def size_bytes(self) -> int:
        """How much it holds."""
        with self._lock:
            return self._size()

    @property
    def pieces_waiting(self) -> int:
        """Closed pieces without a receipt."""
        return len(self._waiting)

    @property
    def drop_count(self) -> DropCount:
        """Frames of this vehicle that were dropped, also by processes before this one."""
        return self._drops.count

    def take_over(self) -> TakenOver:
        """Make what an earlier process left ready to be stored; call it once, first."""
        torn = damaged = 0
        pieces: list[Piece] = []
        count = self._drops.count
        paths = sorted(path for path in self._folder.iterdir() if path.suffix in (PIECE_SUFFIX, SET_ASIDE_SUFFIX))
        for path in paths:
            content = path.read_bytes()
            contents = decode(content)
            torn += len(content) - contents.end
            damaged += contents.skipped
            if contents.end == 0:
                path.unlink()
                continue
            if contents.end < len(content):  # so that the piece is the same whenever it is read
                with path.open("r+b") as file:
                    file.truncate(contents.end)
                    os.fsync(file.fileno())
            last = max(record.dropped_total for record in contents.records)
            count = DropCount(max(count.total, last), max(count.recorded, last))
            pieces.append(Piece(path.replace(path.with_suffix(PIECE_SUFFIX)), contents.end))
        self._drops.write(count)
        with self._lock:
            self._waiting.extend(pieces)
            self._next = max((int(path.stem) for path in paths if path.stem.isdigit()), default=0) + 1
        return TakenOver(len(pieces), torn, damaged)

    def append(self, record: Record) -> None:
        """Put a record on the disk; it is there when this returns.

        Raises StorageError where the spool is full, OSError where the disk is or fails: nothing of the record counts.
        """
        content = encode(record)
        with self._lock:
            size = self._size()
        if size + len(content) > self._limit:
            raise StorageError(f"the spool is full: {size:,} of {self._limit:,} bytes")
        if self._open is None:
            self._open = _OpenPiece(self._folder / f"{self._next:012d}{PIECE_SUFFIX}")
            self._next += 1
        try:
            self._open.append(content)
        except OSError:
            self._open.cut()
            self.close_piece()  # after a failed fsync nobody knows what of the file is on the disk
            raise

    def count_dropped(self, count: DropCount) -> None:
        """Put the number of dropped frames on the disk."""
        self._drops.write(count)

    def close_piece(self) -> None:
        """End the piece that grows; it waits for its receipt from now on."""
        piece, self._open = self._open, None
        if piece is None:
            return
        piece.close()
        with self._lock:
            if piece.size_bytes:
                self._waiting.append(Piece(piece.path, piece.size_bytes))
            else:
                piece.path.unlink(missing_ok=True)

    def oldest(self) -> Piece | None:
        """Return the piece that has waited longest, None when none waits."""
        with self._lock:
            return self._waiting[0] if self._waiting else None

    def remove(self, piece: Piece) -> None:
        """Remove a piece that has its receipt; where the disk fails (OSError) it still waits."""
        piece.path.unlink(missing_ok=True)
        with self._lock:
            self._waiting.remove(piece)

    def set_aside(self, piece: Piece) -> None:
        """Keep a piece that cannot be stored out of the way of the others, until the next start."""
        piece.path.replace(piece.path.with_suffix(SET_ASIDE_SUFFIX))
        with self._lock:
            self._waiting.remove(piece)
            self._aside_bytes += piece.size_bytes
            self.pieces_aside += 1

    def close(self) -> None:
        """End the piece that grows, and let another process have the spool."""
        self.close_piece()
        self._drops.close()
        os.close(self._holder)

    def _size(self) -> int:
        growing = self._open.size_bytes if self._open is not None else 0
        return growing + self._aside_bytes + sum(piece.size_bytes for piece in self._waiting)


class _OpenPiece:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.size_bytes = 0
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        sync_directory(path.parent)

    def append(self, content: bytes) -> None:
        written = 0
        while written < len(content):
            written += os.pwrite(self._handle, content[written:], self.size_bytes + written)
        os.fsync(self._handle)
        self.size_bytes += len(content)

    def cut(self) -> None:
        """Take back what was written of a record that failed; what stays of it is skipped by its checksum."""
        try:
            os.ftruncate(self._handle, self.size_bytes)
            os.fsync(self._handle)
        except OSError:
            return

    def close(self) -> None:
        os.close(self._handle)


def _hold(folder: Path) -> int:
    path = folder / "lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(handle, 200, 0).decode(errors="replace").strip()
        os.close(handle)
        raise ConflictError(
            f"another receiver of this vehicle is at work ({holder}); it holds {path}", kind="spool", key=str(folder)
        ) from None
    try:
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"{socket.gethostname()}, process {os.getpid()}\n".encode(), 0)
    except OSError:
        return handle  # the name is for people; a full disk does not keep the lock from us
    return handle

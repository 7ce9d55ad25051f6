"""Records of frames in a file: each has its length and checksum, so that every whole one is found whatever was cut off.

A record is a head (mark, bytes of the body, CRC-32 of length and body) and a body: two counts of dropped frames, then
frames of 21 bytes. All numbers are little endian.
"""

from __future__ import annotations

import struct
import threading
import zlib
from dataclasses import dataclass

import numpy as np

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
        self._dropped = 0
        self._handed_over = 0

    @property
    def dropped(self) -> int:
        """Frames dropped since the start."""
        return self._dropped

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
                self._dropped += 1

    def count_dropped(self, frames: int) -> None:
        """Count frames that were dropped before they came here."""
        with self._lock:
            self._dropped += frames

    def take(self, limit_bytes: int) -> tuple[bytes, int]:
        """Return the oldest frames, of so many bytes at most, and how many were dropped behind them."""
        with self._lock:
            frames = bytes(self._frames[:limit_bytes])
            del self._frames[:limit_bytes]
            if self._frames or not frames:
                return frames, 0
            dropped = self._dropped - self._handed_over
            self._handed_over = self._dropped
            return frames, dropped

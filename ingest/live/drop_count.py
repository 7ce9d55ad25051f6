"""How many frames of a vehicle were ever dropped: a file that is written in place, also on a full disk."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

_SLOT = struct.Struct("<QQQ")  # write number, total, recorded
_CHECKSUM = struct.Struct("<I")
_SLOT_BYTES = 512
"""A sector, which a disk writes as a whole. The two are written in turn: one is whole at any time."""


@dataclass(frozen=True, slots=True)
class DropCount:
    """Frames that were dropped: all of them, and those of them that a record in the spool mentions."""

    total: int = 0
    recorded: int = 0


class DropCountFile:
    """The count on the disk.

    Args:
        path: The file; made if it is missing.

    Raises:
        OSError: It cannot be made or read.
    """

    def __init__(self, path: Path) -> None:
        self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        content = os.pread(self._handle, 2 * _SLOT_BYTES, 0)
        if len(content) < 2 * _SLOT_BYTES:
            os.pwrite(self._handle, bytes(2 * _SLOT_BYTES - len(content)), len(content))
            os.fsync(self._handle)
        slots = [_slot(content[at : at + _SLOT_BYTES]) for at in (0, _SLOT_BYTES)]
        self._number, *counts = max((slot for slot in slots if slot is not None), default=(0, 0, 0))
        self.count = DropCount(*counts)

    def write(self, count: DropCount) -> None:
        """Put a count on the disk.

        Raises:
            OSError: The disk failed; the count before is still there.
        """
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


def _slot(content: bytes) -> tuple[int, int, int] | None:
    if len(content) < _SLOT.size + _CHECKSUM.size:
        return None
    (checksum,) = _CHECKSUM.unpack_from(content, _SLOT.size)
    if zlib.crc32(content[: _SLOT.size]) != checksum:
        return None
    number, total, recorded = _SLOT.unpack_from(content)
    return number, total, recorded

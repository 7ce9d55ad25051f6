"""A recording on its way into the raw store: written beside the others under no name, hashed as it is written."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from estimation.errors import InputError
from fleet_db.passing import passing_faults

PIECE_BYTES = 1 << 20
PREFIX = ".incoming-"
"""What a killed process leaves begins so; a purge deletes it."""


class IncomingFile:
    """A file that grows until it is finished; what is not placed in the raw store by then is deleted at the end.

    It is made with the first piece.

    Args:
        directory: In which it is made; made itself if it is missing.
        suffix: Of its format; its name ends so.
        durable: Whether it is on the disk once it is finished; not where it only waits to be sent elsewhere.
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
        """Write the next piece.

        Raises:
            PassingFaultError: No space, or the disk failed.
        """
        with passing_faults(self._directory), memoryview(piece) as left:
            file = self._file or self._made()
            written = 0
            while written < len(left):
                written += file.write(left[written:]) or 0
        self._hash.update(piece)
        self.size_bytes += len(piece)

    def finish(self) -> None:
        """Put what was written on the disk, where it is to be durable, and close the file.

        Raises:
            PassingFaultError: The disk failed; nothing that was written counts.
        """
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.discard()


def pieces_of(source: Path) -> Iterator[bytes]:
    """Yield the bytes of a file of others.

    Raises:
        InputError: It cannot be read; names it.
    """
    try:
        with source.open("rb") as stream:
            while piece := stream.read(PIECE_BYTES):
                yield piece
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=source) from error

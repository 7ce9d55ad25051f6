"""Raw recordings, addressed by their content: on the disk before they are reported as stored."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from estimation.errors import InputError, ParameterError, PassingFaultError
from fleet_db.atomic_files import sync_directory, write_atomically
from fleet_db.incoming import IncomingFile
from fleet_db.passing import passing_faults

PIECE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class RawStore:
    """Recordings under one directory."""

    directory: Path

    def path(self, digest: str, suffix: str) -> Path:
        """Return where the recording of this digest is.

        Raises
        ------
        ParameterError
            ``digest`` is no sha256 in hexadecimal, or ``suffix`` no plain ending.
        """
        if len(digest) != hashlib.sha256().digest_size * 2 or set(digest) - set("0123456789abcdef"):
            raise ParameterError(f"{digest!r} is no sha256", field="digest")
        if not (suffix.startswith(".") and suffix[1:].isalnum()):
            raise ParameterError(f"{suffix!r} is no plain file ending", field="suffix")
        return self.directory / digest[:2] / f"{digest}{suffix}"

    def size(self, digest: str, suffix: str) -> int:
        """Return the size of a recording, bytes.

        Raises
        ------
        PassingFaultError
            Its file cannot be reached.
        """
        path = self.path(digest, suffix)
        with passing_faults(path):
            return path.stat().st_size

    def check(self, digest: str, suffix: str) -> None:
        """Read a recording and compare it with its digest.

        Raises
        ------
        PassingFaultError
            Its file cannot be reached, or holds something else: a copy of it can be put there, or received again.
        """
        path = self.path(digest, suffix)
        with passing_faults(path):
            whole = _digest_of(path) == digest
        if not whole:
            raise PassingFaultError("is damaged: its content has another digest", file=path)

    def fault(self, digest: str, suffix: str) -> PassingFaultError | None:
        """Return what is wrong with the file of a recording; None where it is whole."""
        try:
            self.check(digest, suffix)
        except PassingFaultError as fault:
            return fault
        return None

    def put_bytes(self, data: bytes, suffix: str) -> str:
        """Store ``data`` durably; return its digest. The same bytes again change nothing, but heal a damaged file.

        Raises
        ------
        PassingFaultError
            They cannot be stored now: no space, no permission.
        """
        digest = hashlib.sha256(data).hexdigest()
        path = self.path(digest, suffix)
        with passing_faults(path):
            if not _whole(path, digest):
                write_atomically(path, data, durable=True)
        return digest

    def remove(self, digest: str, suffix: str) -> None:
        """Remove a recording; one that is not there is removed already.

        Raises
        ------
        PassingFaultError
            Its file cannot be removed now.
        """
        path = self.path(digest, suffix)
        with passing_faults(path):
            path.unlink(missing_ok=True)

    def put_file(self, source: Path, admit: Callable[[str], None] = lambda _digest: None) -> str:
        """Store the file ``source`` durably without holding it in memory; return its digest.

        Parameters
        ----------
        source
            The file.
        admit
            Called with the digest before the recording is stored; what it raises leaves nothing behind.

        Raises
        ------
        InputError
            The file cannot be read; names it.
        PassingFaultError
            It cannot be stored now: no space, no permission.
        """
        with IncomingFile(self.directory) as incoming:
            for piece in pieces_of(source):
                incoming.write(piece)
            incoming.finish()
            admit(incoming.digest)
            self.synchronise(self.place(incoming, source.suffix.lower()))
            return incoming.digest

    def place(self, incoming: IncomingFile, suffix: str) -> set[Path]:
        """Give a file that is on the disk its name; a whole one of that name stays, a damaged one is replaced.

        Parameters
        ----------
        incoming
            The file, finished.
        suffix
            Of its format.

        Returns
        -------
        set[Path]
            Directories that are to be synchronised before anybody may rely on it.

        Raises
        ------
        PassingFaultError
            It cannot be renamed now.
        """
        path = self.path(incoming.digest, suffix)
        with passing_faults(path):
            if not _whole(path, incoming.digest):
                path.parent.mkdir(parents=True, exist_ok=True)
                incoming.path.replace(path)
        return {path.parent, self.directory}  # also of one that was there: who placed it may not have synchronised

    def synchronise(self, directories: Iterable[Path]) -> None:
        """Put the names in these directories on the disk.

        Parameters
        ----------
        directories
            From :meth:`place`, of any number of files.

        Raises
        ------
        PassingFaultError
            The disk failed.
        """
        for directory in sorted(directories):
            with passing_faults(directory):
                sync_directory(directory)


def pieces_of(source: Path) -> Iterator[bytes]:
    """Yield the bytes of a file of others.

    Parameters
    ----------
    source
        The file.

    Raises
    ------
    InputError
        It cannot be read; names it.
    """
    try:
        with source.open("rb") as stream:
            while piece := stream.read(PIECE_BYTES):
                yield piece
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=source) from error


def _whole(path: Path, digest: str) -> bool:
    """Whether a file is there with the content of this digest; one that is damaged is written again."""
    return path.is_file() and _digest_of(path) == digest


def _digest_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

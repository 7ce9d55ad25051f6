"""Files that are either there whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from estimation.errors import PassingFaultError
from estimation.values.reasons import ReasonCode


def write_atomically(path: Path, content: bytes, *, durable: bool) -> None:
    """Write ``content`` beside ``path`` and rename it into place, whole for every reader; ``durable``: on the disk."""
    if not path.parent.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".writing-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    if durable:
        sync_directory(path.parent)
        sync_directory(path.parent.parent)


def sync_directory(directory: Path) -> None:
    """Put the names in ``directory`` on the disk."""
    synchronise(directory, os.O_DIRECTORY)


def synchronise(path: Path, flags: int = 0) -> None:
    """Put a file on the disk."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def passing_faults(path: Path) -> Iterator[None]:
    """Turn errors of the system (no space, no mount, no permission) at a path of ours into PassingFaultError."""
    try:
        yield
    except OSError as error:
        raise passing_fault(error, path) from error


def passing_fault(error: OSError, path: Path) -> PassingFaultError:
    """Return an error of the system at a path of ours as ours."""
    code = ReasonCode.WAITS_FOR_MEMORY if error.errno == errno.ENOMEM else ReasonCode.WAITS_FOR_STORAGE
    return PassingFaultError(error.strerror or str(error), file=path, code=code)


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def unlink_old(path: Path, least_age_s: float) -> int | None:
    """Delete a file unless it was written or used again less than this age ago; return its size, None if it stays."""
    try:
        status = path.stat()
        if status.st_mtime > time.time() - least_age_s:
            return None
        path.unlink()
    except FileNotFoundError:
        return None
    return status.st_size

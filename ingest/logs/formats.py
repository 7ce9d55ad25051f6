"""The log formats that are read, by the suffix of a file; its contents must be of the same format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from estimation.errors import LogFileError
from fleet_db.atomic_files import passing_fault
from ingest.frames import FrameBatch
from ingest.logs import asc, blf_reader, candump, mf4
from ingest.logs.log_format import LogFormat, ReadLimits, limits_of
from ingest.logs.processes import LogContent, ReadCost, read_in_process

FORMATS = (blf_reader.FORMAT, asc.FORMAT, candump.FORMAT, mf4.FORMAT)
"""A new format is a module with its ``FORMAT``, and its entry here."""

SUFFIXES = tuple(item.suffix for item in FORMATS)
_HEAD_BYTES = 64


def read_log(path: Path, limits: ReadLimits | None = None) -> FrameBatch:
    """Return the frames of a recording of one bus; see :func:`read_content`."""
    return read_content(path, limits).batch


def read_content(
    path: Path, limits: ReadLimits | None = None, cost: Callable[[ReadCost], None] | None = None
) -> LogContent:
    """Read a recording of one bus, in a process of its own.

    Args:
        limits: What reading may cost; by default what a file of its size and format may need.

    Raises:
        LogFileError: The file is no such log, its contents are not of its suffix's format, it is truncated or corrupt,
            or reading it would cost more than the limits allow. Names the file, and the byte or line.
        PassingFaultError: The machine cannot read it now.
    """
    expected = format_of(path)
    held, size = _format_held(path)
    if held is None:
        raise LogFileError(f"is no {expected.name} log", file=path)
    if held is not expected:
        raise LogFileError(f"is called {expected.suffix} but holds a {held.name} log", file=path)
    if limits is None:
        limits = limits_of(size, expected.bytes_per_s, expected.memory_bytes)
    return read_in_process(path, expected, limits, cost)


def format_of(path: Path) -> LogFormat:
    """Return the format that the suffix of a file names, in upper or lower case."""
    for item in FORMATS:
        if item.suffix == path.suffix.lower():
            return item
    raise LogFileError(f"is no log file: the suffix is none of {', '.join(SUFFIXES)}", file=path)


def _format_held(path: Path) -> tuple[LogFormat | None, int]:
    try:
        if not path.is_file() and path.exists():
            raise LogFileError("is no file", file=path)
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
            size = file.seek(0, 2)
    except FileNotFoundError as error:
        raise LogFileError(error.strerror or str(error), file=path) from error
    except OSError as error:
        raise passing_fault(error, path) from error
    return next((item for item in FORMATS if item.is_held(head)), None), size

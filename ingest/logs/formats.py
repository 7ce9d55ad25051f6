"""The log formats that are read, by the suffix of a file; its contents must be of the same format."""

from __future__ import annotations

from pathlib import Path

from estimation.errors import LogFileError
from ingest.frames import FrameBatch
from ingest.logs import asc, blf_reader, candump, mf4
from ingest.logs.library import read_with_library
from ingest.logs.log_format import DEFAULT_LIMITS, LogFormat, ReadLimits

FORMATS = (blf_reader.FORMAT, asc.FORMAT, candump.FORMAT, mf4.FORMAT)
"""A new format is a module with its ``FORMAT``, and its entry here."""

SUFFIXES = tuple(item.suffix for item in FORMATS)
_HEAD_BYTES = 64


def read_log(path: Path, limits: ReadLimits = DEFAULT_LIMITS) -> FrameBatch:
    """Read a recording of one bus.

    Parameters
    ----------
    path
        A file of one of ``FORMATS``.
    limits
        What reading may cost.

    Raises
    ------
    LogFileError
        The file is no such log, its contents are not of its suffix's format, it is truncated or corrupt, or reading it
        would cost more than the limits allow. Names the file, and the byte or line.
    """
    expected = format_of(path)
    held = _format_held(path)
    if held is None:
        raise LogFileError(f"is no {expected.name} log", file=path)
    if held is not expected:
        raise LogFileError(f"is called {expected.suffix} but holds a {held.name} log", file=path)
    if expected.read is not None:
        return expected.read(path, limits)
    return read_with_library(path, limits)


def format_of(path: Path) -> LogFormat:
    """Return the format that the suffix of a file names, in upper or lower case.

    Parameters
    ----------
    path
        The file; it need not exist.

    Raises
    ------
    LogFileError
        The suffix names no format that can be read.
    """
    for item in FORMATS:
        if item.suffix == path.suffix.lower():
            return item
    raise LogFileError(f"is no log file: the suffix is none of {', '.join(SUFFIXES)}", file=path)


def _format_held(path: Path) -> LogFormat | None:
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise LogFileError(error.strerror or str(error), file=path) from error
    return next((item for item in FORMATS if item.is_held(head)), None)

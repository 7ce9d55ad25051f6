"""Which reader and writer a log file gets: by what it holds *and* by what it is called."""

from __future__ import annotations

import os
from pathlib import Path

from estimation.errors import LogFileError
from ingest.frames import FrameBatch
from ingest.logs.blf_reader import read_blf
from ingest.logs.blf_writer import write_blf
from ingest.logs.library import read_with_library, write_with_library
from ingest.logs.limits import DEFAULT_LIMITS, ReadLimits

BLF, ASC, CANDUMP, MF4 = ".blf", ".asc", ".log", ".mf4"

SUFFIXES = (BLF, ASC, CANDUMP, MF4)
"""Suffixes of the log files that can be read and written."""

_NAMES = {BLF: "BLF", ASC: "ASC", CANDUMP: "candump", MF4: "MF4"}
_HEAD = 64


def read_log(path: Path, limits: ReadLimits = DEFAULT_LIMITS) -> FrameBatch:
    """Read a recording of one bus.

    Parameters
    ----------
    path
        A BLF, ASC, candump (``.log``) or MF4 file.
    limits
        What reading may cost.

    Raises
    ------
    LogFileError
        The file is no such log, its contents are not what its suffix says, it is truncated or corrupt, or reading it
        would cost more than the limits allow. Names the file, and the byte or line.
    """
    suffix = suffix_of(path)
    held = _format_held(path)
    if held is None:
        raise LogFileError(f"is no {_NAMES[suffix]} log", file=path)
    if held != suffix:
        raise LogFileError(f"is called {suffix} but holds a {_NAMES[held]} log", file=path)
    if suffix == BLF:
        return read_blf(path, limits)
    return read_with_library(path, limits)


def write_log(path: Path, batch: FrameBatch) -> None:
    """Write a recording in the format that the suffix of ``path`` names; a file that is there is replaced whole.

    Raises
    ------
    LogFileError
        The suffix names no format, or the file cannot be written.
    """
    suffix = suffix_of(path)
    unfinished = path.with_name(f".{path.stem}.{os.getpid()}{suffix}")
    try:
        if suffix == BLF:
            write_blf(unfinished, batch)
        else:
            write_with_library(unfinished, batch)
        unfinished.replace(path)
    except OSError as error:
        raise LogFileError(error.strerror or str(error), file=path) from error
    finally:
        unfinished.unlink(missing_ok=True)


def suffix_of(path: Path) -> str:
    """Return the suffix of a log file, in lower case.

    Raises
    ------
    LogFileError
        It names no format that can be read.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise LogFileError(f"is no log file: the suffix is none of {', '.join(SUFFIXES)}", file=path)
    return suffix


def _format_held(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise LogFileError(error.strerror or str(error), file=path) from error
    if head.startswith(b"LOGG"):
        return BLF
    if head.startswith(b"MDF     "):
        return MF4
    if head[:5].lower() == b"date ":
        return ASC
    return CANDUMP if head.startswith(b"(") else None

"""MF4 logs (ASAM MDF), through python-can and the extra ``mf4``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from estimation.errors import LogFileError
from ingest.logs.log_format import LogFormat


def messages(path: Path) -> Iterable[Any]:
    """Return the frames of an MF4 file as messages of python-can.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    LogFileError
        The extra is not installed.
    """
    import can  # noqa: PLC0415 - in the child process, after its limits are set

    try:
        import asammdf  # noqa: F401, PLC0415 - an extra
    except ImportError as error:
        raise LogFileError("MF4 files need the extra 'mf4': pip install 'treadwatch[mf4]'") from error
    reader: Iterable[Any] = can.MF4Reader(path)
    return reader


FORMAT = LogFormat(suffix=".mf4", name="MF4", is_held=lambda head: head.startswith(b"MDF     "), messages=messages)

"""MF4 logs (ASAM MDF), through python-can and the extra ``mf4``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from estimation.errors import PassingFaultError
from estimation.values.reasons import ReasonCode
from ingest.logs.log_format import LogFormat
from ingest.logs.read_limits import MEBIBYTE


def messages(path: Path) -> Iterable[Any]:
    """Return the frames of an MF4 file as messages of python-can.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    PassingFaultError
        The extra is not installed.
    """
    import can  # noqa: PLC0415 - in the process that reads one file

    try:
        import asammdf  # noqa: F401, PLC0415 - an extra
    except ImportError as error:
        reason = "MF4 files need the extra 'mf4': pip install 'treadwatch[mf4]'"
        raise PassingFaultError(reason, file=path, code=ReasonCode.WAITS_FOR_EXTRA) from error
    reader: Iterable[Any] = can.MF4Reader(path)
    return reader


FORMAT = LogFormat(
    suffix=".mf4",
    name="MF4",
    is_held=lambda head: head.startswith(b"MDF     "),
    messages=messages,
    modules=("asammdf",),
    memory_bytes=64 * MEBIBYTE,
)

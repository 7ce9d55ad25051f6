"""candump logs (``.log``, SocketCAN), through python-can."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ingest.logs.log_format import LogFormat
from ingest.logs.text_lines import check_lines

LINES = re.compile(r"\(\d+\.\d+\) \S+ [0-9A-Fa-f]{3,8}#(?:R[0-8]?|(?:[0-9A-Fa-f]{2}){0,8})(?: [RT])?|\s*")


def messages(path: Path) -> Iterable[Any]:
    """Return the frames of a candump file as messages of python-can.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    LogFileError
        A line is damaged.
    """
    import can  # noqa: PLC0415 - in the child process, after its limits are set

    check_lines(path, LINES)
    reader: Iterable[Any] = can.CanutilsLogReader(path)
    return reader


FORMAT = LogFormat(suffix=".log", name="candump", is_held=lambda head: head.startswith(b"("), messages=messages)

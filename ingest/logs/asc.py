"""ASC logs (Vector, text), through python-can."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ingest.logs.log_format import LogFormat
from ingest.logs.text_lines import check_lines

_TIME = r"\s*\d+\.\d+\s+"
_HEAD = rf"{_TIME}\d+\s+[0-9A-Fa-f]+x?\s+(?:Rx|Tx)\s+"
_BYTES = r"(?:\s+[0-9A-Fa-f]{1,3}){0,8}"
_TAIL = r"(?:\s+(?:Length|BitCount|ID)\s*=.*)?\s*"

LINES = re.compile(
    "|".join(
        (
            rf"{_HEAD}d\s+[0-9A-Fa-f]+{_BYTES}{_TAIL}",
            rf"{_HEAD}r(?:\s+[0-9A-Fa-f]+)?{_TAIL}",
            rf"{_TIME}\d+\s+ErrorFrame.*",
            rf"{_TIME}(?:Start of measurement|log trigger event.*|CAN \d+ Status:.*|\d+\s+Statistic:.*)",
            r"date\s.*|base\s+(?:hex|dec)\s+timestamps\s+absolute\s*",
            r"(?:no )?internal events logged\s*|//.*|Begin Trigger ?block.*|End Trigger ?block.*|\s*",
        )
    ),
    re.IGNORECASE,
)
"""Timestamps ``relative`` (each to the one before) are not among them: python-can would read them as absolute."""


def messages(path: Path) -> Iterable[Any]:
    """Return the frames of an ASC file as messages of python-can; times are absolute.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    LogFileError
        A line is damaged, or the file is truncated.
    """
    import can  # noqa: PLC0415 - in the child process, after its limits are set

    check_lines(path, LINES)
    return _asc_reader(can)(path, relative_timestamp=False)


def _asc_reader(can: Any) -> Callable[..., Iterable[Any]]:  # noqa: ANN401 - the module, imported late
    class PaddedDates(can.ASCReader):  # type: ignore[misc]
        """python-can writes 7 ms as ``.7``; the logs of other tools have three digits."""

        @staticmethod
        def _datetime_to_timestamp(datetime_string: str) -> float:
            before, dot, after = datetime_string.partition(".")
            digits, space, rest = after.partition(" ")
            text = f"{before}{dot}{digits.zfill(3)}{space}{rest}" if dot else datetime_string
            return float(can.ASCReader._datetime_to_timestamp(text))  # noqa: SLF001 - the method we override

    return PaddedDates


FORMAT = LogFormat(suffix=".asc", name="ASC", is_held=lambda head: head[:5].lower() == b"date ", messages=messages)

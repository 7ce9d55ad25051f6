"""What a line of a text log may look like, so that a damaged line is an error and not a frame less.

python-can's readers step over lines that they do not understand; here every line must be one of the known kinds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from estimation.errors import LogFileError

LONGEST_LINE = 1000

_TIME = r"\s*\d+\.\d+\s+"
_HEAD = rf"{_TIME}\d+\s+[0-9A-Fa-f]+x?\s+(?:Rx|Tx)\s+"
_BYTES = r"(?:\s+[0-9A-Fa-f]{1,3}){0,8}"
_TAIL = r"(?:\s+(?:Length|BitCount|ID)\s*=.*)?\s*"

ASC_LINES = re.compile(
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

CANDUMP_LINES = re.compile(r"\(\d+\.\d+\) \S+ [0-9A-Fa-f]{3,8}#(?:R[0-8]?|(?:[0-9A-Fa-f]{2}){0,8})(?: [RT])?|\s*")


def check_lines(path: Path, pattern: re.Pattern[str]) -> None:
    """Check that every line of a text log is of a known kind and the last one is whole.

    Raises
    ------
    LogFileError
        A line is not; names file and line.
    """
    last, opened = 0, False
    for number, line in _lines(path):
        last = number
        if not line.endswith("\n"):
            raise LogFileError("the last line is cut off: truncated", file=path, line=number)
        if not pattern.fullmatch(line.rstrip("\r\n")):
            raise LogFileError(f"no line of such a log: {line[:60].strip()!r}", file=path, line=number)
        if line[:3] in ("Beg", "beg", "End", "end"):
            opened = line[:1] in "Bb"
    if opened:
        raise LogFileError("a trigger block is never ended: truncated", file=path, line=last)
    if last == 0:
        raise LogFileError("is empty", file=path)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    with path.open(encoding="latin-1", newline="\n") as file:
        number = 0
        while line := file.readline(LONGEST_LINE):
            number += 1
            yield number, line

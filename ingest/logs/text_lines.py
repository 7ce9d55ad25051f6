"""What a line of a text log may look like, so that a damaged line is an error and not a frame less.

python-can's readers step over lines that they do not understand; here every line must be one of the known kinds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from estimation.errors import LogFileError

LONGEST_LINE = 1000


def check_lines(path: Path, pattern: re.Pattern[str]) -> None:
    """Check that every line of a text log is of a known kind and the last one is whole.

    Parameters
    ----------
    path
        The file.
    pattern
        What a line may be, without its line end.

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

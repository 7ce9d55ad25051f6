"""MiniProf text files: .whl wheels, .ban rails, .mpt with several parts.

A header of ``keyword=value`` lines in any order and case (values may start with ``%``, lines may be quoted), an empty
line (which some files leave out), rows separated by blanks or commas; ``ColumnDef`` names the columns. A row behind a
quote mark, ``!`` or ``%`` is taken out, but counted in ``XYPoints``. An older header has free lines around one that
begins with MINIPROF or #MINIWHEELPROF; its rows begin after the first empty line only.
"""

from __future__ import annotations

import re

from estimation.errors import ProfileError
from ingest.profiles.points import FilePoints, ProfileFormat, number, points_of

_SECTION = re.compile(r"^\[(?P<name>[^\]]+)\]$")
_REMARK = re.compile(r'["!%]')
_ROW = re.compile(r"^[+-]?\.?\d[^=]*$")
_OLD_HEADER_WITHIN = 3  # lines


def parse_miniprof(text: str, file: str) -> FilePoints:
    """Return the points of a .whl or .ban file."""
    lines = text.splitlines()
    old = any("MINIPROF" in line or "MINIWHEELPROF" in line for line in lines[:_OLD_HEADER_WITHIN] if "=" not in line)
    for index, line in enumerate(lines):
        if not line.strip() or (not old and _ROW.match(line.strip())):
            return _rows(lines, index, len(lines), _header(lines, 0, index), file)
    raise ProfileError("no points follow the header", file=file)


def parse_multipart(text: str, file: str) -> FilePoints:
    """Return the points of the first profile of a .mpt file."""
    lines = text.splitlines()
    marks = [(i, match["name"].lower()) for i, line in enumerate(lines) if (match := _SECTION.match(line.strip()))]
    ends = [start for start, _ in marks[1:]] + [len(lines)]
    spans = {name: (start + 1, end) for (start, name), end in zip(marks, ends, strict=True)}
    if "profile1points" not in spans:
        raise ProfileError("no section [Profile1Points]", file=file)
    header = _header(lines, *spans.get("profile1info", (0, 0)))
    return _rows(lines, *spans["profile1points"], header, file)


def _header(lines: list[str], start: int, end: int) -> dict[str, tuple[int, str]]:
    header = {}
    for index in range(start, end):
        keyword, equals, value = lines[index].strip().strip('"').partition("=")
        if equals:
            header[keyword.strip().lower()] = (index + 1, value.strip().lstrip("%").strip())
    return header


def _rows(lines: list[str], start: int, end: int, header: dict[str, tuple[int, str]], file: str) -> FilePoints:
    at, definition = header.get("columndef", (0, ""))
    columns = [name.strip().upper() for name in (definition or "X,Y").split(",")]
    if "X" not in columns or "Y" not in columns:
        raise ProfileError(f"{definition!r} names no X and Y", file=file, line=at, field="ColumnDef")
    x, y = columns.index("X"), columns.index("Y")
    rows, removed = [], 0
    for index in range(start, end):
        cells = re.split(r"[\s,;]+", _REMARK.split(lines[index], maxsplit=1)[0].strip())
        if cells == [""]:
            removed += bool(lines[index].strip())
            continue
        if len(cells) <= max(x, y):
            raise ProfileError(f"{len(cells)} columns, X and Y are expected", file=file, line=index + 1)
        across = number(cells[x], file=file, line=index + 1, field="X")
        rows.append((index + 1, across, number(cells[y], file=file, line=index + 1, field="Y")))
    line, announced = header.get("xypoints", (0, ""))
    follow = len(rows) + removed
    if announced and follow < number(announced, file=file, line=line, field="XYPoints"):
        reason = f"{announced} points are announced, {follow} follow: truncated?"
        raise ProfileError(reason, file=file, line=line, field="XYPoints")
    return points_of(file, rows)


FORMAT = ProfileFormat("MiniProf", (".whl", ".ban"), parse_miniprof)
MULTIPART_FORMAT = ProfileFormat("MiniProf in parts, the first profile", (".mpt",), parse_multipart)

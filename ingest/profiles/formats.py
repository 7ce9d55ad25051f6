"""The formats of profile files that are read, by the suffix of a file.

MiniProf text files have a header of ``keyword=value`` lines in any order and case (values may start with ``%``, lines
may be quoted), an empty line (which some files leave out), rows separated by blanks or commas; ``ColumnDef`` names the
columns. A row behind a quote mark, ``!`` or ``%`` is taken out, but counted in ``XYPoints``. An older header has free
lines around one that begins with MINIPROF or #MINIWHEELPROF; its rows begin after the first empty line only.

In SIMPACK text files ``!`` and ``%`` begin remarks. Between ``point.begin`` and ``point.end`` stand rows of y, z and
perhaps a weight; the keywords of the spline block transform them, in a fixed order.
"""

from __future__ import annotations

import math
import re

import numpy as np

from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray
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


_TO_MILLIMETRES = 1000.0


def parse_simpack(text: str, file: str) -> FilePoints:
    """Return the points of a .prw or .prr file, transformed by its keywords; mm, z down."""
    keywords: dict[str, tuple[int, str]] = {}
    rows: list[tuple[int, float, float]] = []
    state = "before"
    for line, raw in enumerate(text.splitlines(), start=1):
        content = re.split(r"[!%]", raw, maxsplit=1)[0].strip()
        if content.lower() in ("point.begin", "point.end"):
            state = "inside" if content.lower() == "point.begin" else "after"
        elif state == "inside" and content:
            cells = re.split(r"[\s,]+", content)
            if len(cells) < 2:  # noqa: PLR2004 - y and z
                raise ProfileError(f"{len(cells)} column, y and z are expected", file=file, line=line)
            across = number(cells[0], file=file, line=line, field="y")
            rows.append((line, across, number(cells[1], file=file, line=line, field="z")))
        elif "=" in content:
            keyword, _, value = content.partition("=")
            keywords[keyword.strip().lower()] = (line, value.strip())
    if state != "after":
        raise ProfileError(f"no {'point.end: truncated?' if rows else 'points (point.begin)'}", file=file)
    return _transformed(points_of(file, rows), keywords)


def _transformed(points: FilePoints, keywords: dict[str, tuple[int, str]]) -> FilePoints:
    """Apply the keywords in SIMPACK's order: thinning, shift, rotation, bounds, mirrors, inversion, units."""

    def setting(name: str, default: float = 0.0) -> float:
        line, value = keywords.get(name, (0, ""))
        return number(value, file=points.file, line=line, field=name) if value else default

    smoothing = setting("approx.smooth")
    if smoothing != 0.0:
        raise ProfileError(
            f"{smoothing:g} asks for SIMPACK's own smoothing, whose definition is not published; set it to 0: the "
            "points are then smoothed by their own noise, or by the one that is given",
            file=points.file,
            line=keywords["approx.smooth"][0],
            field="approx.smooth",
        )
    lengths, angles = setting("units.len.f", 1.0), setting("units.ang.f", 1.0)
    if lengths == 0.0 or angles == 0.0:
        raise ProfileError("a unit factor is zero", file=points.file, field="units.len.f, units.ang.f")
    keep = _far_enough(points.y, points.z, setting("point.dist.min"))
    y, z = points.y[keep] + setting("shift.y"), points.z[keep] + setting("shift.z")
    turn = setting("rotate") / angles
    y, z = y * math.cos(turn) - z * math.sin(turn), y * math.sin(turn) + z * math.cos(turn)
    lines = np.array(points.lines)[keep]
    low, high = setting("bound.y.min", 1.0), setting("bound.y.max")
    if low < high:
        inside = (y >= low) & (y <= high)
        y, z, lines = y[inside], z[inside], lines[inside]
    low, high = setting("bound.z.min", 1.0), setting("bound.z.max")
    z = np.clip(z, low, high) if low < high else z
    y = -y if setting("mirror.y") == 1.0 else y
    z = -z if setting("mirror.z") == 1.0 else z
    order = slice(None, None, -1 if setting("inversion") == 1.0 else 1)
    scale = _TO_MILLIMETRES / lengths
    ordered = zip(lines[order], y[order] * scale, z[order] * scale, strict=True)
    rows = [(int(line), float(a), float(b)) for line, a, b in ordered]
    return points_of(points.file, rows, axes_known=True)


def _far_enough(y: FloatArray, z: FloatArray, distance: float) -> list[int]:
    kept = [0]
    for i in range(1, len(y)):
        if math.hypot(y[i] - y[kept[-1]], z[i] - z[kept[-1]]) >= distance:
            kept.append(i)
    return kept


FORMATS = (
    ProfileFormat("MiniProf", (".whl", ".ban"), parse_miniprof),
    ProfileFormat("MiniProf in parts, the first profile", (".mpt",), parse_multipart),
    ProfileFormat("SIMPACK", (".prw", ".prr"), parse_simpack),
)
"""A new format is a module with its ``FORMAT``, and its entry here."""


def format_names() -> str:
    """Return the formats and their suffixes as a text for help and messages."""
    named = [f"{item.name} ({', '.join(item.suffixes)})" for item in FORMATS]
    return f"{', '.join(named)}; any other suffix: two columns of text"

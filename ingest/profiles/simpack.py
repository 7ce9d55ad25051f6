"""SIMPACK text files: .prw wheels, .prr rails.

``!`` and ``%`` begin remarks. Between ``point.begin`` and ``point.end`` stand rows of y, z and perhaps a weight; the
keywords of the spline block transform them, in a fixed order.
"""

from __future__ import annotations

import math
import re

import numpy as np

from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray
from ingest.profiles.points import FilePoints, ProfileFormat, number, points_of

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


FORMAT = ProfileFormat("SIMPACK", (".prw", ".prr"), parse_simpack)

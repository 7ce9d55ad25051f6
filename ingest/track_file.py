"""A track on file: CSV with the columns ``s_m, alignment_mm, gauge_deviation_mm``, as a recording car gives it.

A file of the gauge alone has no column ``alignment_mm``.
The layout of the line, where it is known, is in the columns ``curvature_per_km, cant_mm`` (curvature in 1/km: the
inverse of the radius in km, positive to the left; cant: right rail above the left one), beside the others or in a file
of its own. The line of a section on the map is in the columns ``s_m, latitude_deg, longitude_deg`` (WGS84).
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimation.errors import InputError
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.track import SectionLine, TrackSectionRecord
from ingest.input_file import TABLE_BYTES, read_text_within
from ingest.plausibility import steps_m

COLUMNS = ("s_m", "alignment_mm", "gauge_deviation_mm")
GAUGE_COLUMNS = ("s_m", "gauge_deviation_mm")
LAYOUT_COLUMNS = ("curvature_per_km", "cant_mm")
FEWEST_POINTS = 8
FEWEST_LAYOUT_POINTS = 2
SHARPEST_PER_KM = 20.0  # a radius of 50 m: nothing sharper is run on
HIGHEST_CANT_MM = 250.0
CURVED_PER_KM = 0.5  # a radius of 2 km: with that, a cant below CANTED_MM everywhere is one in metres
CANTED_MM = 1.0
STRAIGHT_PER_KM = 0.02  # a radius of 50 km: with that, a cant above CURVE_CANT_MM is curvature in 1/m
CURVE_CANT_MM = 20.0


def read_track_columns(path: Path) -> FloatArray:
    """Return (n, 3): distance, alignment (positive to the left), gauge deviation (actual minus nominal), all in m.

    Further columns are ignored; blank lines are skipped. Errors name file, line and column.
    """
    table = _table(path, *_cells(path), COLUMNS, FEWEST_POINTS)
    return np.asarray(table * np.array([1.0, 1e-3, 1e-3]), dtype=np.float64)


def read_gauge_columns(path: Path) -> FloatArray | None:
    """Return (n, 2): distance and gauge deviation, both in m, of a file without alignment; None where it has one."""
    header, lines = _cells(path)
    if COLUMNS[1] in header:
        return None
    table = _table(path, header, lines, GAUGE_COLUMNS, FEWEST_POINTS)
    return np.asarray(table * np.array([1.0, 1e-3]), dtype=np.float64)


def read_layout_columns(path: Path) -> FloatArray | None:
    """Return (n, 3): distance in m, curvature in 1/m, cant in m; None where the file has no such columns.

    Refused as ``read_track_columns``, and where one column stands alone or numbers are in another unit.
    """
    header, lines = _cells(path)
    for name in header:
        if name.startswith(("curvature", "cant", "radius")) and name not in LAYOUT_COLUMNS:
            raise InputError(f"expected {' and '.join(LAYOUT_COLUMNS)}", file=path, line=1, field=name)
    if not any(name in header for name in LAYOUT_COLUMNS):
        return None
    table = _table(path, header, lines, (COLUMNS[0], *LAYOUT_COLUMNS), FEWEST_LAYOUT_POINTS)
    _check_layout_units(path, *table[:, 1:].T)
    return np.asarray(table * np.array([1.0, 1e-3, 1e-3]), dtype=np.float64)


def _check_layout_units(path: Path, curvature: FloatArray, cant: FloatArray) -> None:
    sharpest, highest = float(np.abs(curvature).max()), float(np.abs(cant).max())
    if sharpest > SHARPEST_PER_KM:
        reason = f"{sharpest:g} 1/km is a radius of {1e3 / sharpest:.3g} m; are these radii, or another unit?"
        raise InputError(reason, file=path, field=LAYOUT_COLUMNS[0])
    if highest > HIGHEST_CANT_MM:
        raise InputError(f"{highest:g} mm of cant is on no line; another unit?", file=path, field=LAYOUT_COLUMNS[1])
    if sharpest > CURVED_PER_KM and 0.0 < highest < CANTED_MM:
        reason = f"at most {highest:g} mm in curves of down to {1e3 / sharpest:.0f} m; is this cant in metres?"
        raise InputError(reason, file=path, field=LAYOUT_COLUMNS[1])
    if 0.0 < sharpest < STRAIGHT_PER_KM and highest > CURVE_CANT_MM:
        reason = f"at most {sharpest:g} 1/km with {highest:g} mm of cant; is this curvature in 1/m?"
        raise InputError(reason, file=path, field=LAYOUT_COLUMNS[0])


_Row = tuple[int, list[str]]


def _cells(path: Path) -> tuple[list[str], list[_Row]]:
    text = read_text_within(path, TABLE_BYTES, InputError, encoding="utf-8-sig")
    lines = csv.reader(text.splitlines())
    header = [name.strip() for name in next(lines, [])]
    return header, [(lines.line_num, cells) for cells in lines if any(map(str.strip, cells))]


def _table(path: Path, header: list[str], lines: list[_Row], columns: Sequence[str], fewest: int) -> FloatArray:
    for name in columns:
        if name not in header:
            raise InputError(f"no such column; expected {', '.join(columns)}", file=path, line=1, field=name)
    places = [header.index(name) for name in columns]
    if (table := _numbers(lines, places)) is not None and len(table) >= fewest:
        return table
    rows: list[tuple[float, ...]] = []
    for number, cells in lines:
        rows.append(tuple(_number(path, number, cells, *column) for column in zip(columns, places, strict=True)))
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise InputError("distance does not increase", file=path, line=number, field=columns[0])
    if len(rows) < fewest:
        raise InputError(f"{len(rows)} rows are no track, at least {fewest} are needed", file=path)
    return np.array(rows, dtype=np.float64)


def _numbers(lines: list[_Row], places: list[int]) -> FloatArray | None:
    """Return the columns (n, k) quickly; None where a cell is no finite number or distance does not increase."""
    try:
        table = np.array([[float(cells[place]) for place in places] for _, cells in lines])
    except (ValueError, IndexError):
        return None
    fine = len(table) > 0 and np.isfinite(table).all() and (np.diff(table[:, 0]) > 0.0).all()
    return table if fine else None


def uniform_distance(s: FloatArray) -> bool:
    """Whether distances (n,) are evenly spaced, within the millimetre that they are written in."""
    steps = np.diff(s)
    return bool(np.all(np.abs(steps - steps.mean()) <= 1e-6 * steps.mean() + 1.1e-3))


def _number(path: Path, line: int, cells: list[str], name: str, place: int) -> float:
    cell = cells[place].strip() if place < len(cells) else ""
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{cell!r} is not a finite number", file=path, line=line, field=name)
    return value


LINE_COLUMNS = ("s_m", "latitude_deg", "longitude_deg")
FEWEST_LINE_POINTS = 2
MOST_LINE_POINTS = 20_000
MOST_APART_M = 200.0  # between two points: the chord of a radius of 300 m is 17 m from the rail in its middle
LONGER_SHARE, LONGER_M = 0.02, 20.0
"""By which points may be further apart than their distances along the line say: of a map, and rounded."""
SHORTER_SHARE = 0.1  # by which they may be nearer to each other: 200 m along a radius of 150 m have a chord of 186 m
BEYOND_M = 50.0  # by which the points may reach beyond the ends of the section


def read_line(path: Path, section: TrackSectionRecord) -> SectionLine:
    """Return the line of a section; refused where it is not on the section, or places contradict distances."""
    table = _table(path, *_cells(path), LINE_COLUMNS, FEWEST_LINE_POINTS)
    if len(table) > MOST_LINE_POINTS:
        raise InputError(f"{len(table)} points, at most {MOST_LINE_POINTS} may be", file=path)
    for column, most in ((1, 90.0), (2, 180.0)):
        beyond = np.flatnonzero(np.abs(table[:, column]) > most)
        if len(beyond):
            reason = f"{table[beyond[0], column]:g} is beyond {most:g} degrees; exchanged, or another unit?"
            raise InputError(reason, file=path, field=LINE_COLUMNS[column])
    if table[0, 0] < -BEYOND_M or table[-1, 0] > section.length_m + BEYOND_M:
        reason = f"{table[0, 0]:g} to {table[-1, 0]:g} m; section {section.code!r} has 0 to {section.length_m:g} m"
        raise InputError(reason, file=path, field=LINE_COLUMNS[0])
    line = tuple((float(s), float(latitude), float(longitude)) for s, latitude, longitude in table)
    _check_steps(path, line)
    return line


def _check_steps(path: Path, line: SectionLine) -> None:
    along = np.diff([s for s, _, _ in line])
    apart = steps_m(line)
    far = np.flatnonzero(along > MOST_APART_M)
    if len(far):
        begin, end = line[far[0]][0], line[far[0] + 1][0]
        reason = f"no point between {begin:g} and {end:g} m, at most {MOST_APART_M:g} m may be"
        raise InputError(reason, file=path, field=LINE_COLUMNS[0])
    wrong = np.flatnonzero(_contradicted(along, apart))
    if len(wrong):
        begin, end = line[wrong[0]][0], line[wrong[0] + 1][0]
        reason = f"{begin:g} and {end:g} m along the line are {apart[wrong[0]]:,.0f} m apart on the map"
        raise InputError(reason, file=path)
    whole = along.sum(), apart.sum()
    if _contradicted(*map(np.atleast_1d, whole))[0]:
        reason = f"{whole[0]:,.0f} m of line are {whole[1]:,.0f} m long on the map; exchanged, or another unit?"
        raise InputError(reason, file=path)


def _contradicted(along: FloatArray, apart: FloatArray) -> BoolArray:
    """Return which distances (n,) on the map are none of points that are ``along`` apart on the line, m."""
    longest = (1.0 + LONGER_SHARE) * along + LONGER_M
    return np.asarray((apart > longest) | (apart < (1.0 - SHORTER_SHARE) * along - LONGER_M))

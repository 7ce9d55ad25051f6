"""A track on file: CSV with the columns ``s_m, alignment_mm, gauge_deviation_mm``, as a recording car gives it."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from estimation.arrays import FloatArray
from estimation.errors import InputError

COLUMNS = ("s_m", "alignment_mm", "gauge_deviation_mm")
FEWEST_POINTS = 8


def read_track_columns(path: Path) -> FloatArray:
    """Return (n, 3): distance, alignment (positive to the left), gauge deviation (actual minus nominal), all in m.

    Further columns are let be; blank lines are skipped.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a cell is not a finite number, distances do not increase, or
        there are fewer than eight rows; names file, line and column.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=path) from error
    except UnicodeDecodeError as error:
        raise InputError("is no text file", file=path) from error
    lines = csv.reader(text.splitlines())
    header = [name.strip() for name in next(lines, [])]
    for name in COLUMNS:
        if name not in header:
            raise InputError(f"no such column; expected {', '.join(COLUMNS)}", file=path, line=1, field=name)
    places = [header.index(name) for name in COLUMNS]
    rows: list[tuple[float, ...]] = []
    for cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        rows.append(
            tuple(_number(path, lines.line_num, cells, *column) for column in zip(COLUMNS, places, strict=True))
        )
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise InputError("distance does not increase", file=path, line=lines.line_num, field="s_m")
    if len(rows) < FEWEST_POINTS:
        raise InputError(f"{len(rows)} rows are no track, at least {FEWEST_POINTS} are needed", file=path)
    return np.asarray(np.array(rows) * np.array([1.0, 1e-3, 1e-3]), dtype=np.float64)


def uniform_distance(s: FloatArray) -> bool:
    """Whether distances (n,) are evenly spaced, as far as the millimetre that they are written in can tell."""
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

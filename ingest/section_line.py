"""The line of a section on file: CSV with the columns ``s_m, latitude_deg, longitude_deg`` (WGS84)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from estimation.errors import InputError
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.track import SectionLine, TrackSectionRecord
from ingest.plausibility.vehicle_place import steps_m
from ingest.track_file import read_columns

COLUMNS = ("s_m", "latitude_deg", "longitude_deg")
FEWEST_POINTS = 2
MOST_POINTS = 20_000
MOST_APART_M = 200.0
"""Between two points: the chord of a radius of 300 m is 17 m from the rail in its middle."""
LONGER_SHARE, LONGER_M = 0.02, 20.0
"""By which points may be further apart than their distances along the line say: of a map, and rounded."""
SHORTER_SHARE = 0.1
"""By which they may be nearer to each other: 200 m along a radius of 150 m have a chord of 186 m."""
BEYOND_M = 50.0
"""By which the points may reach beyond the ends of the section."""


def read_line(path: Path, section: TrackSectionRecord) -> SectionLine:
    """Return the line of a section, checked.

    Raises:
        InputError: As ``read_columns``; or a coordinate is out of range, the points are not on the section, too far
            apart, or their places contradict their distances (jumps, exchanged columns, another unit).
    """
    table = read_columns(path, COLUMNS, FEWEST_POINTS)
    if len(table) > MOST_POINTS:
        raise InputError(f"{len(table)} points, at most {MOST_POINTS} may be", file=path)
    for column, most in ((1, 90.0), (2, 180.0)):
        beyond = np.flatnonzero(np.abs(table[:, column]) > most)
        if len(beyond):
            reason = f"{table[beyond[0], column]:g} is beyond {most:g} degrees; exchanged, or another unit?"
            raise InputError(reason, file=path, field=COLUMNS[column])
    if table[0, 0] < -BEYOND_M or table[-1, 0] > section.length_m + BEYOND_M:
        reason = f"{table[0, 0]:g} to {table[-1, 0]:g} m; section {section.code!r} has 0 to {section.length_m:g} m"
        raise InputError(reason, file=path, field=COLUMNS[0])
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
        raise InputError(reason, file=path, field=COLUMNS[0])
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

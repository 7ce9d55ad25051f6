"""What a reader of profile files takes and gives: a text, and points with the line of each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray


class Origin(StrEnum):
    """What y = 0 of a wheel file is. A rail needs none: it is placed by its gauge."""

    AUTO = "auto"  # by the distance from the tip of the flange
    DATUM = "datum"  # the tread datum, 70 mm from the flange back
    FLANGE_BACK = "flange-back"


MOST_ROWS = 50_000  # of a profile: one in some 3 um


@dataclass(frozen=True, slots=True)
class FilePoints:
    """Rows of a profile file in their order: lateral and vertical coordinate, mm.

    With ``axes_known``, z points down and a wheel's y starts at its tread datum; else axes are as the file has them.
    """

    file: str
    y: FloatArray  # (n,) mm
    z: FloatArray  # (n,) mm
    lines: tuple[int, ...]  # (n,) line numbers, 1 is the first
    axes_known: bool = False


@dataclass(frozen=True, slots=True)
class ProfileFormat:
    """A format of profile files; ``formats.FORMATS`` lists them."""

    name: str
    suffixes: tuple[str, ...]  # in lower case, with their dots
    parse: Callable[[str, str], FilePoints]  # content, and the name for messages; raises ProfileError


def points_of(file: str, rows: list[tuple[int, float, float]], *, axes_known: bool = False) -> FilePoints:
    """Return rows as points."""
    if len(rows) < 4:  # noqa: PLR2004 - a profile needs four points
        raise ProfileError(f"{len(rows)} profile points found, at least 4 are needed: rows of y and z in mm", file=file)
    if len(rows) > MOST_ROWS:
        raise ProfileError(
            f"{len(rows):,} profile points found, at most {MOST_ROWS:,} are possible; give a file of one profile, or "
            "every so many points of it",
            file=file,
            line=rows[MOST_ROWS][0],
            field="y",
        )
    table = np.array([row[1:] for row in rows])
    return FilePoints(file, table[:, 0], table[:, 1], tuple(row[0] for row in rows), axes_known)


def number(text: str, *, file: str, line: int, field: str) -> float:
    """Return a cell as a finite number."""
    try:
        value = float(text)
    except ValueError:
        raise ProfileError(f"{text!r} is not a number", file=file, line=line, field=field) from None
    if not math.isfinite(value):
        raise ProfileError(f"{text!r} is not a finite number", file=file, line=line, field=field)
    return value

"""Two columns of text: lateral and vertical coordinate, a header line tolerated."""

from __future__ import annotations

import re

from estimation.errors import ProfileError
from ingest.profiles.points import FilePoints, number, points_of

_DECIMAL_COMMAS = re.compile(r"^[+-]?\d+,\d+(\s*;\s*|\s+)[+-]?\d+(,\d+)?$")


def parse_columns(text: str, file: str, unit: float) -> FilePoints:
    """Return the points of a two-column file; separators are commas, semicolons or blanks.

    Lines that begin with ``#`` and leading lines without any number are skipped. Further columns are ignored.

    Args:
        unit: Millimetres in one unit of the file: 1, or 1000 for metres.

    Raises:
        ProfileError: Decimal commas, a row with fewer than two columns or with something that is not a finite number.
    """
    rows: list[tuple[int, float, float]] = []
    for line, raw in enumerate(text.lstrip("\ufeff").splitlines(), start=1):
        content = raw.split("#", maxsplit=1)[0].strip()
        if not content or (not rows and not re.match(r"^[+-]?(\d|\.\d|nan|inf)", content, re.IGNORECASE)):
            continue
        if _DECIMAL_COMMAS.match(content):
            raise ProfileError("decimal commas; write decimal points", file=file, line=line)
        cells = [cell for cell in re.split(r"[\s,;]+", content) if cell]
        if len(cells) < 2:  # noqa: PLR2004 - y and z
            raise ProfileError(f"{len(cells)} column, two are expected", file=file, line=line)
        across = number(cells[0], file=file, line=line, field="y")
        rows.append((line, across * unit, number(cells[1], file=file, line=line, field="z") * unit))
    return points_of(file, rows)

"""Numbers in the unit of a file that a reader turns back into exactly the number that is stored."""

from __future__ import annotations

import math
from collections.abc import Callable

NEAREST = 4  # neighbours of the quotient that are tried, either way


def in_unit(stored: float, read: Callable[[float], float], factor: float) -> float:
    """Return the number that a reader turns into the stored one, to the last bit where there is such a number.

    Args:
        stored: In SI units.
        read: What the reader does with a number of the file.
        factor: The number of the file is about ``stored * factor``.
    """
    tried = above = below = stored * factor
    if read(tried) == stored:
        return tried
    for _ in range(NEAREST):
        above, below = math.nextafter(above, math.inf), math.nextafter(below, -math.inf)
        for candidate in (above, below):
            if read(candidate) == stored:
                return candidate
    return tried


def thousandths(stored: float) -> float:
    """Return metres as millimetres, or anything else that a reader multiplies by 1e-3.

    Args:
        stored: In the greater unit.
    """
    return in_unit(stored, lambda value: 1e-3 * value, 1e3)

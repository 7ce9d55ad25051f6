"""Frozen values compared bit by bit."""

from __future__ import annotations

from dataclasses import is_dataclass

import numpy as np


def same_values(first: object, second: object) -> bool:
    """Whether two frozen values hold the same bits, arrays included; NaN equals NaN."""
    if type(first) is not type(second):
        return False
    names = [name for cls in type(first).__mro__ for name in getattr(cls, "__slots__", ())]
    for name in names:
        a, b = getattr(first, name), getattr(second, name)
        if isinstance(a, np.ndarray):
            if not (a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()):
                return False
        elif is_dataclass(a):
            if not same_values(a, b):
                return False
        elif isinstance(a, tuple) and a and is_dataclass(a[0]):
            if len(a) != len(b) or not all(same_values(one, other) for one, other in zip(a, b, strict=True)):
                return False
        elif a != b and not (a != a and b != b):  # noqa: PLR0124 - NaN is the value unequal to itself
            return False
    return True

"""All cells as arrays, made once for every amplitude: which wheel and which rails, and what was found there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.rails import RailKey, SectionConicity, WheelKey

NS_PER_YEAR = 365.25 * 86_400e9


@dataclass(frozen=True, slots=True, eq=False)
class CellTable:
    """Cells, and what they are of."""

    amplitude: FloatArray  # (k,) m
    wheels: tuple[WheelKey, ...]  # w, in order
    rails: tuple[RailKey, ...]  # s, in order
    serials: tuple[str, ...]  # of wheelsets, in order
    wheel: IntArray  # (n,) number of the wheel
    rail: IntArray  # (n,) number of the rails
    serial: IntArray  # (w,) number of the wheelset of each wheel
    conicity: FloatArray  # (n, k)
    sampled: FloatArray  # (n, k)
    systematic: FloatArray  # (n, k)
    scale: FloatArray  # (n,) relative, of a scale of y - d
    windows: IntArray  # (n,)
    years: FloatArray  # (n,) middle of what was seen, since 1970

    def given(self, k: int) -> BoolArray:
        """Return which cells (n,) are known at an amplitude."""
        found = np.isfinite(self.conicity[:, k]) & np.isfinite(self.sampled[:, k])
        return np.asarray(found & np.isfinite(self.systematic[:, k]))


def cell_table(cells: Sequence[SectionConicity], amplitude: FloatArray) -> CellTable:
    """Return cells as arrays.

    Args:
        cells: All, in the order of their keys.
        amplitude: (k,) m, of all.
    """
    wheels, rails = sorted({cell.wheel for cell in cells}), sorted({cell.rail for cell in cells})
    serials = sorted({key.wheelset for key in wheels})
    of_wheel = {key: place for place, key in enumerate(wheels)}
    of_rail = {key: place for place, key in enumerate(rails)}
    of_serial = {key: place for place, key in enumerate(serials)}
    shape = (len(cells), len(amplitude))
    columns = {
        name: np.array([getattr(cell, name) for cell in cells]).reshape(shape)
        for name in ("conicity", "sampled", "systematic")
    }
    return CellTable(
        amplitude=amplitude,
        wheels=tuple(wheels),
        rails=tuple(rails),
        serials=tuple(serials),
        wheel=np.array([of_wheel[cell.wheel] for cell in cells], np.int64),
        rail=np.array([of_rail[cell.rail] for cell in cells], np.int64),
        serial=np.array([of_serial[key.wheelset] for key in wheels], np.int64),
        scale=np.array([cell.scale_std for cell in cells]),
        windows=np.array([cell.windows for cell in cells], np.int64),
        years=np.array([0.5 * (cell.from_ns + cell.to_ns) for cell in cells]) / NS_PER_YEAR,
        **columns,
    )

"""The sums of all passes of a section as arrays with an entry for every place of every pass, in order of place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.opinions import INVERSE, WindowAdhesion


@dataclass(frozen=True, slots=True)
class PassSums(FrozenArrays):
    """n entries at c places, of v vehicles and w wheelsets."""

    samples: Annotated[FloatArray, "n"]  # as in ``FrictionSums``
    squares: Annotated[FloatArray, "n", 6]
    saturated: Annotated[FloatArray, "n", 4, len(INVERSE)]
    place: Annotated[IntArray, "n"]  # index of the place, rising
    vehicle: Annotated[IntArray, "n"]  # index
    wheelset: Annotated[IntArray, "n"]  # index
    smoothed: Annotated[FloatArray, "n"]  # 1 where vibration was taken out of the forces, else 0
    cells: Annotated[IntArray, "k"]  # numbers of the places
    vehicles: tuple[str, ...]  # (v,) codes
    wheelsets: tuple[str, ...]  # (w,) serials

    @property
    def counts(self) -> IntArray:
        """How many passes there are of each place, (c,)."""
        return np.bincount(self.place, minlength=len(self.cells)).astype(np.int64)

    @property
    def vehicles_of_places(self) -> IntArray:
        """How many vehicles have passed each place, (c,)."""
        passed = np.unique(self.place * len(self.vehicles) + self.vehicle) // len(self.vehicles)
        return np.bincount(passed, minlength=len(self.cells)).astype(np.int64)

    def by_place(self, values: FloatArray) -> FloatArray:
        """Return the sums of values of entries, (n,) or (n, k), over each place, (c,) or (c, k).

        Args:
            values: (n,) or (n, k) of any unit.
        """
        first = np.searchsorted(self.place, np.arange(len(self.cells)))
        return np.asarray(np.add.reduceat(values, first, axis=0), np.float64)

    def at(self, inverse: FloatArray) -> FloatArray:
        """Return the saturated sums (4, n) at 1/mu of the places, linear between those that are kept.

        Args:
            inverse: (c,) 1/mu.
        """
        return self.at_each(inverse[self.place])

    def at_each(self, inverse: FloatArray) -> FloatArray:
        """Return the saturated sums (4, n), each at its own 1/mu; beyond those that are kept the last ones.

        Args:
            inverse: (n,) 1/mu.
        """
        bounded = np.clip(inverse, INVERSE[0], INVERSE[-1])
        high = np.clip(np.searchsorted(INVERSE, bounded), 1, len(INVERSE) - 1)
        part = (bounded - INVERSE[high - 1]) / (INVERSE[high] - INVERSE[high - 1])
        entries = np.arange(len(self.place))
        low_values, high_values = self.saturated[entries, :, high - 1], self.saturated[entries, :, high]
        return np.asarray((low_values + part[:, None] * (high_values - low_values)).T)


def pass_sums(passes: Sequence[WindowAdhesion]) -> PassSums | None:
    """Return the sums of passes; None where none says anything."""
    ordered = sorted(passes, key=lambda one: one.key)
    known = [(one, one.sums) for one in ordered if one.sums is not None and len(one.sums.cells)]
    if not known:
        return None
    lengths = [len(sums.cells) for _, sums in known]
    cells, place = np.unique(np.concatenate([sums.cells for _, sums in known]), return_inverse=True)
    order = np.argsort(place, kind="stable")
    vehicles, vehicle = np.unique([one.vehicle for one, _ in known], return_inverse=True)
    wheelsets, wheelset = np.unique([one.wheelset for one, _ in known], return_inverse=True)
    return PassSums(
        np.concatenate([sums.samples for _, sums in known])[order],
        np.concatenate([sums.squares for _, sums in known])[order],
        np.concatenate([sums.saturated for _, sums in known])[order],
        place[order],
        np.repeat(vehicle, lengths)[order],
        np.repeat(wheelset, lengths)[order],
        np.repeat([float(one.smoothed) for one, _ in known], lengths)[order],
        cells,
        tuple(str(name) for name in vehicles),
        tuple(str(name) for name in wheelsets),
    )

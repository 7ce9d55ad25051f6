"""The grid of a section, with the filters that everything on it is compared through."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from estimation.filters.local_cubic import local_cubic_kernel
from estimation.values.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class SectionGrid:
    """Uniform grid over a section, and the kernels of its two high-passes; made once and handed on."""

    length: float  # m
    step: float  # m
    cutoff_wavelength: float  # m, of everything that is compared
    difference_cutoff_wavelength: float  # m, of R before h is applied to it: h is not linear, so R must be whole
    impact_difference: float  # m of R; beyond are flange impacts, hunting, clipped sensors: what is near is left out
    kernel: FloatArray = field(init=False, repr=False, compare=False)  # of ``cutoff_wavelength``
    difference_kernel: FloatArray = field(init=False, repr=False, compare=False)  # of ``difference_cutoff_wavelength``

    def __post_init__(self) -> None:
        object.__setattr__(self, "kernel", local_cubic_kernel(self.cutoff_wavelength, self.step))
        object.__setattr__(self, "difference_kernel", local_cubic_kernel(self.difference_cutoff_wavelength, self.step))

    @property
    def points(self) -> int:
        """Grid points of the section."""
        return int(self.length / self.step) + 1

    @property
    def s(self) -> FloatArray:
        """Distance (n,) of the grid points, m."""
        return np.asarray(np.arange(self.points) * self.step, dtype=np.float64)

    @property
    def filter_reach(self) -> int:
        """Grid points at each end of a pass that both filters together cannot use."""
        return (len(self.kernel) + len(self.difference_kernel)) // 2

    def contains(self, points: IntArray) -> BoolArray:
        """Return which grid points (m,) are on the section (m,)."""
        return np.asarray((points >= 0) & (points < self.points))

"""Passes on the grid of their section: resampled and filtered once per position.

A vehicle's stiffness ratio scales part of R. Resampling and filter are linear, so another ratio needs neither again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.filters import high_pass, local_cubic_kernel, valid_support
from estimation.track.passes import Journey, Pass, ProfileLife, gridded
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.track import Correction


@dataclass(frozen=True, slots=True)
class SectionGrid:
    """Uniform grid over a section, and the kernels of its two high-passes; made once and handed on."""

    length: float  # m
    step: float  # m
    cutoff_wavelength: float  # m, of everything that is compared
    difference_cutoff_wavelength: float  # m, of R: h(R) is not linear, so R keeps longer waves
    impact_difference: float  # m of R; beyond it is an impact or clipped, and what is near is left out
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

    def contains(self, points: IntArray) -> BoolArray:
        """Return which grid points (m,) are on the section (m,)."""
        return np.asarray((points >= 0) & (points < self.points))


@dataclass(frozen=True, slots=True)
class GriddedPass:
    """A pass on the grid of the section; empty where it is too short for the filters or off the section."""

    source: Pass  # at the position where it was resampled
    ratio: float  # stiffness ratio of its vehicle that ``difference`` is computed with
    points: IntArray  # (m,) grid points, increasing by one
    displacement: FloatArray  # (m,) y, m, slow part meaningless
    unit_difference: FloatArray  # (m,) R at ratio one, m, high-passed, also where it is uncertain
    unit_stiffness_term: FloatArray  # (m,) m, part of R that scales with the ratio, likewise
    difference: FloatArray  # (m,) R, m, up to the grid's difference_cutoff_wavelength; zero where uncertain
    stiffness_term: FloatArray  # (m,) m, likewise
    certain: BoolArray  # (m,) where R is known, and no impact
    inside: BoolArray  # (m,) on the section, certain over the reach of both kernels

    @property
    def life(self) -> ProfileLife:
        """Profile life of the wheelset."""
        return self.source.life

    @property
    def side(self) -> int:
        """-1 where the wheelset's left wheel runs on the section's right rail, else 1."""
        return self.source.side

    @property
    def empty(self) -> bool:
        """Whether nothing of it can be used."""
        return not self.inside.any()

    @property
    def used_points(self) -> IntArray:
        """Grid points (n,) that can be used."""
        return self.points[self.inside]


def grid_pass(item: Pass, grid: SectionGrid, ratio: float = 1.0) -> GriddedPass:
    """Return a pass on the grid of its section, R for a stiffness ratio of its vehicle."""
    first, displacement, difference = gridded(item, grid.step)
    points = np.arange(first, first + len(displacement), dtype=np.int64)
    nothing, nowhere = np.zeros(0), np.zeros(0, dtype=np.bool_)
    if len(points) <= 2 * ((len(grid.kernel) + len(grid.difference_kernel)) // 2) + 1:  # the filters use it up
        none = np.zeros(0, dtype=np.int64)
        return GriddedPass(item, ratio, none, nothing, nothing, nothing, nothing, nothing, nowhere, nowhere)
    stiffness_term = (
        np.zeros(len(points))
        if item.stiffness_term is None
        else np.interp(points * grid.step, item.at, item.stiffness_term)
    )
    R, E = high_pass(np.stack([difference, stiffness_term]), grid.difference_kernel)
    unmasked = GriddedPass(item, ratio, points, displacement, R, E, nothing, nothing, nowhere, nowhere)
    return _masked(unmasked, ratio, grid)


def with_ratio(item: GriddedPass, ratio: float, grid: SectionGrid) -> GriddedPass:
    """Return a gridded pass for another stiffness ratio of its vehicle, neither resampled nor filtered again."""
    if ratio == item.ratio or not len(item.points):
        return replace(item, ratio=ratio)
    return _masked(item, ratio, grid)


def _masked(item: GriddedPass, ratio: float, grid: SectionGrid) -> GriddedPass:
    R = item.unit_difference + (ratio - 1.0) * item.unit_stiffness_term
    certain = valid_support(np.ones(len(R), dtype=np.bool_), grid.difference_kernel)
    certain &= np.abs(R) <= grid.impact_difference
    return replace(
        item,
        ratio=ratio,
        difference=np.where(certain, R, 0.0),
        stiffness_term=np.where(certain, item.unit_stiffness_term, 0.0),
        certain=certain,
        inside=valid_support(certain, grid.kernel) & grid.contains(item.points),
    )


@dataclass(frozen=True, slots=True)
class PlacedJourney:
    """The passes of a journey at corrected positions."""

    correction: Correction
    passes: tuple[GriddedPass, ...]


Placed = Mapping[Journey, PlacedJourney]


def place(
    grouped: Mapping[Journey, Sequence[Pass]],
    corrections: Mapping[Journey, Correction],
    ratios: Mapping[str, float],
    grid: SectionGrid,
    before: Placed | None = None,
) -> dict[Journey, PlacedJourney]:
    """Return the passes at corrected positions on the grid; a journey that has not moved is taken as it was."""
    placed = {}
    for journey, members in grouped.items():
        last = None if before is None else before.get(journey)
        if last is None or last.correction != corrections[journey]:
            correction = corrections[journey]
            moved = [replace(item, at=correction.at(item.at)) for item in members]
            passes = tuple(grid_pass(item, grid, ratios.get(item.vehicle, 1.0)) for item in moved)
            last = PlacedJourney(correction, passes)
        placed[journey] = last
    return with_ratios(placed, ratios, grid)


def with_ratios(placed: Placed, ratios: Mapping[str, float], grid: SectionGrid) -> dict[Journey, PlacedJourney]:
    """Return the passes for other stiffness ratios, by vehicle; 1 where there is none."""
    return {
        journey: replace(
            one, passes=tuple(with_ratio(item, ratios.get(item.source.vehicle, 1.0), grid) for item in one.passes)
        )
        for journey, one in placed.items()
    }


def resampled(item: Pass, life: ProfileLife, step: float) -> Pass:
    """Return a pass on a grid, under the life of its wheelset's profile."""
    first, displacement, difference = gridded(item, step)
    at = (first + np.arange(len(displacement))) * step
    return replace(
        item,
        life=life,
        at=np.asarray(at, dtype=np.float64),
        displacement=displacement,
        difference=difference,
        stiffness_term=None if item.stiffness_term is None else np.interp(at, item.at, item.stiffness_term),
    )

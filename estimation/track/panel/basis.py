"""The functions of a pass that its lateral displacement is a sum of, on the grid of the section."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from estimation.errors import ParameterError
from estimation.filters.local_cubic import high_pass, local_cubic_kernel, valid_support
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.passes import Pass, gridded
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.track import GaugeShift


@dataclass(frozen=True, slots=True)
class PanelParameters:
    """Grid, filter and functions of the panel."""

    step: float = 1.0  # m
    length: float = 12_000.0  # m of the section
    cutoff_wavelength: float = 30.0  # m
    difference_cutoff_wavelength: float = (
        120.0  # m, of R before h is applied to it: h is not linear, so R must be whole
    )
    reach: float = 5.0e-3  # m of R that the hat functions span, both ways; further out is flange contact, and h flat
    impact: float = 6.0e-3  # m of R; beyond lie flange impacts, hunting and clipped sensors: what is near is left out
    hats: int = 41
    gauge: FloatArray | None = field(default=None, compare=False)  # (points,) m, deviation; None: none is modelled
    gauge_basis_count: int = 15
    shifts: Mapping[str, GaugeShift] | None = field(default=None, compare=False)  # of wheelsets, as far as known
    measured: Mapping[str, MeasuredCurve] | None = field(default=None, compare=False)  # of wheelsets, as far as known
    weights: Mapping[str, float] | None = field(default=None, compare=False)  # of a pass, by wheelset; 1 unless told
    gauge_unit: float = 2e-3  # m
    groups: int = 12  # of the jackknife, dealt along the section
    block: float = 250.0  # m
    roughness: float = 1e-3  # of h, relative to the data
    least_passes: int = 3  # at a place

    def __post_init__(self) -> None:
        for name in (
            "step",
            "length",
            "cutoff_wavelength",
            "difference_cutoff_wavelength",
            "reach",
            "impact",
            "block",
            "gauge_unit",
        ):
            if not getattr(self, name) > 0:
                raise ParameterError(f"{getattr(self, name)!r} is not positive", field=name)

    @property
    def points(self) -> int:
        """Grid points of the section."""
        return int(self.length / self.step) + 1

    @property
    def knots(self) -> FloatArray:
        """Knots (hats,) of R, m."""
        return _knots(self.reach, self.hats)

    @property
    def gauge_knots(self) -> FloatArray:
        """Knots (gauge_hats,) of R, m, of h1 and h2."""
        return _knots(self.reach, self.gauge_basis_count)

    @property
    def columns(self) -> int:
        """Unknowns per wheelset: h0, then h1 and h2 where gauge is modelled, then the stiffness term."""
        return self.hats + (0 if self.gauge is None else 2 * self.gauge_basis_count) + 1

    def weight_of(self, wheelset: str) -> float:
        """Return how much a pass of this wheelset counts."""
        return 1.0 if self.weights is None else self.weights.get(wheelset, 1.0)

    @property
    def reach_points(self) -> int:
        """Grid points at each end of a pass that the two filters cannot say anything of."""
        return (
            len(local_cubic_kernel(self.cutoff_wavelength, self.step))
            + len(local_cubic_kernel(self.difference_cutoff_wavelength, self.step))
        ) // 2


def _knots(reach: float, count: int) -> FloatArray:
    """Return knots (count,), closer together around zero, where contact jumps are small and data many."""
    return np.asarray(reach * np.sinh(np.linspace(-1.5, 1.5, count)) / np.sinh(1.5))


def filtered(
    item: Pass, parameters: PanelParameters
) -> tuple[IntArray, npt.NDArray[np.float32], FloatArray, FloatArray] | None:
    """Return grid points (m,), filtered columns (k, m), y (m,) and R (m,) of a pass; None where it is too short.

    Columns and R change their sign where the wheelset's left wheel runs on the section's right rail.
    """
    felt = on_grid(item, parameters)
    if felt is None:
        return None
    weights = local_cubic_kernel(parameters.cutoff_wavelength, parameters.step)
    # single precision: half the time, and columns have no drift that would use it up
    shapes = columns(felt, parameters).astype(np.float32)
    B = high_pass(shapes, weights.astype(np.float32))[:, felt.inside]
    y, R = high_pass(np.stack([felt.displacement, felt.difference]), weights)[:, felt.inside]
    return felt.points[felt.inside], item.side * B, y, item.side * R


def pass_residual(item: Pass, curve: FloatArray, parameters: PanelParameters) -> tuple[IntArray, FloatArray] | None:
    """Return grid points (m,) and the filtered y - h(R) (m,) of a pass, m; None where it is too short.

    Parameters
    ----------
    item
        The pass.
    curve
        (columns,) coefficients of its wheelset.
    parameters
        Of the panel.
    """
    felt = on_grid(item, parameters)
    if felt is None:
        return None
    rest = felt.displacement - item.side * (curve @ columns(felt, parameters))
    filtered_rest = high_pass(rest, local_cubic_kernel(parameters.cutoff_wavelength, parameters.step))
    return felt.points[felt.inside], filtered_rest[felt.inside]


@dataclass(frozen=True, slots=True)
class OnGrid:
    """A pass on the grid of the section; ``inside`` where both filters see enough of it, and no impact."""

    points: IntArray  # (m,)
    displacement: FloatArray  # (m,) y, m, without ``shift``, slow part meaningless
    shift: FloatArray  # (m,) m, what is known beforehand of what the gauge does to y
    difference: FloatArray  # (m,) R, m, without what is longer than ``difference_cutoff_wavelength``
    stiffness_term: FloatArray  # (m,) m
    certain: BoolArray  # (m,) where R is, and no impact
    inside: BoolArray  # (m,)


def on_grid(item: Pass, parameters: PanelParameters) -> OnGrid | None:
    """Return a pass on the grid, R high-passed once; None where it is too short or off the section."""
    first, displacement, difference = gridded(item, parameters.step)
    points = np.arange(first, first + len(displacement))
    if len(points) <= 2 * parameters.reach_points + 1:
        return None
    long = local_cubic_kernel(parameters.difference_cutoff_wavelength, parameters.step)
    certain = valid_support(np.ones(len(points), dtype=np.bool_), long)
    stiffness_term = (
        np.zeros(len(points))
        if item.stiffness_term is None
        else np.interp(points * parameters.step, item.at, item.stiffness_term)
    )
    R, E = high_pass(np.stack([difference, stiffness_term]), long)
    certain &= np.abs(R) <= parameters.impact
    inside = valid_support(certain, local_cubic_kernel(parameters.cutoff_wavelength, parameters.step))
    inside &= (points >= 0) & (points < parameters.points)
    if not inside.any():
        return None
    R, E = np.where(certain, R, 0.0), np.where(certain, E, 0.0)
    shift = _shift(item, points, R, parameters)
    return OnGrid(points, displacement - shift, shift, R, E, certain, inside)


def _shift(item: Pass, points: IntArray, R: FloatArray, parameters: PanelParameters) -> FloatArray:
    known = None if parameters.shifts is None else parameters.shifts.get(item.wheelset)
    if known is None:
        return np.zeros(len(points))
    return item.side * known.at(R, gauge_at(points, parameters))


def columns(felt: OnGrid, parameters: PanelParameters) -> FloatArray:
    """Return the functions (k, m) of a pass that its displacement is a sum of, before the filter."""
    R = np.clip(felt.difference, -parameters.reach, parameters.reach)
    rows = [basis_functions(R, parameters.knots)]
    if parameters.gauge is not None:
        coarse = basis_functions(R, parameters.gauge_knots)
        e = gauge_at(felt.points, parameters) / parameters.gauge_unit
        rows += [coarse * e, coarse * e**2]
    return np.concatenate([*rows, felt.stiffness_term[None, :]])


def gauge_at(points: IntArray, parameters: PanelParameters) -> FloatArray:
    """Return the gauge deviation (m,) at grid points, m; zero off the section."""
    assert parameters.gauge is not None
    on = (points >= 0) & (points < parameters.points)
    return np.where(on, parameters.gauge[np.clip(points, 0, parameters.points - 1)], 0.0)


def basis_functions(R: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the values (k, n) of the piecewise linear functions of R; beyond the outer knots they go on straight."""
    cell = np.clip(np.searchsorted(knots, R) - 1, 0, len(knots) - 2)
    share = (R - knots[cell]) / (knots[cell + 1] - knots[cell])
    values = np.zeros((len(knots), len(R)))
    at = np.arange(len(R))
    values[cell, at] = 1.0 - share
    values[cell + 1, at] = share
    return values

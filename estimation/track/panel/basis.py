"""The functions of a pass that its lateral displacement is a sum of, on the grid of the section."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.errors import ParameterError
from estimation.filters import high_pass
from estimation.track.gridded_pass import GriddedPass, SectionGrid
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.passes import ProfileLife
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.track import GaugeShift


@dataclass(frozen=True, slots=True)
class PanelParameters:
    """Grid, filter and basis functions of the panel."""

    step: float = 1.0  # m
    length: float = 12_000.0  # m of the section
    cutoff_wavelength: float = 30.0  # m
    difference_cutoff_wavelength: float = 120.0  # m, of R before h is applied to it
    reach: float = 5.0e-3  # m of R that the basis functions span, both ways; beyond is flange contact, and h flat
    impact: float = 6.0e-3  # m of R, beyond which nothing is used
    basis_count: int = 41  # basis functions of h0
    gauge_basis_count: int = 15  # of h1, and of h2
    gauge_unit: float = 2e-3  # m
    groups: int = 12  # of the jackknife: blocks along the section in turn
    block: float = 250.0  # m
    roughness: float = 1e-3  # of h, relative to the data
    least_passes: int = 3  # at a grid point

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
    def knots(self) -> FloatArray:
        """Knots (basis_count,) of R, m."""
        return _knots(self.reach, self.basis_count)

    @property
    def gauge_knots(self) -> FloatArray:
        """Knots (gauge_basis_count,) of R, m, of h1 and h2."""
        return _knots(self.reach, self.gauge_basis_count)


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel regression: its parameters, the grid of the section, and what is known before it is solved."""

    parameters: PanelParameters
    grid: SectionGrid
    gauge: FloatArray | None = None  # (points,) m, deviation; None: none is modelled
    gauge_shifts: Mapping[ProfileLife, GaugeShift] = field(default_factory=dict)
    measured: Mapping[ProfileLife, MeasuredCurve] = field(default_factory=dict)
    weights: Mapping[ProfileLife, float] = field(default_factory=dict)  # of a pass; 1 where there is none

    @classmethod
    def of(cls, p: PanelParameters, measured: Mapping[ProfileLife, MeasuredCurve] | None = None) -> Panel:
        """Return the panel with the grid of some parameters."""
        grid = SectionGrid(p.length, p.step, p.cutoff_wavelength, p.difference_cutoff_wavelength, p.impact)
        return cls(p, grid, measured=measured or {})

    def weight_of(self, life: ProfileLife) -> float:
        """Return how much a pass of this wheelset counts."""
        return self.weights.get(life, 1.0)

    def with_gauge(self, gauge: FloatArray, gauge_shifts: Mapping[ProfileLife, GaugeShift] | None = None) -> Panel:
        """Return the panel with a gauge deviation (points,), m; its shifts stay as they are by default."""
        return replace(self, gauge=gauge, gauge_shifts=self.gauge_shifts if gauge_shifts is None else gauge_shifts)

    @property
    def unknowns(self) -> int:
        """Unknowns per wheelset: h0, then h1 and h2 where gauge is modelled, then the stiffness term."""
        p = self.parameters
        return p.basis_count + (0 if self.gauge is None else 2 * p.gauge_basis_count) + 1


def _knots(reach: float, count: int) -> FloatArray:
    """Return knots (count,), closer together around zero, where contact jumps are small and data many."""
    return np.asarray(reach * np.sinh(np.linspace(-1.5, 1.5, count)) / np.sinh(1.5))


def unfiltered_residual(item: GriddedPass, curve: FloatArray, panel: Panel) -> FloatArray:
    """Return y - h(R) (m,) of a pass at all its grid points, m, before any filter."""
    shift = known_shift(item, panel)
    return np.asarray(item.displacement - shift - item.side * curve_displacement(item, curve, panel))


def pass_residual(item: GriddedPass, curve: FloatArray, panel: Panel) -> FloatArray:
    """Return the high-passed y - h(R) (m,) of a pass at all its grid points, m."""
    return high_pass(unfiltered_residual(item, curve, panel), panel.grid.kernel)


def known_shift(item: GriddedPass, panel: Panel) -> FloatArray:
    """Return what is known beforehand of what the gauge does to y (m,), m."""
    shift = panel.gauge_shifts.get(item.life)
    if shift is None:
        return np.zeros(len(item.points))
    return item.side * shift.at(item.difference, gauge_at(item.points, panel))


def curve_displacement(item: GriddedPass, curve: FloatArray, panel: Panel) -> FloatArray:
    """Return ``curve`` (k,) times the functions that a pass's displacement is a sum of (m,), m, before the filter."""
    p = panel.parameters
    R = np.clip(item.difference, -p.reach, p.reach)
    displacement = np.interp(R, p.knots, curve[: p.basis_count]) + curve[-1] * item.stiffness_term
    if panel.gauge is not None:
        first, second = gauge_curves(curve, panel)
        e = gauge_at(item.points, panel) / p.gauge_unit
        displacement += e * np.interp(R, p.gauge_knots, first) + e**2 * np.interp(R, p.gauge_knots, second)
    return np.asarray(displacement)


def gauge_curves(curve: FloatArray, panel: Panel) -> tuple[FloatArray, FloatArray]:
    """Return h1 and h2 at the gauge knots (gauge_basis_count,), m, of the coefficients (unknowns,) of a wheelset."""
    start, count = panel.parameters.basis_count, panel.parameters.gauge_basis_count
    return curve[start : start + count], curve[start + count : start + 2 * count]


def gauge_at(points: IntArray, panel: Panel) -> FloatArray:
    """Return the gauge deviation (m,) at grid points (m,), m; zero off the section."""
    assert panel.gauge is not None
    on = panel.grid.contains(points)
    return np.where(on, panel.gauge[np.clip(points, 0, panel.grid.points - 1)], 0.0)


def basis_functions(R: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the piecewise linear functions (k, n) of R (n,), m; beyond the knots (k,), m, they go on straight."""
    cell, share = knot_shares(R, knots)
    values = np.zeros((len(knots), len(R)))
    at = np.arange(len(R))
    values[cell, at] = 1.0 - share
    values[cell + 1, at] = share
    return values


def knot_shares(R: FloatArray, knots: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the number of the knot (k,) below R (n,), m, and the share of the next one: outside 0 to 1 beyond them."""
    cell = np.clip(np.searchsorted(knots, R) - 1, 0, len(knots) - 2)
    return cell, (R - knots[cell]) / (knots[cell + 1] - knots[cell])

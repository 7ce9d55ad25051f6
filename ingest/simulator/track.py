"""The track as it truly is: lateral alignment, gauge deviation and curves along a section."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.errors import InputError, ParameterError, ScenarioError
from estimation.values.arrays import FloatArray, frozen_array
from ingest.simulator.curves import Curve, Curves, laid_out
from ingest.simulator.spectra import synthesise
from ingest.track_file import (
    COLUMNS,
    FEWEST_POINTS,
    GAUGE_COLUMNS,
    LAYOUT_COLUMNS,
    read_layout_columns,
    read_track_columns,
)


@dataclass(frozen=True, slots=True)
class TrackTruth:
    """Alignment and gauge deviation on a uniform grid of distance; between grid points a cubic spline."""

    s: FloatArray  # (n,) m, uniform
    alignment: FloatArray  # (n,) m, d, positive to the left
    gauge_deviation: FloatArray  # (n,) m, actual minus nominal gauge
    curves: Curves | None = None  # on the same grid; None: straight

    def __post_init__(self) -> None:
        n = len(self.s)
        if self.curves is not None and len(self.curves.curvature) != n:
            raise ParameterError(f"{len(self.curves.curvature)} points, the grid has {n}", field="curves")
        for name in ("s", "alignment", "gauge_deviation"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        if n < FEWEST_POINTS:
            raise ParameterError(f"{n} points are no track, at least {FEWEST_POINTS} are needed", field="s")
        steps = np.diff(self.s)
        if not (steps[0] > 0.0 and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0)):
            raise ParameterError("the distance grid is not uniform and increasing", field="s")

    @property
    def interval(self) -> float:
        """Grid spacing, m."""
        return float(self.s[1] - self.s[0])

    @property
    def length(self) -> float:
        """Length from first to last grid point, m."""
        return float(self.s[-1] - self.s[0])

    def spline_coefficients(self) -> FloatArray:
        """Return (n - 1, 8): per grid cell the cubic of alignment, then of gauge deviation, highest power first."""
        cubic = CubicSpline(self.s, np.column_stack([self.alignment, self.gauge_deviation]), bc_type="natural")
        return np.ascontiguousarray(np.moveaxis(cubic.c, 0, 2).reshape(len(self.s) - 1, 8))


@dataclass(frozen=True, slots=True)
class TrackRecipe:
    """How to make a track: lengths in m, standard deviations in m over the band of ``wavelengths``."""

    length: float
    interval: float = 0.25
    alignment_std: float = 0.002
    gauge_std: float = 0.0
    gauge_offset: float = 0.0
    wavelengths: tuple[float, float] = (3.0, 70.0)
    curves: tuple[Curve, ...] = ()


def make_track(recipe: TrackRecipe, seed: np.random.SeedSequence) -> TrackTruth:
    """Return a track after the B176 spectra; alignment and gauge have random streams of their own."""
    alignment_rng, gauge_rng = (np.random.default_rng(child) for child in seed.spawn(2))
    alignment = synthesise(
        "alignment",
        length=recipe.length,
        interval=recipe.interval,
        target_std=recipe.alignment_std,
        wavelengths=recipe.wavelengths,
        rng=alignment_rng,
    )
    gauge = recipe.gauge_offset + synthesise(
        "gauge",
        length=recipe.length,
        interval=recipe.interval,
        target_std=recipe.gauge_std,
        wavelengths=recipe.wavelengths,
        rng=gauge_rng,
    )
    s = recipe.interval * np.arange(len(alignment), dtype=np.float64)
    return TrackTruth(s, alignment, gauge, laid_out(recipe.curves, s) if recipe.curves else None)


def read_track(path: Path, interval: float | None = None) -> TrackTruth:
    """Read a recorded track (CSV with header ``s_m, alignment_mm, gauge_deviation_mm``, and curves where it has them).

    Distances must increase; uneven spacing is resampled by cubic spline every ``interval`` m (the median spacing
    by default).

    Raises
    ------
    ScenarioError
        The file cannot be read, a column is missing, or a cell is not a finite number; names file, line and column.
    """
    try:
        table = read_track_columns(path)
        layout = read_layout_columns(path)
    except InputError as error:
        raise ScenarioError(error.reason, file=error.file, line=error.line, field=error.field) from error
    s = table[:, 0]
    spacing = float(np.median(np.diff(s))) if interval is None else interval
    grid = s[0] + spacing * np.arange(math.floor((s[-1] - s[0]) / spacing * (1 + 1e-12)) + 1)
    if len(grid) < FEWEST_POINTS:
        raise ScenarioError(f"{len(grid)} points are no track", file=path, field="s_m")
    if len(grid) == len(s) and np.allclose(grid, s, rtol=0.0, atol=1e-6 * spacing):
        values = table[:, 1:]
    else:
        values = CubicSpline(s, table[:, 1:])(grid)
    curves = None
    if layout is not None:
        curves = Curves(np.interp(grid, s, layout[:, 1]), np.interp(grid, s, layout[:, 2]))
    return TrackTruth(grid, values[:, 0], values[:, 1], curves)


def write_track(path: Path, track: TrackTruth, *, gauge_only: bool = False) -> None:
    """Write a track as CSV, as ``read_track`` reads it (mm and 1/km with 6 decimals).

    Parameters
    ----------
    path
        The file.
    track
        What to write.
    gauge_only
        Leave the alignment out.
    """
    columns, header = [track.s, 1e3 * track.alignment, 1e3 * track.gauge_deviation], list(COLUMNS)
    if gauge_only:
        columns, header = [track.s, 1e3 * track.gauge_deviation], list(GAUGE_COLUMNS)
    if track.curves is not None:
        columns += [1e3 * track.curves.curvature, 1e3 * track.curves.cant]
        header += LAYOUT_COLUMNS
    form = ("%.3f", *["%.6f"] * (len(columns) - 1))
    np.savetxt(path, np.column_stack(columns), fmt=form, delimiter=",", header=",".join(header), comments="")

"""The track as it truly is: lateral alignment, gauge deviation and curves along a section."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.errors import InputError, ParameterError, ScenarioError
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.fields import MM, Key, M
from ingest.file_value import As, Inline, between
from ingest.input_file import NotNegative, Positive, field_error, refusing
from ingest.simulator.irregularity import (
    GAUSSIAN,
    HIGHEST,
    Band,
    Irregularity,
    Isolated,
    IsolatedTables,
    LongWaves,
    Waves,
    isolated,
    superpose,
)
from ingest.track_file import (
    COLUMNS,
    FEWEST_POINTS,
    GAUGE_COLUMNS,
    LAYOUT_COLUMNS,
    read_layout_columns,
    read_track_columns,
)

ROUNDING = 6.0  # m over which the ends of transitions are rounded: no track has a kink in its cant
MIN_CURVE_RADIUS = 150.0  # m
_IS_RADIUS = refusing(
    lambda radius: abs(radius) < MIN_CURVE_RADIUS,
    f"{{value:g}} m is no radius; at least {MIN_CURVE_RADIUS:g} m, negative to the right",
)


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve between two equal transitions, m; ``radius`` and ``cant`` positive to the left."""

    start: Annotated[NotNegative, M]
    length: Annotated[Positive, M]  # with both transitions
    radius: Annotated[float, between(-1e6, 1e6), _IS_RADIUS, M]
    cant: Annotated[float, between(-200.0, 200.0), MM] = 0.0
    transition: Annotated[Positive, M] = 80.0

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse a curve that is all transition."""
        if self.length <= 2.0 * self.transition:
            raise field_error(f"{self.length:g} m is no longer than both transitions", "length_m")
        return self


@dataclass(frozen=True, slots=True)
class Curves(FrozenArrays):
    """Curvature and cant on the grid of a track."""

    curvature: Annotated[FloatArray, "n"]  # 1/m, positive to the left
    cant: Annotated[FloatArray, "n"]  # m, right rail above the left one


def laid_out(curves: Sequence[Curve], s: FloatArray) -> Curves:
    """Return the curves on the grid ``s`` (n,), m; linear transitions with rounded ends."""
    shape = np.zeros((2, len(s)))
    for curve in curves:
        corners = curve.start + np.array([0.0, curve.transition, curve.length - curve.transition, curve.length])
        ramp = np.interp(s, corners, [0.0, 1.0, 1.0, 0.0])
        shape += np.outer([1.0 / curve.radius, curve.cant], ramp)
    window = np.hanning(2 * round(0.5 * ROUNDING / float(s[1] - s[0])) + 3)
    padded = np.pad(shape, ((0, 0), (len(window) // 2,) * 2), mode="edge")
    rounded = [np.convolve(row, window / window.sum(), mode="valid") for row in padded]
    return Curves(*rounded)


LARGEST_GAP = 2.0  # m between two rows of a recorded track
MOST_ALIGNMENT = 0.3  # m; recorded alignment may hold long waves
MOST_GAUGE = 0.06  # m
LEAST_IN_MM = 0.05e-3  # m: nothing recorded stays below it


@dataclass(frozen=True, slots=True)
class Surface(FrozenArrays):
    """What else of a track changes from place to place, on its grid."""

    roll: Annotated[FloatArray, "n"]  # rad, cross level over the distance of the contact points, left rail up
    friction: Annotated[FloatArray, "n"]  # coefficient of friction over its mean
    load: Annotated[FloatArray, "n"]  # vertical load of a wheel over its mean


@dataclass(frozen=True, slots=True)
class TrackTruth(FrozenArrays):
    """Alignment and gauge deviation on a uniform grid of distance; between grid points a cubic spline."""

    s: Annotated[FloatArray, "n"]  # m, uniform
    alignment: Annotated[FloatArray, "n"]  # m, d, positive to the left
    gauge_deviation: Annotated[FloatArray, "n"]  # m, actual minus nominal gauge
    curves: Curves | None = None  # on the same grid; None: straight
    surface: Surface | None = None  # on the same grid; None: level, and alike everywhere

    @property
    def interval(self) -> float:
        """Grid spacing, m."""
        return float(self.s[1] - self.s[0])

    @property
    def length(self) -> float:
        """Length from first to last grid point, m."""
        return float(self.s[-1] - self.s[0])

    def gauge_range(self) -> tuple[float, float]:
        """Return the least and the greatest gauge deviation, m, at the grid points and half way between them."""
        e = self.gauge_deviation
        if float(e.max()) == float(e.min()):
            return float(e[0]), float(e[0])
        between = CubicSpline(self.s, e, bc_type="natural")(self.s[:-1] + 0.5 * self.interval)
        return float(min(e.min(), between.min())), float(max(e.max(), between.max()))

    def line_at(self, distance: FloatArray, height: float) -> tuple[FloatArray, FloatArray]:
        """Return alignment, m, and its slope at ``distance`` (n,), m, each (n,), at ``height`` above the rails, m."""
        line = self.alignment if self.surface is None else self.alignment - height * self.surface.roll
        cubic = CubicSpline(self.s, line, bc_type="natural")
        return np.asarray(cubic(distance)), np.asarray(cubic(distance, 1))

    def spline_coefficients(self) -> FloatArray:
        """Return (n - 1, 8): per grid cell the cubic of alignment, then of gauge deviation, highest power first.

        With a surface (n - 1, 20): then of its roll, friction and load.
        """
        columns = [self.alignment, self.gauge_deviation]
        if self.surface is not None:
            columns += [self.surface.roll, self.surface.friction, self.surface.load]
        cubic = CubicSpline(self.s, np.column_stack(columns), bc_type="natural")
        return np.ascontiguousarray(np.moveaxis(cubic.c, 0, 2).reshape(len(self.s) - 1, 4 * len(columns)))


@dataclass(frozen=True, slots=True)
class TrackRecipe:
    """How to make a track: lengths in m, standard deviations in m over the band of ``wavelengths``.

    The long waves are added to the irregularities of that band; kurtosis is that of their sum, before the isolated
    irregularities. The mean of the gauge deviation is ``gauge_offset``, without the latter.
    """

    length: Annotated[Positive, M]
    interval: Annotated[Positive, M] = 0.25
    alignment_std: Annotated[float, between(0.0, 50.0), MM] = 0.002
    gauge_std: Annotated[float, between(0.0, 20.0), MM] = 0.0
    gauge_offset: Annotated[float, between(-20.0, 40.0), MM] = 0.0
    wavelengths: Annotated[tuple[float, float], Inline(Band)] = (3.0, 70.0)
    curves: tuple[Curve, ...] = ()
    long_alignment: Annotated[Waves, As(LongWaves)] | None = None
    long_gauge: Annotated[Waves, As(LongWaves)] | None = None
    alignment_kurtosis: Annotated[float, between(GAUSSIAN, HIGHEST)] = GAUSSIAN
    gauge_kurtosis: Annotated[float, between(GAUSSIAN, HIGHEST)] = GAUSSIAN
    isolated: Annotated[tuple[Isolated, ...], Inline(IsolatedTables)] = ()
    begin: Annotated[float, Key(None)] = 0.0  # distance of the first point

    def without_irregularities(self) -> TrackRecipe:
        """Return the recipe of the same track as it was designed: straight between its curves, at nominal gauge."""
        return TrackRecipe(
            length=self.length,
            interval=self.interval,
            alignment_std=0.0,
            wavelengths=self.wavelengths,
            curves=self.curves,
            begin=self.begin,
        )

    @property
    def plain(self) -> bool:
        """Whether the irregularities are Gaussian and of one band, and nothing else."""
        kurtosis = (self.alignment_kurtosis, self.gauge_kurtosis)
        return kurtosis == (GAUSSIAN, GAUSSIAN) and not (self.long_alignment or self.long_gauge or self.isolated)


def make_track(recipe: TrackRecipe, seed: np.random.SeedSequence) -> TrackTruth:
    """Return a track after the B176 spectra; alignment, gauge and all else have random streams of their own."""
    alignment_rng, gauge_rng, *others = (np.random.default_rng(child) for child in seed.spawn(4 + len(recipe.isolated)))
    alignment_parts = [Waves("alignment", recipe.alignment_std, recipe.wavelengths), recipe.long_alignment]
    gauge_parts = [Waves("gauge", recipe.gauge_std, recipe.wavelengths), recipe.long_gauge]
    alignment = _irregularity(recipe, "alignment", alignment_parts, (alignment_rng, others[0]))
    gauge = _irregularity(recipe, "gauge", gauge_parts, (gauge_rng, others[1]))
    s = recipe.begin + recipe.interval * np.arange(len(alignment), dtype=np.float64)
    gauge = recipe.gauge_offset + gauge
    if recipe.isolated:
        added = isolated(recipe.isolated, s, others[2:])
        alignment, gauge = alignment + added[0], gauge + added[1]
    return TrackTruth(s, alignment, gauge, laid_out(recipe.curves, s) if recipe.curves else None)


def _irregularity(
    recipe: TrackRecipe, name: Irregularity, parts: Sequence[Waves | None], rngs: Sequence[np.random.Generator]
) -> FloatArray:
    present = [(part, rng) for part, rng in zip(parts, rngs, strict=True) if part is not None]
    try:
        return superpose(
            [part for part, _ in present],
            [rng for _, rng in present],
            length=recipe.length,
            interval=recipe.interval,
            kurtosis=recipe.alignment_kurtosis if name == "alignment" else recipe.gauge_kurtosis,
        )
    except ParameterError as error:
        field = f"section.{name}" if error.field is None else f"section.{name}_{error.field}"
        raise ParameterError(error.reason, field=field) from error


def read_track(path: Path) -> TrackTruth:
    """Read a recorded track (CSV with header ``s_m, alignment_mm, gauge_deviation_mm``, and curves where it has them).

    Distances must increase; uneven spacing is resampled by cubic spline at the median spacing. Gaps of more than 2 m
    and values in another unit are refused.
    """
    try:
        table = read_track_columns(path)
        layout = read_layout_columns(path)
    except InputError as error:
        raise ScenarioError(error.reason, file=error.file, line=error.line, field=error.field) from error
    s = table[:, 0]
    _check_recorded(path, table)
    spacing = float(np.median(np.diff(s)))
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


def _check_recorded(path: Path, table: FloatArray) -> None:
    """Refuse gaps that nothing can be put into, and values that are in another unit than mm."""
    s, steps = table[:, 0], np.diff(table[:, 0])
    widest = int(np.argmax(steps))
    if steps[widest] > LARGEST_GAP:
        reason = f"nothing between {s[widest]:g} and {s[widest + 1]:g} m; at most {LARGEST_GAP:g} m may be missing"
        raise ScenarioError(reason, file=path, line=widest + 3, field=COLUMNS[0])
    for name, values, most in zip(COLUMNS[1:], table.T[1:], (MOST_ALIGNMENT, MOST_GAUGE), strict=True):
        largest = float(np.abs(values).max())
        if largest > most:
            reason = f"{1e3 * largest:g} mm is on no line, at most {1e3 * most:g} mm; another unit?"
            raise ScenarioError(reason, file=path, field=name)
        if 0.0 < largest < LEAST_IN_MM:
            raise ScenarioError(f"at most {1e3 * largest:g} mm anywhere; is this in metres?", file=path, field=name)


def from_zero(track: TrackTruth) -> TrackTruth:
    """Return a recorded track whose distance counts from its first point."""
    return replace(track, s=track.s - track.s[0])


def write_track(path: Path, track: TrackTruth, *, gauge_only: bool = False) -> None:
    """Write a track as CSV, as ``read_track`` reads it (mm and 1/km with 6 decimals)."""
    columns, header = [track.s, 1e3 * track.alignment, 1e3 * track.gauge_deviation], list(COLUMNS)
    if gauge_only:
        columns, header = [track.s, 1e3 * track.gauge_deviation], list(GAUGE_COLUMNS)
    if track.curves is not None:
        columns += [1e3 * track.curves.curvature, 1e3 * track.curves.cant]
        header += LAYOUT_COLUMNS
    form = ("%.3f", *["%.6f"] * (len(columns) - 1))
    np.savetxt(path, np.column_stack(columns), fmt=form, delimiter=",", header=",".join(header), comments="")

"""The equations of runs as normal equations of their unknowns: segments, Fourier transforms, whitening, instruments.

Sensors drift, and each equation has an error of its own at every wave; so they are whitened by the covariance of the
three errors per wavenumber. What multiplies them on the left is simulated, and has nothing to do with the noise of the
sensors: noise in what multiplies the unknowns does not shrink them. The sums of segments add up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from estimation.bogie.curves import Curves, add_hats, add_means, nodes
from estimation.bogie.equations import EQUATIONS, PARAMETERS, moving_rows, saturation, terms
from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun, Followed, followed, mixed_displacement
from estimation.bogie.simulation import Gear, Simulated, simulate
from estimation.values.arrays import FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]
UNKNOWNS = len(PARAMETERS)  # before those of the curves


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of the equations in the segments of a run, by wavenumber."""

    parameters: ComplexArray  # (s, 3, p, m)
    hats: ComplexArray  # (s, 2, b, m): a curve is in the equation of its wheelset, the leading one's first

    def times(self, theta: FloatArray, axles: Sequence[int]) -> ComplexArray:
        """Return the sum (s, 3, m) of the columns by unknowns (u,): parameters, then the curves of both axles."""
        p = self.parameters.shape[2]
        total = np.einsum("sepm,p->sem", self.parameters, theta[:p])
        total[:, :2] += np.einsum("sabm,ab->sam", self.hats, theta[p:].reshape(2, -1)[list(axles)])
        return np.asarray(total)

    def dense(self, segment: int, axles: Sequence[int]) -> ComplexArray:
        """Return the columns (3, u, m) of a segment by all unknowns: parameters, then the curves of both axles."""
        (_, p, m), b = self.parameters.shape[1:], self.hats.shape[2]
        whole = np.zeros((EQUATIONS, p + 2 * b, m), dtype=np.complex128)
        whole[:, :p] = self.parameters[segment]
        for equation, axle in enumerate(axles):
            whole[equation, p + axle * b : p + (axle + 1) * b] = self.hats[segment, equation]
        return whole

    def backwards(self, turn: ComplexArray) -> Columns:
        """Return those of a run in segments from its other end on; ``turn`` (m,) takes waves from end to end."""
        return Columns(*(side[::-1].conj() * turn for side in (self.parameters, self.hats)))


@dataclass(frozen=True, slots=True)
class Spectra:
    """The equations of a run."""

    target: ComplexArray  # (s, 3, m): what is known of them
    measured: Columns
    simulated: Columns  # instruments
    followed: Followed  # by axle
    visited: FloatArray  # (2, b) m run at each node, by axle
    axles: tuple[int, int]  # leading, then trailing
    group: int  # of the jackknife


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """A run with the transforms of what it measured, which stay as they are from round to round."""

    run: BogieRun
    group: int  # of the jackknife
    rows: ComplexArray  # (r, s, m) of :func:`moving_rows`

    @classmethod
    def of(cls, group: int, run: BogieRun, radius: float) -> MeasuredRun:
        """Return a run of wheelsets of a nominal radius, m."""
        return cls.on(Grid.of(run), group, run, radius)

    @classmethod
    def on(cls, grid: Grid, group: int, run: BogieRun, radius: float) -> MeasuredRun:
        """Return it in the segments of a grid."""
        return cls(run, group, grid.transformed(moving_rows(run, run.speed, radius)))


@lru_cache(maxsize=8)
def band() -> IntArray:
    """Return which waves of a segment are used, by how many of them it holds."""
    wavenumber = np.arange(segment_cells() // 2 + 1) / BOGIE.segment_m
    return np.flatnonzero((wavenumber >= 1.0 / BOGIE.longest_wave) & (wavenumber <= 1.0 / BOGIE.shortest_wave))


def segment_cells() -> int:
    """Return how many cells a segment has."""
    return round(BOGIE.segment_m / BOGIE.grid_step)


@lru_cache(maxsize=8)
def _taper() -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Return the taper (n,) of a segment, an orthonormal basis (k, n) of its trend, and its transforms (k, m)."""
    n = segment_cells()
    powers = np.vander(np.linspace(-1.0, 1.0, n), BOGIE.trend_order + 1, increasing=True)
    taper, trend = np.hanning(n + 2)[1:-1], np.linalg.qr(powers)[0].T
    return taper, trend, np.fft.rfft(trend * taper, axis=1)[:, band()]


def long_enough(run: BogieRun) -> bool:
    """Return whether a run holds a segment."""
    return float(run.run[-1]) >= BOGIE.segment_m + BOGIE.grid_step


def _starts(cells: int) -> list[int]:
    n = segment_cells()
    count = -(-2 * (cells - n) // n) + 1
    return [round(at) for at in np.linspace(0, cells - n, count)]


def cell_means(rows: FloatArray, cell: FloatArray) -> FloatArray:
    """Return the means (r, cells) of rows (r, n) over cells; ``cell`` (n,) is where each sample is."""
    means = np.zeros((len(rows), int(cell[-1])))
    add_means(np.ascontiguousarray(rows), cell, means)
    return means


def _hat_means(x: FloatArray, cell: FloatArray) -> FloatArray:
    """Return the means (2, b, cells) of the hats at displacements (2, n)."""
    places = nodes()
    means = np.zeros((2, len(places), int(cell[-1])))
    for axle in range(2):
        add_hats(np.ascontiguousarray(x[axle]), float(places[0]), 1.0 / BOGIE.node_step, cell, means[axle])
    return means


def transformed(means: FloatArray, starts: Sequence[int]) -> ComplexArray:
    """Return the transforms (..., s, m) of segments of rows (..., cells), in the band; rows of zeros cost nothing."""
    taper, trend, of_trend = _taper()
    n, rows = len(taper), means.reshape(-1, means.shape[-1])
    filled = np.flatnonzero(rows.any(axis=1))
    transforms = np.zeros((len(rows), len(starts), len(band())), dtype=np.complex128)
    for number, start in enumerate(starts):
        part = rows[filled, start : start + n]
        transforms[filled, number] = np.fft.rfft(part * taper, axis=1)[:, band()] - (part @ trend.T) @ of_trend
    return transforms.reshape(*means.shape[:-1], *transforms.shape[1:])


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells along a run, and its segments."""

    cell: FloatArray  # (n,) where each sample is
    starts: Sequence[int]  # cells at which segments begin

    @classmethod
    def of(cls, run: BogieRun) -> Grid:
        """Return that of a run that is evenly covered."""
        cell = run.run / BOGIE.grid_step
        return cls(cell, _starts(int(cell[-1])))

    def transformed(self, rows: FloatArray) -> ComplexArray:
        """Return the transforms (r, s, m) of rows (r, n)."""
        return transformed(cell_means(rows, self.cell), self.starts)


def spectra(gear: Gear, curves: Curves, of: MeasuredRun) -> Spectra | None:
    """Return the equations of a run that is long enough; None where the bogie derails on these curves."""
    own = as_it_runs(curves, of.run)
    moved = simulate(gear, own, of.run)
    return None if moved is None else in_segments(gear, own, of, moved, Grid.of(of.run))


def as_it_runs(curves: Curves, run: BogieRun) -> Curves:
    """Return the curves of the axle that leads and of the one that trails."""
    return Curves(curves.values[_order(run)])


def _order(run: BogieRun) -> list[int]:
    return [1, 0] if run.swapped else [0, 1]


def in_segments(gear: Gear, own: Curves, of: MeasuredRun, moved: Simulated, grid: Grid) -> Spectra:
    """Return the equations of a run, simulated with its own curves, in the segments of a grid."""
    run, order = of.run, _order(of.run)
    saturated = np.concatenate([saturation(gear, moved, axle) for axle in range(2)])
    of_simulation = moving_rows(moved, run.speed, gear.vehicle.nominal_radius)
    rows = grid.transformed(np.concatenate([of_simulation, saturated]))
    simulated, by_saturation = rows[: len(of_simulation)], rows[len(of_simulation) :].reshape(2, 2, *rows.shape[1:])
    _, instruments, _ = _equations(gear, own, run, grid, simulated, by_saturation, moved.relative)
    mixed = mixed_displacement(run, moved.relative)
    target, measured, visited = _equations(gear, own, run, grid, of.rows, by_saturation, mixed)
    follows = followed(run, moved.relative, moved.lateral[0])
    return Spectra(
        target,
        measured,
        instruments,
        replace(follows, likeness=follows.likeness[order], open_std=follows.open_std[order]),
        visited[order],
        (order[0], order[1]),
        of.group,
    )


def _equations(
    gear: Gear,
    curves: Curves,
    run: BogieRun,
    grid: Grid,
    rows: ComplexArray,
    saturated: ComplexArray,
    x: FloatArray,
) -> tuple[ComplexArray, Columns, FloatArray]:
    """Return what is known (s, 3, m), the columns, and how far it ran at each node (2, b), m, leading wheelset first.

    Args:
        rows, saturated: Of :func:`terms`.
        x: (2, n) by what the curves are looked up, m.
    """
    columns, hats = np.asarray(terms(gear, rows, saturated), np.complex128), _hat_means(x, grid.cell)
    moved_on = -run.stretch * curves.slope(x) * np.gradient(run.track, run.run, axis=1)
    columns[:2, 1 + PARAMETERS.index("shift")] = grid.transformed(moved_on)
    columns = np.moveaxis(columns, 2, 0)
    parameters = columns[:, :, 1 + parameters_by_axle(swapped=run.swapped)]
    of_curves = Columns(parameters, np.moveaxis(transformed(hats, grid.starts), 2, 0))
    return columns[:, :, 0], of_curves, BOGIE.grid_step * hats.sum(2)


def parameters_by_axle(*, swapped: bool) -> IntArray:
    """Return where the parameters of the axles are in those of leading and trailing."""
    other = {"front": "rear", "rear": "front"} if swapped else {}
    names = [
        f"{name.removesuffix(end)}{other[end]}" if (end := name.rpartition("_")[2]) in other else name
        for name in PARAMETERS
    ]
    return np.array([PARAMETERS.index(name) for name in names], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class ErrorSpectrum:
    """Covariance of the errors of the three equations by wavenumber, and how much more each segment has."""

    covariance: ComplexArray  # (m, 3, 3)
    scale: tuple[FloatArray, ...]  # (s,) by run: a slow bogie has more of the drift of its sensors


def error_spectrum(parts: Sequence[Spectra], theta: FloatArray) -> ErrorSpectrum:
    """Return what unknowns (u,) leave of the equations."""
    left = [part.target + part.measured.times(theta, part.axles) for part in parts]
    scales = [np.ones(len(part)) for part in left]
    covariance = np.empty(0, dtype=np.complex128)
    for _ in range(BOGIE.scale_rounds):
        pairs = zip(left, scales, strict=True)
        powers = [np.einsum("sem,sfm,s->mef", part, part.conj(), 1.0 / scale) for part, scale in pairs]
        covariance = _smooth(np.asarray(np.sum(powers, axis=0) / sum(map(len, left)), np.complex128))
        inverse = np.linalg.inv(covariance)
        scales = [np.einsum("sem,mef,sfm->s", part.conj(), inverse, part).real for part in left]
        scales = [scale / (EQUATIONS * len(covariance)) for scale in scales]
    return ErrorSpectrum(covariance, tuple(scales))


def _smooth(raw: ComplexArray) -> ComplexArray:
    """Return a covariance (m, 3, 3) as a smooth one: powers and coherences are means over bands, and lines between."""
    m = len(raw)
    edges = np.unique(np.round(np.geomspace(1, m + 1, BOGIE.noise_bands + 1) - 1).astype(np.int64))
    bands = [slice(int(first), int(behind)) for first, behind in itertools.pairwise(edges)]
    banded = np.stack([raw[band].mean(axis=0) for band in bands])
    middle = np.log1p([0.5 * (band.start + band.stop - 1) for band in bands])
    at, smooth = np.log1p(np.arange(m)), np.empty_like(raw)
    for e in range(EQUATIONS):
        for f in range(EQUATIONS):
            size = np.sqrt((banded[:, e, e] * banded[:, f, f]).real)
            coherence = banded[:, e, f] / size
            along = np.interp(at, middle, coherence.real) + 1j * np.interp(at, middle, coherence.imag)
            smooth[:, e, f] = along * np.exp(np.interp(at, middle, np.log(size)))
    return smooth


def normal(part: Spectra, covariance: ComplexArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of a run, left (u, u) times the unknowns plus right (u,) is zero.

    In units in which ``left`` is information: segments overlap by half, so that each counts for half of what it holds.
    """
    whiten = np.ascontiguousarray(np.moveaxis(np.linalg.inv(np.linalg.cholesky(covariance)), 0, 2))  # (3, 3, m)
    p, b = part.measured.parameters.shape[2], part.measured.hats.shape[2]
    seen = np.asarray(part.measured.hats.any(axis=(0, 3)) | part.simulated.hats.any(axis=(0, 3)))
    visited = [np.flatnonzero(row) for row in seen]
    place = [p + axle * b + at for axle, at in zip(part.axles, visited, strict=True)]
    filled = np.concatenate([np.arange(p), *place])
    instruments = _white(part.simulated, visited, whiten, 1.0 / scale)
    even = np.ones(len(scale))
    ours, target = _white(part.measured, visited, whiten, even), _whitened(part.target[:, :, None], whiten, even)
    left, right = np.zeros((p + 2 * b, p + 2 * b)), np.zeros(p + 2 * b)
    left[np.ix_(filled, filled)] = instruments @ ours.T
    right[filled] = instruments @ target[0]
    return left, right


def _white(columns: Columns, visited: Iterable[IntArray], whiten: ComplexArray, weight: FloatArray) -> FloatArray:
    """Return whitened columns as rows (u, s 3 m 2) of real and imaginary parts."""
    rows = [_whitened(columns.parameters, whiten, weight)]
    for equation, nodes_at in enumerate(visited):
        hats = np.moveaxis(columns.hats[:, equation, nodes_at], 1, 0)  # in one equation only
        rows.append(_real(hats[:, :, None] * weight[:, None, None] * whiten[:, equation]))
    return np.concatenate(rows)


def _whitened(columns: ComplexArray, whiten: ComplexArray, weight: FloatArray) -> FloatArray:
    return _real(np.einsum("efm,sfum->usem", whiten, columns) * weight[:, None, None])


def _real(white: ComplexArray) -> FloatArray:
    return np.ascontiguousarray(white).view(np.float64).reshape(len(white), 2 * math.prod(white.shape[1:]))

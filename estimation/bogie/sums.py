"""The equations of runs as normal equations of their unknowns: segments, Fourier transforms, whitening, instruments.

Sensors drift, and each equation has an error of its own at every wave; so they are whitened by the covariance of the
three errors per wavenumber. What multiplies them on the left is simulated, and has nothing to do with the noise of the
sensors: noise in what multiplies the unknowns does not shrink them. The sums of segments add up.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from estimation.bogie.curves import Curves, add_hats, add_means, nodes
from estimation.bogie.equations import EQUATIONS, PARAMETERS, terms
from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun, Followed, followed, mixed_displacement
from estimation.bogie.simulation import Gear, Simulated, simulate
from estimation.values.arrays import FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]
UNKNOWNS = len(PARAMETERS)  # before those of the curves


@dataclass(frozen=True, slots=True)
class Spectra:
    """Columns of the equations in the segments of a run, by wavenumber; unknowns are parameters, then both curves."""

    measured: ComplexArray  # (s, 3, 1 + u, m); what is known of the equations comes first
    simulated: ComplexArray  # (s, 3, u, m): instruments
    followed: Followed  # by axle
    visited: FloatArray  # (2, b) m run at each node
    group: int  # of the jackknife


@lru_cache(maxsize=8)
def band() -> IntArray:
    """Return which waves of a segment are used, by how many of them it holds."""
    wavenumber = np.arange(segment_cells() // 2 + 1) / BOGIE.segment_m
    return np.flatnonzero((wavenumber >= 1.0 / BOGIE.longest_wave) & (wavenumber <= 1.0 / BOGIE.shortest_wave))


def segment_cells() -> int:
    """Return how many cells a segment has."""
    return round(BOGIE.segment_m / BOGIE.grid_step)


@lru_cache(maxsize=8)
def _taper() -> tuple[FloatArray, FloatArray]:
    """Return the taper (n,) of a segment and an orthonormal basis (k, n) of its trend."""
    n = segment_cells()
    powers = np.vander(np.linspace(-1.0, 1.0, n), BOGIE.trend_order + 1, increasing=True)
    return np.hanning(n + 2)[1:-1], np.linalg.qr(powers)[0].T


def long_enough(run: BogieRun) -> bool:
    """Return whether a run holds a segment."""
    return float(run.run[-1]) >= BOGIE.segment_m + BOGIE.grid_step


def _starts(cells: int) -> list[int]:
    n = segment_cells()
    count = -(-2 * (cells - n) // n) + 1
    return [round(at) for at in np.linspace(0, cells - n, count)]


def transformed(rows: FloatArray, starts: Sequence[int]) -> ComplexArray:
    """Return the transforms (s, r, m) of segments of rows (r, n), in the band; rows of zeros cost nothing."""
    taper, trend = _taper()
    n, filled = len(taper), np.flatnonzero(rows.any(axis=1))
    found = np.zeros((len(starts), len(rows), len(band())), dtype=np.complex128)
    for number, start in enumerate(starts):
        part = rows[filled, start : start + n]
        part = part - (part @ trend.T) @ trend
        found[number, filled] = np.fft.rfft(part * taper, axis=1)[:, band()]
    return found


def spectra(gear: Gear, curves: Curves, run: BogieRun, group: int) -> Spectra | None:
    """Return the columns of a run that is long enough; None where the bogie derails on these curves."""
    own, cell = as_it_runs(curves, run), run.run / BOGIE.grid_step
    moved = simulate(gear, own, run)
    return None if moved is None else in_segments(gear, own, run, moved, group, cell, _starts(int(cell[-1])))


def as_it_runs(curves: Curves, run: BogieRun) -> Curves:
    """Return the curves of the axle that leads and of the one that trails."""
    return Curves(curves.values[_order(run)])


def _order(run: BogieRun) -> list[int]:
    return [1, 0] if run.swapped else [0, 1]


def in_segments(
    gear: Gear, own: Curves, run: BogieRun, moved: Simulated, group: int, cell: FloatArray, starts: Sequence[int]
) -> Spectra:
    """Return the columns of a run in segments from some cells on; ``cell`` (n,) is where each sample is."""
    order, mixed = _order(run), mixed_displacement(run, moved.relative)
    measured, visited = _columns(gear, own, run, moved, mixed, cell, measured=True)
    simulated, _ = _columns(gear, own, run, moved, moved.relative, cell, measured=False)
    b = visited.shape[1]
    place = unknowns_by_axle(b) if run.swapped else np.arange(UNKNOWNS + 2 * b)
    known_first = np.concatenate([[0], 1 + place])
    follows = followed(run, moved.relative, moved.lateral[0])
    return Spectra(
        _laid_out(transformed(measured, starts))[:, :, known_first],
        _laid_out(transformed(simulated, starts))[:, :, 1 + place],
        replace(follows, likeness=follows.likeness[order], open_std=follows.open_std[order]),
        visited[order],
        group,
    )


def unknowns_by_axle(b: int) -> IntArray:
    """Return where the unknowns of the axles are in those of leading and trailing, where the rear axle leads."""
    other = {"front": "rear", "rear": "front"}
    names = [
        f"{name.removesuffix(end)}{other[end]}" if (end := name.rpartition("_")[2]) in other else name
        for name in PARAMETERS
    ]
    own = [PARAMETERS.index(name) for name in names]
    return np.concatenate([own, UNKNOWNS + b + np.arange(b), UNKNOWNS + np.arange(b)]).astype(np.int64)


def _columns(
    gear: Gear, curves: Curves, run: BogieRun, moved: Simulated, x: FloatArray, cell: FloatArray, *, measured: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the columns (3 (1 + p) + 2 b, cells) as means over cells, and how far it ran at each node (2, b), m."""
    columns = terms(gear, run if measured else moved, moved, run.speed)
    columns[:2, 1 + PARAMETERS.index("shift")] = (
        -run.stretch * curves.slope(x) * np.gradient(run.track, run.run, axis=1)
    )
    places, size = nodes(), int(cell[-1])
    flat = np.ascontiguousarray(columns.reshape(-1, columns.shape[-1]))
    means = np.zeros((len(flat) + 2 * len(places), size))
    add_means(flat, cell, means[: len(flat)])
    hats = means[len(flat) :].reshape(2, len(places), size)
    for axle in range(2):
        add_hats(np.ascontiguousarray(x[axle]), float(places[0]), 1.0 / BOGIE.node_step, cell, hats[axle])
    return means, BOGIE.grid_step * hats.sum(axis=2)


def _laid_out(flat: ComplexArray) -> ComplexArray:
    """Return columns (s, 3 (1 + p) + 2 b, m) as (s, 3, 1 + p + 2 b, m): a curve is in the equation of its wheelset."""
    s, rows, m = flat.shape
    own = EQUATIONS * (1 + UNKNOWNS)
    b = (rows - own) // 2
    whole = np.zeros((s, EQUATIONS, 1 + UNKNOWNS + 2 * b, m), dtype=np.complex128)
    whole[:, :, : 1 + UNKNOWNS] = flat[:, :own].reshape(s, EQUATIONS, 1 + UNKNOWNS, m)
    for axle in range(2):
        first = 1 + UNKNOWNS + axle * b
        whole[:, axle, first : first + b] = flat[:, own + axle * b : own + (axle + 1) * b]
    return whole


@dataclass(frozen=True, slots=True)
class ErrorSpectrum:
    """Covariance of the errors of the three equations by wavenumber, and how much more each segment has."""

    covariance: ComplexArray  # (m, 3, 3)
    scale: tuple[FloatArray, ...]  # (s,) by run: a slow bogie has more of the drift of its sensors


def error_spectrum(parts: Sequence[Spectra], theta: FloatArray) -> ErrorSpectrum:
    """Return what unknowns (u,) leave of the equations."""
    left = [part.measured[:, :, 0] + np.einsum("seum,u->sem", part.measured[:, :, 1:], theta) for part in parts]
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
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    u = part.simulated.shape[2]
    filled = np.flatnonzero(part.measured[:, :, 1:].any(axis=(0, 1, 3)) | part.simulated.any(axis=(0, 1, 3)))
    ours, instruments = part.measured[:, :, np.append(0, 1 + filled)], part.simulated[:, :, filled]
    products = np.zeros((len(filled), 1 + len(filled)))
    for own, simulated, size in zip(ours, instruments, scale, strict=True):
        white, left_factor = (
            np.einsum("mef,fum->uem", whiten, columns).reshape(columns.shape[1], -1) for columns in (own, simulated)
        )
        products += (left_factor.conj() @ white.T).real / size
    left, right = np.zeros((u, u)), np.zeros(u)
    left[np.ix_(filled, filled)], right[filled] = products[:, 1:], products[:, 0]
    return left, right

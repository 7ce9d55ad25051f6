"""The equations of runs as normal equations of their unknowns: segments, Fourier transforms, whitening, instruments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
import numpy.typing as npt

from estimation.bogie.curves import Curves, add_hats, add_means, nodes
from estimation.bogie.equations import EQUATIONS, PARAMETERS, terms
from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun, mixed_displacement
from estimation.bogie.simulation import Gear, Simulated, simulate
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray

ComplexArray = npt.NDArray[np.complex128]
UNKNOWNS = len(PARAMETERS)  # before those of the curves


@dataclass(frozen=True, slots=True)
class Spectra:
    """Columns of the equations of some segments at the wavenumbers of the band; unknowns: parameters, both curves."""

    measured: ComplexArray  # (s, 3, 1 + u, m); what is known of the equations comes first
    simulated: ComplexArray  # (s, 3, u, m): instruments
    likeness: FloatArray  # (2,) correlation of the simulated and measured y - d of the wheelsets
    visited: FloatArray  # (2, b) m run at each node, measured
    block: IntArray  # (s,) of the jackknife


@lru_cache(maxsize=8)
def _band() -> IntArray:
    wavenumber = np.arange(_cells() // 2 + 1) / BOGIE.segment_m
    return np.flatnonzero((wavenumber >= 1.0 / BOGIE.longest_wave) & (wavenumber <= 1.0 / BOGIE.shortest_wave))


def _cells() -> int:
    return round(BOGIE.segment_m / BOGIE.grid_step)


@lru_cache(maxsize=8)
def _taper() -> tuple[FloatArray, FloatArray]:
    """Return the taper (n,) of a segment and an orthonormal basis (k, n) of its trend."""
    n = _cells()
    powers = np.vander(np.linspace(-1.0, 1.0, n), BOGIE.trend_order + 1, increasing=True)
    return np.hanning(n + 2)[1:-1], np.linalg.qr(powers)[0].T


def transformed(rows: FloatArray, starts: Sequence[int]) -> ComplexArray:
    """Return the transforms (s, r, m) of segments of rows (r, n) that begin at ``starts``, in the band."""
    taper, trend = _taper()
    n, found = len(taper), []
    for start in starts:
        part = rows[:, start : start + n]
        part = part - (part @ trend.T) @ trend
        found.append(np.fft.rfft(part * taper, axis=1)[:, _band()])
    return np.stack(found)


def spectra(gear: Gear, curves: Curves, run: BogieRun, block: int) -> Spectra | None:
    """Return the columns of a run; None where it is shorter than a segment."""
    cell = run.run / BOGIE.grid_step
    cells, n = int(cell[-1]), _cells()
    if cells < n:
        return None
    count = -(-2 * (cells - n) // n) + 1
    starts = [round(at) for at in np.linspace(0, cells - n, count)]
    moved = simulate(gear, curves, run)
    if moved is None:
        return None
    mixed = mixed_displacement(run, moved.relative)
    measured, visited = _columns(gear, run, moved, mixed, cell, measured=True)
    simulated, _ = _columns(gear, run, moved, moved.relative, cell, measured=False)
    own = np.stack([mixed_likeness(run, moved, axle) for axle in range(2)])
    return Spectra(
        _laid_out(transformed(measured, starts)),
        _laid_out(transformed(simulated, starts))[:, :, 1:],
        own,
        visited,
        np.full(len(starts), block),
    )


def mixed_likeness(run: BogieRun, moved: Simulated, axle: int) -> float:
    """Return the correlation of the simulated with the measured y - d of a wheelset, without long waves."""
    from estimation.filters import remove_wander

    both = np.stack([run.relative[axle], moved.relative[axle]])
    fast = remove_wander(both, run.run, np.ones(len(run), dtype=np.bool_), BOGIE.carried_wave)
    return float(np.corrcoef(fast)[0, 1])


def _columns(
    gear: Gear, run: BogieRun, moved: Simulated, x: FloatArray, cell: FloatArray, *, measured: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the columns (3 (1 + p) + 2 b, cells) as means over cells, and how far it ran at each node (2, b), m."""
    columns = terms(gear, run if measured else moved, moved, run.speed)
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
class Normal(FrozenArrays):
    """Normal equations of the unknowns by block of data: left theta + right = 0. They add up."""

    left: Annotated[FloatArray, "g", "u", "u"]
    right: Annotated[FloatArray, "g", "u"]
    square: Annotated[FloatArray, "g"]  # of the whitened residuals before
    count: Annotated[FloatArray, "g"]  # of real numbers in them


def covariances(parts: Sequence[Spectra], theta: FloatArray) -> tuple[ComplexArray, list[FloatArray]]:
    """Return the covariance of the equations (m, 3, 3) that unknowns leave, and by how much each segment has more."""
    residuals = [_residual(part, theta) for part in parts]
    m = residuals[0].shape[-1]
    scales = [np.ones(len(part)) for part in residuals]
    edges = np.unique(np.round(np.geomspace(1, m + 1, BOGIE.noise_bands + 1) - 1).astype(int))
    cov = np.empty((m, EQUATIONS, EQUATIONS), dtype=np.complex128)
    for _ in range(3):
        raw = sum(
            np.einsum("sem,sfm,s->mef", part, part.conj(), 1.0 / scale)
            for part, scale in zip(residuals, scales, strict=True)
        ) / sum(map(len, residuals))
        banded = np.stack([raw[a:b].mean(axis=0) for a, b in zip(edges[:-1], edges[1:], strict=True)])
        middle = [0.5 * (a + b - 1) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        at = np.log1p(np.arange(m))
        for e in range(EQUATIONS):
            for f in range(EQUATIONS):
                size = np.sqrt((banded[:, e, e] * banded[:, f, f]).real)
                share = np.interp(at, np.log1p(middle), (banded[:, e, f] / size).real) + 1j * np.interp(
                    at, np.log1p(middle), (banded[:, e, f] / size).imag
                )
                cov[:, e, f] = share * np.exp(np.interp(at, np.log1p(middle), np.log(size)))
        inverse = np.linalg.inv(cov)
        scales = [
            np.einsum("sem,mef,sfm->s", part.conj(), inverse, part).real / (EQUATIONS * m) for part in residuals
        ]
    return cov, scales


def _residual(part: Spectra, theta: FloatArray) -> ComplexArray:
    return np.asarray(part.measured[:, :, 0] + np.einsum("seum,u->sem", part.measured[:, :, 1:], theta))


def normal(part: Spectra, cov: ComplexArray, scale: FloatArray, keep: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return left (s, u, u) and right (s, u) sides of the segments of a run, of the unknowns that are kept."""
    whiten = np.linalg.inv(np.linalg.cholesky(cov))  # (m, 3, 3)
    both = np.concatenate([part.measured[:, :, :1], part.measured[:, :, 1:][:, :, keep]], axis=2)
    lefts, rights = [], []
    for number in range(len(both)):
        ours = np.einsum("mef,fum->uem", whiten, both[number]).reshape(len(keep) + 1, -1)
        instruments = np.einsum("mef,fum->uem", whiten, part.simulated[number][:, keep]).reshape(len(keep), -1)
        products = (instruments.conj() @ ours.T).real * (0.5 * 2.0 / scale[number])  # half overlap; both signs
        lefts.append(products[:, 1:])
        rights.append(products[:, 0])
    return np.stack(lefts), np.stack(rights)

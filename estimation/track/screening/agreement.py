"""Whether two signals are of one place: how far what they have in common exceeds chance.

As y = d + h(R), h near to a straight line, two passes of one place have a combination of (y, R) each that is the same
in both, d, whatever their wear. The largest canonical correlation over the offsets that are searched decides; its
significance is that of Wilks' lambda with as many samples as the autocorrelations leave independent (Bartlett).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from estimation.compiled import compiled
from estimation.filters import between_known, high_pass, local_cubic_kernel
from estimation.track.passes import Pass, PositionParameters, gridded
from estimation.values.arrays import FloatArray, runs
from estimation.values.quantities import log10_chance
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment


@dataclass(frozen=True, slots=True)
class ScreeningParameters:
    """When a pass agrees with the others of its section."""

    cutoff_wavelength: float = 30.0  # m
    step: float = 1.0  # m
    positions: PositionParameters = field(default_factory=PositionParameters)
    log10_chance: float = -6.0  # of an agreement by chance
    least_samples: float = 50.0  # independent ones, below which a low correlation is no contradiction
    least_factor: float = 0.4  # of y against the y of others, and its inverse the most
    peers: int = 6  # that a pass is compared with
    misplaced: float = 4.0  # m that a position may jump
    overlap_step: int = 20  # grid points: overlaps that differ less count as equal
    min_chain_overlap: int = 10  # of these, of overlap with a pass that continues along the section
    chain_peers: int = 2  # passes that continue along the section
    correlation_length: float = 60.0  # m: over which samples of a high-passed signal are correlated
    piece: float = 1000.0  # m
    fewest_independent_samples: float = 8.0  # independent ones, below which two passes are not compared


@compiled(nogil=True)
def cross_products(first: FloatArray, second: FloatArray, reach: int) -> FloatArray:
    """Return the sums (2 reach + 1, p, q) of first (p, n) at i times second (q, n) at i + lag, from lag -reach on."""
    p, n = first.shape
    q = second.shape[0]
    products = np.zeros((p, q, 2 * reach + 1))
    for a in range(p):
        for b in range(q):
            sums, other = products[a, b], second[b]
            for i in range(n):
                value = first[a, i]
                start = i - reach
                for k in range(max(0, -start), min(2 * reach + 1, n - start)):
                    sums[k] += value * other[start + k]
    return np.ascontiguousarray(products.transpose(2, 0, 1))


@compiled(nogil=True)
def own_products(signals: FloatArray, reach: int) -> FloatArray:
    """Return the sums (m, reach + 1) of signals (m, n) at i times themselves at i + lag, for lags from 0 to reach."""
    m, n = signals.shape
    products = np.zeros((m, reach + 1))
    for a in range(m):
        sums, signal = products[a], signals[a]
        for i in range(n):
            value = signal[i]
            for k in range(min(reach + 1, n - i)):
                sums[k] += value * signal[i + k]
    return products


SMALLEST = float(np.finfo(np.float64).tiny)  # in place of a power of zero


@dataclass(frozen=True, slots=True)
class FilteredPass:
    """High-passed signals on the grid: of a pass y and R; of an alignment d."""

    first: int  # grid point of the first sample
    signals: FloatArray  # (2, n) or (1, n)
    step: float  # m

    @property
    def length(self) -> float:
        """Length along the section, m."""
        return float((self.signals.shape[1] - 1) * self.step)

    @property
    def last(self) -> int:
        """Grid point of the last sample."""
        return int(self.first + self.signals.shape[1] - 1)


@dataclass(frozen=True, slots=True)
class Agreement:
    """What two have in common at the offset at which they have most."""

    correlation: float  # 0 to 1, the largest canonical one
    log10_chance: float  # of as much between different places, over all offsets searched; 0 where they are not compared
    shift: float  # m: the true position of the first less its own, by the second
    factor: float  # y of the first over d of the second, 1 where both are in one unit and of one sign
    samples: float  # independent ones


NOTHING = Agreement(0.0, 0.0, 0.0, 0.0, 0.0)


def filter_pass(item: Pass, cutoff_wavelength: float, step: float) -> FilteredPass | None:
    """Return the high-passed signals of a pass; None where it is shorter than the filter reaches."""
    weights = local_cubic_kernel(cutoff_wavelength, step)
    reach = len(weights) // 2
    first, y, R = gridded(item, step)
    if len(y) <= 2 * len(weights):
        return None
    signals = high_pass(np.stack([y, item.side * R]), weights)[:, reach:-reach]
    return FilteredPass(first + reach, signals, step)


def alignment_segment(
    track: TrackAlignment, first: int, last: int, cutoff_wavelength: float, step: float
) -> FilteredPass | None:
    """Return the longest known stretch of an alignment between two grid points, high-passed unless it is already."""
    grid = np.arange(first, last + 1) * step
    known = np.isfinite(track.alignment)
    if np.count_nonzero(known) < 2:  # noqa: PLR2004 - nothing to interpolate between
        return None
    stretches = runs(between_known(np.asarray(grid, np.float64), track.s, known))
    start, stop = stretches[np.argmax(stretches[:, 1] - stretches[:, 0])].tolist() if len(stretches) else (0, 0)
    d = np.interp(grid[start:stop], track.s[known], track.alignment[known])
    if track.band_limited:
        return FilteredPass(first + start, d[None, :], step) if len(d) else None
    weights = local_cubic_kernel(cutoff_wavelength, step)
    reach = len(weights) // 2
    if len(d) <= 2 * len(weights):
        return None
    return FilteredPass(first + start + reach, high_pass(d, weights)[None, reach:-reach], step)


def agreement(
    first: FilteredPass,
    second: FilteredPass,
    largest_offset: float,
    least_length: float,
    parameters: ScreeningParameters,
) -> Agreement:
    """Return what two have in common within ``largest_offset`` m, on at least ``least_length`` m; else ``NOTHING``."""
    # where they share much, odometers of other scale drift apart by more than a wavelength; a few pieces of it are then
    # compared, each by itself, and the one that agrees neither most nor least is returned
    step = first.step
    start, stop = max(first.first, second.first), min(first.last, second.last) + 1
    if (stop - start) * step < least_length:
        return NOTHING
    X, Z = first.signals[:, start - first.first :], second.signals[:, start - second.first :]
    agreements = []
    for part in _pieces(stop - start, step, parameters):
        x, z = (signals[:, part] - signals[:, part].mean(axis=1, keepdims=True) for signals in (X, Z))
        reach = min(int(largest_offset / step), x.shape[1] // 4)
        agreements.append(_at_lag(x, z, int(np.argmax(_canonical(x, z, reach))) - reach, reach, step, parameters))
    middle = agreements[len(agreements) // 2]
    usual = sorted(agreements, key=lambda piece: piece.log10_chance)[len(agreements) // 2]
    return replace(usual, shift=middle.shift) if middle.log10_chance <= usual.log10_chance else usual


def _pieces(n: int, step: float, parameters: ScreeningParameters) -> list[slice]:
    length = int(parameters.piece / step)
    if n <= 2 * length:
        return [slice(0, n)]
    starts = [0, (n - length) // 2, n - length]
    return [slice(start, start + length) for start in starts]


def _canonical(X: FloatArray, Z: FloatArray, reach: int) -> FloatArray:
    """Return the largest squared canonical correlation (2 reach + 1,) of X(i) with Z(i + lag)."""
    n = X.shape[1]
    lags = np.arange(-reach, reach + 1)
    cross = cross_products(X, Z, reach) / (n - np.abs(lags))[:, None, None]
    inner, outer = _inverse(X @ X.T / n), _inverse(Z @ Z.T / n)
    M = (inner @ cross) @ (outer @ cross.transpose(0, 2, 1))
    trace = M[:, 0, 0] + M[:, 1, 1]
    determinant = M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] * M[:, 1, 0]
    return np.asarray(0.5 * trace + np.sqrt(np.maximum(0.25 * trace**2 - determinant, 0.0)))


def _at_lag(
    X: FloatArray, Z: FloatArray, lag: int, reach: int, step: float, parameters: ScreeningParameters
) -> Agreement:
    n = X.shape[1] - abs(lag)
    X, Z = (X[:, :n], Z[:, lag:]) if lag >= 0 else (X[:, -lag:], Z[:, :n])
    X, Z = (signals - signals.mean(axis=1, keepdims=True) for signals in (X, Z))
    p, q = len(X), len(Z)
    both = np.concatenate([X, Z])
    all_of = both @ both.T / n
    cross = all_of[:p, p:]
    M = _inverse(all_of[:p, :p]) @ cross @ _inverse(all_of[p:, p:]) @ cross.T
    squared = np.clip(np.linalg.eigvals(M).real, 0.0, 1.0 - 1e-12)
    samples, correlation_length = _independent(X, Z, step, parameters)
    if samples < parameters.fewest_independent_samples:
        return NOTHING
    wilks = -(samples - 0.5 * (p + q + 3)) * float(np.log1p(-squared).sum())
    search_gauge = max(2 * reach * step / correlation_length, 1.0)
    chance = log10_chance(wilks, p * q) + float(np.log10(search_gauge))
    coefficients = _inverse(all_of[1:, 1:]) @ all_of[1:, 0]  # of y on R and on the other's signals
    return Agreement(float(np.sqrt(squared.max())), min(chance, 0.0), lag * step, float(coefficients[p - 1]), samples)


def _inverse(gram: FloatArray) -> FloatArray:
    size = np.sqrt(np.diag(gram))
    size[size == 0.0] = np.inf
    return np.asarray(np.linalg.inv(gram / np.outer(size, size) + 1e-12 * np.eye(len(gram))) / np.outer(size, size))


def _independent(X: FloatArray, Z: FloatArray, step: float, parameters: ScreeningParameters) -> tuple[float, float]:
    n = X.shape[1]
    far = min(int(parameters.correlation_length / step), n - 1)
    products = own_products(np.concatenate([X, Z]), far)
    memories = [values / max(float(values[0]), SMALLEST) for values in products]
    widths = [1.0 + 2.0 * float((a[1:] * b[1:]).sum()) for a in memories[: len(X)] for b in memories[len(X) :]]
    width = max([*widths, 1.0])
    return n / width, width * step


def disagreement(found: Agreement, usual: float, p: ScreeningParameters, other: str) -> Reason | None:
    """Return why two signals do not agree; None where they do."""
    if found.log10_chance > p.log10_chance:
        return Reason(
            ReasonCode.OTHER_SECTION,
            f"not of this section: agrees with {other} no more than by chance"
            f" (correlation {found.correlation:.2f} over {found.samples:.0f} independent samples)",
        )
    factor = found.factor / usual
    if factor < 0.0:
        return Reason(
            ReasonCode.MIRRORED, f"the mirror image of {other}: the axes of its sensors, or its direction, are reversed"
        )
    if not p.least_factor <= factor <= 1.0 / p.least_factor:
        return Reason(ReasonCode.SCALE_DIFFERS, f"its lateral displacement is {factor:.2g} times that of {other}")
    return None

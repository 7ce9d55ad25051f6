"""Signals along the track to their cross-spectra in bands of wavelength."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from estimation.signatures.parameters import SignatureParameters
from estimation.values.arrays import FloatArray
from estimation.values.signatures import POWERS, SIGNALS

_PAIRS = ((0, 1), (0, 2), (1, 2))


def band_spectra(signals: FloatArray, parameters: SignatureParameters) -> tuple[FloatArray, float]:
    """Return the mean cross-spectra (b, 9) of a stretch in the bands, and the wavelength at which R is strongest, m.

    Blocks lose their mean and slope and have Hann's window; they overlap by half (P. D. Welch, IEEE Trans. Audio and
    Electroacoustics 15, 1967).

    Args:
        signals: (3, n) y in m, R in m, roll in rad, every ``step`` m.
    """
    size = round(parameters.block / parameters.step)
    starts = range(0, signals.shape[1] - size + 1, size // 2)
    total = sum((_products(signals[:, at : at + size]) for at in starts), np.zeros((SIGNALS, SIGNALS, size // 2 + 1)))
    mean = total / (len(starts) * np.sum(np.hanning(size) ** 2) / parameters.step)
    wavenumber = np.asarray(np.fft.rfftfreq(size, parameters.step), dtype=np.float64)
    ends = parameters.wavenumbers
    inside = [(wavenumber >= low) & (wavenumber < high) for low, high in pairwise(ends)]
    bands = np.stack([mean[:, :, chosen].mean(axis=2) for chosen in inside])  # (b, 3, 3)
    columns = [bands[:, i, i].real for i in range(POWERS)]
    for i, k in _PAIRS:
        columns += [bands[:, i, k].real, bands[:, i, k].imag]
    return np.stack(columns, axis=1), _peak(mean[1, 1].real, wavenumber, ends)


def _products(block: FloatArray) -> FloatArray:
    """Return the periodograms (3, 3, k) of one block (3, n)."""
    n = block.shape[1]
    t = np.arange(n) - 0.5 * (n - 1)
    level = block - block.mean(axis=1, keepdims=True)
    straight = level - ((level @ t) / (t @ t))[:, None] * t
    waves = np.fft.rfft(straight * np.hanning(n))
    return np.asarray(waves[:, None, :] * waves[None, :, :].conj())


def _peak(power: FloatArray, wavenumber: FloatArray, ends: FloatArray) -> float:
    """Return the wavelength, m, at which a power is largest, smoothed over three lines."""
    smooth = np.convolve(power, np.ones(3) / 3, mode="same")
    chosen = (wavenumber >= ends[0]) & (wavenumber < ends[-1])
    return float(1.0 / wavenumber[chosen][np.argmax(smooth[chosen])])

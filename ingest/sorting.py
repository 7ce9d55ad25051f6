"""The two loops that touch every frame, compiled: frames by identifier, and raw counts to SI values."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from estimation.values.arrays import FloatArray, IntArray

STANDARD_IDENTIFIERS = 0x800


@numba.njit(cache=True, nogil=True)
def count_by_identifier(
    arbitration_id: npt.NDArray[np.uint32], dlc: npt.NDArray[np.uint8], lengths: npt.NDArray[np.int16]
) -> tuple[IntArray, int, int]:
    """Count the frames that have an 11-bit identifier by identifier.

    Parameters
    ----------
    arbitration_id, dlc
        (n,) as in a batch.
    lengths
        (2048,) bytes that a frame must have, -1 for unknown identifiers.

    Returns
    -------
    counts
        (2049,) good frames by identifier, shifted by one: their cumulative sum says where each identifier starts.
    wrong
        Frames with a known identifier and another length.
    unknown
        Frames with an unknown identifier.
    """
    counts = np.zeros(STANDARD_IDENTIFIERS + 1, np.int64)
    wrong = 0
    unknown = 0
    for i in range(arbitration_id.shape[0]):
        identifier = arbitration_id[i]
        if identifier < STANDARD_IDENTIFIERS:
            length = lengths[identifier]
            if length == dlc[i]:
                counts[identifier + 1] += 1
            elif length < 0:
                unknown += 1
            else:
                wrong += 1
    return counts, wrong, unknown


@numba.njit(cache=True, nogil=True)
def gather_by_identifier(
    arbitration_id: npt.NDArray[np.uint32],
    dlc: npt.NDArray[np.uint8],
    lengths: npt.NDArray[np.int16],
    words: npt.NDArray[np.uint64],
    starts: IntArray,
) -> tuple[IntArray, npt.NDArray[np.uint64]]:
    """Return positions and payload words of the good frames, by identifier, each in the order of the batch.

    ``starts`` is the cumulative sum of what :func:`count_by_identifier` returns.

    Parameters
    ----------
    arbitration_id, dlc
        (n,) as in a batch.
    lengths
        (2048,) bytes that a frame must have, -1 for unknown identifiers.
    words
        (n,) payloads.
    starts
        (2049,) cumulative sum of what :func:`count_by_identifier` returns.
    """
    place = starts.copy()
    index = np.empty(starts[-1], np.int64)
    gathered = np.empty(starts[-1], np.uint64)
    for i in range(arbitration_id.shape[0]):
        identifier = arbitration_id[i]
        if identifier < STANDARD_IDENTIFIERS and lengths[identifier] == dlc[i]:
            at = place[identifier]
            place[identifier] = at + 1
            index[at] = i
            gathered[at] = words[i]
    return index, gathered


@numba.njit(cache=True, nogil=True)
def scaled(
    raw: npt.NDArray[np.signedinteger[Any]], low: IntArray, high: IntArray, scale: FloatArray, offset: FloatArray
) -> FloatArray:
    """Return ``raw * scale + offset`` (n, m), NaN where ``raw`` is outside ``low..high`` (each (m,)).

    Parameters
    ----------
    raw
        (n, m) raw values.
    low, high
        (m,) limits of each signal.
    scale, offset
        (m,) conversion of each signal.
    """
    n, m = raw.shape
    values = np.empty((n, m))
    for i in range(n):
        for j in range(m):
            value = np.int64(raw[i, j])
            values[i, j] = value * scale[j] + offset[j] if low[j] <= value <= high[j] else np.nan
    return values


@numba.njit(cache=True, nogil=True)
def count_within(raw: npt.NDArray[np.signedinteger[Any]], low: IntArray, high: IntArray) -> int:
    """Count the raw values (n, m) inside ``low..high`` (each (m,)).

    Parameters
    ----------
    raw
        (n, m) raw values.
    low, high
        (m,) limits of each signal.
    """
    n, m = raw.shape
    count = 0
    for i in range(n):
        for j in range(m):
            value = np.int64(raw[i, j])
            count += low[j] <= value <= high[j]
    return count

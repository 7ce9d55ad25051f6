"""Arrays inside frozen values: checked and made read-only at construction."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def bin_centres(edges: FloatArray) -> FloatArray:
    """Return the centres (b,) of adjoining bins, in the unit of the edges.

    Args:
        edges: (b + 1,) increasing.
    """
    return np.asarray(0.5 * (edges[:-1] + edges[1:]))


def runs(mask: BoolArray) -> IntArray:
    """Return (k, 2) the first index of every run of True, and the one behind its last.

    Args:
        mask: (n,) samples.
    """
    return np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))).reshape(-1, 2)


def as_slice(index: IntArray) -> IntArray | slice:
    """Return increasing indices as a slice where none is left out: many times quicker to take and to add to.

    Args:
        index: (n,) increasing.
    """
    if len(index) == 0 or index[-1] - index[0] + 1 != len(index):
        return index
    return slice(int(index[0]), int(index[-1]) + 1)


def frozen_array(
    value: npt.ArrayLike, shape: tuple[int | None, ...], dtype: npt.DTypeLike = np.float64, *, name: str
) -> npt.NDArray[Any]:
    """Return ``value`` as a read-only, C-contiguous array of ``dtype`` and ``shape``.

    Args:
        value: Anything numpy takes. Never modified: an array that is still writable is copied.
        shape: Expected shape; ``None`` stands for any length.

    Raises:
        ValueError: The number of axes or a length differs.
    """
    array = np.ascontiguousarray(value, dtype=dtype)
    wanted = len(shape)
    if array.ndim != wanted or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        raise ValueError(f"{name}: shape {array.shape}, expected {shape}")
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array

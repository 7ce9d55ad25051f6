"""Arrays inside frozen values: checked and made read-only at construction."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cache
from typing import Annotated, Any, NamedTuple, cast, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def bin_centres(edges: FloatArray) -> FloatArray:
    """Return the centres (b,) of adjoining bins with edges (b + 1,), in their unit."""
    return np.asarray(0.5 * (edges[:-1] + edges[1:]))


def runs(mask: BoolArray) -> IntArray:
    """Return (k, 2) the first index of every run of True in (n,) samples, and the one behind its last."""
    return np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))).reshape(-1, 2)


def as_slice(index: IntArray) -> IntArray | slice:
    """Return increasing indices as a slice where none is left out: many times quicker to take and to add to."""
    if len(index) == 0 or index[-1] - index[0] + 1 != len(index):
        return index
    return slice(int(index[0]), int(index[-1]) + 1)


def frozen_array(
    value: npt.ArrayLike, shape: tuple[int | None, ...], dtype: npt.DTypeLike = np.float64, *, name: str
) -> npt.NDArray[Any]:
    """Return a read-only, C-contiguous array of a shape, None in it for any length; ValueError where it is another."""
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


class FrozenArrays:
    """A frozen value that checks the arrays in its annotated fields and makes them read-only.

    ``Annotated[FloatArray, "n", 3, None]`` has three axes: of a length that is the same wherever the value says "n"
    ("n + 1" is one longer), of three, and of any. A tuple may have a length as well.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        freeze(self)


def freeze(value: object) -> None:
    """Check the arrays and tuples of a value as :class:`FrozenArrays` does (ValueError); arrays become read-only."""
    lengths: dict[str, int] = {}
    for field in _annotated_fields(cast("Hashable", type(value))):
        item = getattr(value, field.name)
        if item is None:
            continue
        shape = tuple(lengths[at] + more if at in lengths else more if at == "" else None for at, more in field.axes)
        if field.dtype is not None:
            item = frozen_array(item, shape, field.dtype, name=field.name)
            object.__setattr__(value, field.name, item)
        elif shape[0] is not None and len(item) != shape[0]:
            raise ValueError(f"{field.name}: length {len(item)}, expected {shape[0]}")
        have = (len(item),) if field.dtype is None else item.shape
        lengths |= {at: length - more for (at, more), length in zip(field.axes, have, strict=True) if at}


class _AnnotatedField(NamedTuple):
    name: str
    dtype: type[np.generic] | None  # None of a tuple
    axes: tuple[tuple[str | None, int], ...]  # a name and how much longer; "" and a length; None where any will do


@cache
def _annotated_fields(kind: Hashable) -> tuple[_AnnotatedField, ...]:
    found = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        for part in (hint, *get_args(hint)):
            if get_origin(part) is Annotated:
                base, *metadata = get_args(part)
                axes = [axis for axis in metadata if axis is None or isinstance(axis, str | int)]
                if not axes:
                    continue
                dtype = get_args(get_args(base)[1])[0] if get_origin(base) is np.ndarray else None
                found.append(_AnnotatedField(name, dtype, tuple(_axis(axis) for axis in axes)))
    return tuple(found)


def _axis(axis: str | int | None) -> tuple[str | None, int]:
    if isinstance(axis, str):
        name, _, more = axis.partition(" ")
        return name, int(more.replace(" ", "") or 0)
    return (None, 0) if axis is None else ("", axis)

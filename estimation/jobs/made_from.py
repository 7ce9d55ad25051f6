"""One digest of everything that a result is made from."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from operator import attrgetter
from typing import Any, cast

import numpy as np

PLAIN = frozenset({int, float, str, bytes, bool, type(None)})
"""Types whose ``repr`` is read as the same value again: many of them are written at once."""

Add = Callable[[bytes], None]


def made_from(*inputs: object) -> str:
    """Return the digest of frozen values, exact to the last bit of their numbers and arrays.

    A field with ``metadata={"made_from": False}`` is left out: what another field stands for, or is only carried along.
    """
    digest = hashlib.sha256()
    _write_items(inputs, digest.update)
    return digest.hexdigest()


@cache
def _writer(of: type[Any]) -> Callable[[Any, Add], None]:
    """Return what writes the values of a type."""
    if issubclass(of, np.ndarray):
        return _write_array
    if is_dataclass(of):
        return _fields_writer(of)
    if issubclass(of, tuple | list):
        return _write_items
    if issubclass(of, Mapping):
        return lambda value, add: _write_items([(key, value[key]) for key in sorted(value, key=repr)], add)
    if issubclass(of, set | frozenset):
        return lambda value, add: _write_items(sorted(value, key=repr), add)
    return lambda value, add: add(f"{value!r};".encode())


def _write_array(value: np.ndarray[Any, Any], add: Add) -> None:
    add(f"{value.dtype.str}{value.shape}".encode())
    add(np.ascontiguousarray(value).tobytes())


def _fields_writer(of: type[Any]) -> Callable[[Any, Add], None]:
    names = [field.name for field in fields(of) if field.metadata.get("made_from", True)]
    title = of.__name__.encode()
    read = attrgetter(*names) if len(names) > 1 else None

    def write(value: object, add: Add) -> None:
        add(title)
        _write_items([getattr(value, name) for name in names] if read is None else read(value), add)

    return write


def _write_items(items: tuple[object, ...] | list[object], add: Add) -> None:
    if PLAIN.issuperset(map(type, items)):
        add(repr(tuple(items)).encode())
        return
    add(f"[{len(items)}".encode())
    for item in items:
        _writer(cast("Hashable", type(item)))(item, add)

"""One digest of everything that a result is made from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass

import numpy as np


def made_from(*inputs: object) -> str:
    """Return the digest of frozen values, exact to the last bit of their numbers and arrays.

    A field with ``metadata={"made_from": False}`` is left out: what another field stands for, or is only carried along.
    """
    digest = hashlib.sha256()
    for part in _parts(inputs):
        digest.update(part)
    return digest.hexdigest()


def _parts(value: object) -> Iterator[bytes]:
    if isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif is_dataclass(value):
        yield type(value).__name__.encode()
        for field in fields(value):
            if field.metadata.get("made_from", True):
                yield from _parts(getattr(value, field.name))
    elif isinstance(value, Mapping):
        for key in sorted(value, key=repr):
            yield from _parts((key, value[key]))
    elif isinstance(value, set | frozenset):
        yield from _parts(sorted(value, key=repr))
    elif isinstance(value, tuple | list):
        yield f"[{len(value)}".encode()
        for item in value:
            yield from _parts(item)
    else:
        yield f"{value!r};".encode()  # a number is written so that it is read as the same one again

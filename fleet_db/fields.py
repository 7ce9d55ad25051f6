"""The fields of a frozen value as named arrays and JSON, exactly: the value's own class is the only description of it.

Arrays stay arrays. Every other field becomes JSON by its type: None, flags, whole numbers and texts as they are, an
enumeration by its value, a float in hexadecimal, which loses no bit of NaN, infinity or a signed zero, a tuple as a
list, a mapping as an object, and a value inside a value (an estimate) as the list of its fields.
"""

from __future__ import annotations

import json
import math
import struct
import types
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
import orjson
import zstandard

from estimation.errors import DamagedError, StorageError
from estimation.values.fields import JsonValue

MAGIC = b"TWPK"
FORMAT, VERSION = 1, 1
LEVEL = 1
DTYPES: Mapping[str, np.dtype[Any]] = {
    "<f8": np.dtype("<f8"),
    "<i8": np.dtype("<i8"),
    "<i2": np.dtype("<i2"),
    "|u1": np.dtype("|u1"),
}
LARGEST = 1 << 30  # bytes that a blob may unfold to

Array = npt.NDArray[Any]


def pack(kind: str, scalars: Mapping[str, JsonValue], arrays: Mapping[str, Array]) -> bytes:
    """Return one blob of ``scalars`` (JSON without NaN) and ``arrays`` (float64, int64, int16, uint8, of any shape)."""
    described = [[name, _little(array).dtype.str, list(array.shape)] for name, array in arrays.items()]
    header = json.dumps(
        {"kind": kind, "version": VERSION, "scalars": dict(scalars), "arrays": described},
        separators=(",", ":"),
        allow_nan=False,
    ).encode()
    body = b"".join([struct.pack("<I", len(header)), header, *(_shuffled(array) for array in arrays.values())])
    compressor = zstandard.ZstdCompressor(level=LEVEL, write_checksum=True)
    return MAGIC + bytes([FORMAT]) + compressor.compress(body)


def unpack(blob: bytes, kind: str, *, where: str) -> tuple[Mapping[str, Any], Mapping[str, Array]]:
    """Return scalars and arrays, read-only, that ``pack`` put into ``blob``; DamagedError names ``where`` from."""
    if blob[: len(MAGIC)] != MAGIC or blob[len(MAGIC) : len(MAGIC) + 1] != bytes([FORMAT]):
        raise DamagedError(f"{where}: not packed arrays of format {FORMAT}")
    try:
        body = _unfolded(blob[len(MAGIC) + 1 :])
        (length,) = struct.unpack_from("<I", body)
        header = orjson.loads(body[4 : 4 + length])
        arrays = _arrays(body, 4 + length, header["arrays"])
    except (zstandard.ZstdError, struct.error, ValueError, KeyError, TypeError) as error:
        raise DamagedError(f"{where}: damaged ({error})") from error
    if header["kind"] != kind:
        raise DamagedError(f"{where}: holds {header['kind']!r}, expected {kind!r}")
    return header["scalars"], arrays


def _unfolded(frame: bytes) -> bytes:
    size = zstandard.frame_content_size(frame)
    if not 0 <= size <= LARGEST:
        raise ValueError(f"claims to unfold to {size} bytes")
    return zstandard.ZstdDecompressor().decompress(frame)


def _little(array: Array) -> Array:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    if little.dtype.str not in DTYPES:
        raise TypeError(f"arrays of {array.dtype} are not packed")
    return little


def _shuffled(array: Array) -> bytes:
    """Return all first bytes of the numbers, then all second bytes, and so on."""
    little = np.ascontiguousarray(_little(array)).reshape(-1)
    if little.itemsize == 1:
        return little.tobytes()
    return little.view(np.uint8).reshape(-1, little.itemsize).T.tobytes()


def _arrays(body: bytes, place_in_body: int, described: list[list[Any]]) -> dict[str, Array]:
    arrays: dict[str, Array] = {}
    for name, code, shape in described:
        dtype: np.dtype[Any] = DTYPES[code]
        count = math.prod(shape)
        size = count * dtype.itemsize
        raw = np.frombuffer(body, np.uint8, size, place_in_body)
        numbers = np.empty((count, dtype.itemsize), np.uint8)
        for place, one_byte in enumerate(raw.reshape(dtype.itemsize, count)):  # a fifth of what transposing takes
            numbers[:, place] = one_byte
        array = numbers.reshape(-1).view(dtype).reshape(shape)
        array.flags.writeable = False
        arrays[name] = array
        place_in_body += size
    if place_in_body != len(body):
        raise ValueError(f"{len(body) - place_in_body} bytes left over")
    return arrays


V = TypeVar("V")


def fields_of(value: object, *, without: Collection[str] = ()) -> tuple[dict[str, JsonValue], dict[str, Array]]:
    """Return the fields of a frozen value: JSON and arrays under their names, in the order of the class."""
    scalars: dict[str, JsonValue] = {}
    arrays: dict[str, Array] = {}
    for name, hint in hints_of(cast("Hashable", type(value))).items():
        if name in without:
            continue
        item = getattr(value, name)
        if get_origin(hint) is np.ndarray:
            arrays[name] = item
        else:
            scalars[name] = to_json(item)
    return scalars, arrays


def value_of(kind: type[V], scalars: Mapping[str, Any], arrays: Mapping[str, Array], **given: object) -> V:
    """Return the value of what ``fields_of`` returned; ``given`` wins. Raises StorageError where a field is missing."""
    stored = dict(given)
    try:
        for name, read in _field_readers(cast("Hashable", kind), frozenset(given)):
            stored[name] = arrays[name] if read is None else read(scalars[name])
    except (LookupError, ValueError) as error:
        raise StorageError(f"a packed {kind.__name__} does not fit: {error}") from error
    return kind(**stored)


def to_json(item: object) -> JsonValue:
    """Return a field as JSON; raises TypeError where its type has no place in it."""
    if isinstance(item, Enum):
        item = item.value
    elif is_dataclass(item):
        item = tuple(getattr(item, field.name) for field in fields(item))
    if item is None or isinstance(item, bool | str):
        return item
    if isinstance(item, int | np.integer):
        return int(item)
    if isinstance(item, float):
        return float(item).hex()
    if isinstance(item, Mapping):
        return {str(name): to_json(part) for name, part in item.items()}
    if isinstance(item, tuple | list):
        return [to_json(part) for part in item]
    raise TypeError(f"{type(item).__name__} has no place in a packed value")


def from_json(stored: Any, hint: Any) -> Any:  # noqa: ANN401 - the type is what the hint says
    """Return a field of the type ``hint`` from what ``to_json`` returned; raises StorageError where it does not fit."""
    return _reader(hint)(stored)


@cache
def _reader(hint: Hashable) -> Callable[[Any], Any]:
    """Return what reads fields of a type; made once, because to ask a type for its parts takes longer than to read."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in {Union, types.UnionType}:
        (read,) = (_reader(part) for part in parts if part is not types.NoneType)
        return lambda stored: None if stored is None else read(stored)
    if origin is not None:
        return _collection_reader(origin, _reader(parts[0 if origin is tuple else 1]))
    if hint is float:
        return _number
    if isinstance(hint, type) and issubclass(hint, Enum):
        return Members(hint).__getitem__
    if isinstance(hint, type) and is_dataclass(hint):
        return _value_reader(hint)
    return _same


def _same(stored: Any) -> Any:  # noqa: ANN401 - as ``from_json``
    return stored


def _collection_reader(origin: object, read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    if read is _same:
        return tuple if origin is tuple else dict
    if origin is tuple:
        return lambda stored: tuple(map(read, stored))
    return lambda stored: {name: read(item) for name, item in stored.items()}


def _value_reader(kind: type[Any]) -> Callable[[Any], Any]:
    readers = [_reader(field_hint) for field_hint in hints_of(cast("Hashable", kind)).values()]

    def read(stored: Any) -> Any:  # noqa: ANN401 - as ``from_json``
        return kind(*[reader(item) for reader, item in zip(readers, stored, strict=True)])

    return read


class Members(dict[Any, Enum]):
    """The members of an enumeration by their values: hundreds are read at once, and to call the class takes longer."""

    def __init__(self, kind: type[Enum]) -> None:
        super().__init__({member.value: member for member in kind})
        self._kind = kind

    def __missing__(self, stored: object) -> Enum:
        return self._kind(stored)  # raises


def _number(stored: object) -> float:
    if isinstance(stored, str):
        return float.fromhex(stored)
    if isinstance(stored, int):
        return stored  # a whole number beside floats, such as a date in nanoseconds, keeps its last digit
    raise StorageError(f"a packed number is {stored!r}")


@cache
def _field_readers(kind: Hashable, without: frozenset[str]) -> tuple[tuple[str, Callable[[Any], Any] | None], ...]:
    """Return what reads the fields of a dataclass from JSON; None where one is an array."""
    hints = ((name, hint) for name, hint in hints_of(kind).items() if name not in without)
    return tuple((name, None if get_origin(hint) is np.ndarray else _reader(hint)) for name, hint in hints)


@cache
def hints_of(kind: Hashable) -> Mapping[str, Any]:
    """Return the types of the fields of a dataclass, in the order of its fields."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(cast("Any", kind))}

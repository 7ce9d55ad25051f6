"""The fields of a frozen value as named arrays and JSON, exactly: the value's own class is the only description of it.

Arrays stay arrays. Every other field becomes JSON by its type: None, flags, whole numbers and texts as they are, an
enumeration by its value, a float in hexadecimal, which loses no bit of NaN, infinity or a signed zero, a tuple as a
list, a mapping as an object, and a value inside a value (an estimate) as the list of its fields.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from estimation.errors import StorageError
from estimation.values.json_value import JsonValue
from fleet_db.packing import Array

V = TypeVar("V")


def fields_of(value: object, *, without: Collection[str] = ()) -> tuple[dict[str, JsonValue], dict[str, Array]]:
    """Return the fields of a frozen value: JSON and arrays under their names, in the order of the class."""
    scalars: dict[str, JsonValue] = {}
    arrays: dict[str, Array] = {}
    for name, hint in _hints(cast("Hashable", type(value))).items():
        if name in without:
            continue
        item = getattr(value, name)
        if get_origin(hint) is np.ndarray:
            arrays[name] = item
        else:
            scalars[name] = to_json(item)
    return scalars, arrays


def value_of(kind: type[V], scalars: Mapping[str, Any], arrays: Mapping[str, Array], **given: object) -> V:
    """Return the value whose fields were stored.

    Args:
        scalars, arrays: What ``fields_of`` returned; names that are no field are ignored.
        given: Fields that were not stored this way; they win.

    Raises:
        StorageError: A field is missing or does not fit its type.
    """
    stored = dict(given)
    try:
        for name, hint in _hints(cast("Hashable", kind)).items():
            if name not in given:
                stored[name] = arrays[name] if get_origin(hint) is np.ndarray else from_json(scalars[name], hint)
    except (LookupError, ValueError) as error:
        raise StorageError(f"a packed {kind.__name__} does not fit: {error}") from error
    return kind(**stored)


def to_json(item: object) -> JsonValue:
    """Return a field as JSON.

    Raises:
        TypeError: Its type has no place in JSON.
    """
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
        return {str(name): to_json(one) for name, one in item.items()}
    if isinstance(item, tuple | list):
        return [to_json(one) for one in item]
    raise TypeError(f"{type(item).__name__} has no place in a packed value")


def from_json(stored: Any, hint: Any) -> Any:  # noqa: ANN401 - the type is what the hint says
    """Return a field from JSON.

    Args:
        stored: What ``to_json`` returned.
        hint: The type of the field, as the class declares it.

    Raises:
        StorageError: ``stored`` does not fit.
    """
    return _reader(hint)(stored)


@cache
def _reader(hint: Hashable) -> Callable[[Any], Any]:
    """Return what reads fields of a type; made once, because to ask a type for its parts takes longer than to read."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in {Union, types.UnionType}:
        (read,) = (_reader(one) for one in parts if one is not types.NoneType)
        return lambda stored: None if stored is None else read(stored)
    if origin is not None:
        return _collection_reader(origin, _reader(parts[0 if origin is tuple else 1]))
    if hint is float:
        return _number
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _Members(hint).__getitem__
    if isinstance(hint, type) and is_dataclass(hint):
        return _value_reader(hint)
    return lambda stored: stored


def _collection_reader(origin: object, read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    if origin is tuple:
        return lambda stored: tuple(map(read, stored))
    return lambda stored: {name: read(one) for name, one in stored.items()}


def _value_reader(kind: type[Any]) -> Callable[[Any], Any]:
    readers = [_reader(one) for one in _hints(cast("Hashable", kind)).values()]

    def read(stored: Any) -> Any:  # noqa: ANN401 - as ``from_json``
        return kind(*[reader(one) for reader, one in zip(readers, stored, strict=True)])

    return read


class _Members(dict[Any, Enum]):
    """The members of an enumeration by their values: a geometry holds hundreds, and to call the class takes longer."""

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
def _hints(kind: Hashable) -> Mapping[str, Any]:
    """Return the types of the fields of a dataclass, in the order of its fields."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(cast("Any", kind))}

"""A list of representations as a table: one column a number, in an order that follows from the schema alone.

Parts of a representation become columns named after both; of a pair the ends; lists become one cell, of words joined by
``; `` or, of anything else, as JSON. Paths of related resources are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import orjson
from pydantic import BaseModel

ITEMS = "items"
LINKS = "links"
_PLAIN = (str, int, float, bool)
_ENDS = ("low", "high")
Convert = Callable[[Any], object]


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its name, the fields that lead to its cell, and what is written of what is there."""

    name: str
    fields: tuple[str, ...]
    convert: Convert = lambda value: value

    def read(self, item: Any) -> object:  # noqa: ANN401 - any representation
        """Return the cell of a representation; of what is absent it is absent."""
        for field in self.fields:
            item = None if item is None else getattr(item, field)
        return None if item is None else self.convert(item)


def item_of(model: Any) -> type[BaseModel] | None:  # noqa: ANN401 - whatever a route answers with
    """Return what the items of a list are; None where the model is no list."""
    if not (isinstance(model, type) and issubclass(model, BaseModel)) or ITEMS not in model.model_fields:
        return None
    (item,) = get_args(model.model_fields[ITEMS].annotation) or (None,)
    return item if isinstance(item, type) and issubclass(item, BaseModel) else None


@cache
def columns_of(model: type[BaseModel]) -> tuple[Column, ...]:
    """Return the columns of a representation, in the order of its fields."""
    return tuple(_columns(model, (), ()))


def table(model: type[BaseModel], items: Sequence[BaseModel]) -> tuple[Sequence[str], Iterator[Sequence[object]]]:
    """Return header and rows of a list."""
    columns = columns_of(model)
    return [column.name for column in columns], ([column.read(item) for column in columns] for item in items)


def _columns(model: type[BaseModel], path: tuple[str, ...], fields: tuple[str, ...]) -> Iterator[Column]:
    for name, info in model.model_fields.items():
        if name != LINKS:
            yield from _cells(info.annotation, (*path, info.serialization_alias or name), (*fields, name))


def _cells(annotation: Any, path: tuple[str, ...], fields: tuple[str, ...]) -> Iterator[Column]:  # noqa: ANN401 - any type
    kind, arguments = _known(annotation)
    name = "_".join(path)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield from _columns(kind, path, fields)
    elif kind is tuple and len(arguments) == len(_ENDS) and Ellipsis not in arguments:
        for place, end in enumerate(_ENDS):
            yield Column(f"{name}_{end}", fields, itemgetter(place))
    elif isinstance(kind, type) and issubclass(kind, _PLAIN):
        yield Column(name, fields)
    elif kind in {list, tuple} and all(
        isinstance(_known(one)[0], type) and issubclass(_known(one)[0], _PLAIN)
        for one in arguments
        if one is not Ellipsis
    ):
        yield Column(name, fields, lambda values: "; ".join(map(str, values)))
    else:
        yield Column(name, fields, lambda value: orjson.dumps(value, default=_plain).decode())


def _known(annotation: Any) -> tuple[Any, tuple[Any, ...]]:  # noqa: ANN401 - any type
    """Return a type without what may be absent or is said about it, and its arguments."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _known(arguments[0])
    if origin in {Union, UnionType}:
        present = [one for one in arguments if one is not NoneType]
        return _known(present[0]) if len(present) == 1 else (None, ())
    return (annotation, ()) if origin is None else (origin, arguments)


def _plain(value: Any) -> object:  # noqa: ANN401 - what orjson does not know
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True)
    raise TypeError(f"{type(value).__name__} has no place in a table")

"""Frozen values as tables of files: a dataclass says what its fields are called there, in which unit and range.

::

    @dataclass(frozen=True, slots=True)
    class Curve:
        start: Annotated[NotNegative, M]  # key ``start_m``
        cant: Annotated[float, Interval(ge=-200.0, le=200.0), MM] = 0.0  # key ``cant_mm``; m here

Ranges are those of the file. A method ``of_file(given)`` checks what fields say together, where errors name keys, and
returns the value, completed where it follows from which keys were given.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from datetime import datetime
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, get_args, get_origin, get_type_hints

import pydantic
from annotated_types import Interval
from pydantic import (
    AfterValidator,
    BeforeValidator,
    GetPydanticSchema,
    PrivateAttr,
    create_model,
    model_validator,
)
from pydantic_core import core_schema

from estimation.errors import ParameterError
from estimation.values.fields import FileDefault, FileForm, FileUnit, JsonValue, Key
from estimation.values.reasons import EPOCH, utc_text
from ingest.input_file import (
    Code,
    FreeText,
    InputFile,
    InputTable,
    Location,
    NotNegative,
    Text,
    field_error,
    increasing,
)

T = TypeVar("T")
FIRST_YEAR, LAST_YEAR = 1900, 2200  # ns since 1970 end in 2262
_DECIMALS = re.compile(r"[.,](\d+)")  # of a second
_TEXTS: Mapping[object, Any] = {FileForm.TEXT: Text, FileForm.FREE_TEXT: FreeText, FileForm.CODE: Code}


def between(lowest: float, highest: float) -> Interval:
    """Return the range of a number of a file, both ends included."""
    return Interval(ge=lowest, le=highest)


@dataclass(frozen=True, slots=True)
class As:
    """The field is read as another table, whose ``plan()``, where it has one, is its value.

    ``defaults`` are values of fields that a file need not have there.
    """

    table: type
    defaults: tuple[tuple[str, object], ...] = ()


@dataclass(frozen=True, slots=True)
class Inline:
    """The keys of a table stand among those of its owner; the value is its ``plan()``, or itself.

    It is None where a key is missing that it must have.
    """

    table: type


def written(file_type: Any, read: Callable[[Any], Any]) -> GetPydanticSchema:  # noqa: ANN401 - any type of a field
    """Return the annotation of a field that a file has as another type."""
    return GetPydanticSchema(
        lambda _, handler: core_schema.no_info_after_validator_function(read, handler.generate_schema(file_type))
    )


class ValueTable(InputTable):
    """The table that a frozen value is read from."""

    value_type: ClassVar[type]
    fixed: ClassVar[Mapping[str, object]]  # fields that no file has, and that have no default
    _value: Any = PrivateAttr()

    @property
    def value(self) -> Any:  # noqa: ANN401 - of ``value_type``
        """The value."""
        return self._value

    @model_validator(mode="after")
    def _make(self) -> Self:
        columns = type(self).model_fields
        given = frozenset(columns[name].alias or name for name in self.model_fields_set)
        content = {name: getattr(self, name) for name in columns}
        self._value = _made(self.value_type, {**self.fixed, **content}, given)
        return self


def read_value(file: InputFile, value_type: type[T], location: Location = ()) -> T:
    """Return the content of a file, or what is at a place of it, as a frozen value."""
    value: T = file.parse(table_of(value_type), location).value  # type: ignore[arg-type]
    return value


@cache
def table_of(value_type: type, defaults: tuple[tuple[str, object], ...] = ()) -> type[ValueTable]:
    """Return the table that a dataclass is read from."""
    columns = _columns(value_type)
    for name in columns.keys() & dict(defaults):
        kind, column = columns[name]
        columns[name] = (kind, pydantic.Field(alias=column.alias, default=dict(defaults)[name]))
    table: type[ValueTable] = create_model(value_type.__name__, __base__=ValueTable, **columns)
    table.value_type, table.fixed = value_type, {name: value for name, value in defaults if name not in columns}
    return table


def entry_of(value: Any) -> dict[str, JsonValue]:  # noqa: ANN401 - a dataclass
    """Return a frozen value as a table of a JSON file; read again it is the same value."""
    hints, entry = get_type_hints(type(value), include_extras=True), dict[str, JsonValue]()
    for item in fields(value):
        metadata = _metadata(hints[item.name])
        key = _key(item.name, metadata)
        if key is not None:
            entry[key] = _written(getattr(value, item.name), metadata)
    return entry


def _written(value: Any, metadata: tuple[object, ...]) -> JsonValue:  # noqa: ANN401 - of any field
    if value is None:
        return None
    if FileForm.MOMENT in metadata:
        return utc_text(value)
    unit = next((mark for mark in metadata if isinstance(mark, FileUnit)), None)
    if unit is not None:
        return unit.write(value)
    return list(value) if isinstance(value, tuple) else value.value if isinstance(value, StrEnum) else value


def keys_of(value_type: type) -> tuple[str, ...]:
    """Return the keys that a file may have of a value."""
    return tuple(column.alias for _, column in _columns(value_type).values())


def taken(value_type: type[T], wider: object, **changes: object) -> T:
    """Return a value with the fields that it shares with another one."""
    names = (item.name for item in fields(value_type))  # type: ignore[arg-type]
    shared = {name: getattr(wider, name) for name in names if hasattr(wider, name)}
    return value_type(**(shared | changes))


def _columns(value_type: type, *, optional: bool = False) -> dict[str, Any]:
    """Return type and default of every field that files have."""
    hints, columns = get_type_hints(value_type, include_extras=True), dict[str, Any]()
    for item in fields(value_type):
        metadata = _metadata(hints[item.name])
        inline = next((mark for mark in metadata if isinstance(mark, Inline)), None)
        key = _key(item.name, metadata)
        if inline is not None:
            columns |= _columns(inline.table, optional=item.default is None)
        elif key is not None:
            columns[item.name] = (_in_file(hints[item.name]), _default(item, key, metadata, optional=optional))
    return columns


def _metadata(hint: Any) -> tuple[object, ...]:  # noqa: ANN401 - any type of a field
    """Return what is said of a field; of one that may be None, what is said of its value."""
    if get_origin(hint) in {Union, types.UnionType}:
        return next((marks for part in get_args(hint) if (marks := _metadata(part))), ())
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


def _key(name: str, metadata: tuple[object, ...]) -> str | None:
    for mark in metadata:
        if isinstance(mark, Key):
            return mark.name
    return name + next((mark.suffix for mark in metadata if isinstance(mark, FileUnit)), "")


def _default(item: Field[Any], key: str, metadata: tuple[object, ...], *, optional: bool) -> Any:  # noqa: ANN401 - as pydantic gives it
    default = next((mark.value for mark in metadata if isinstance(mark, FileDefault)), item.default)
    if item.default_factory is not MISSING:
        return pydantic.Field(alias=key, default_factory=item.default_factory)
    if default is not MISSING or optional:
        return pydantic.Field(alias=key, default=default)
    return pydantic.Field(alias=key)


def _in_file(hint: Any) -> Any:  # noqa: ANN401 - any type of a field
    """Return the type of a field as a table has it: lists for tuples, texts for names, tables for values."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return Annotated[(_inner(args[0], args[1:]), *map(_validator, args[1:]))]
    if origin in {Union, types.UnionType}:
        return Union[tuple(map(_in_file, args))]  # noqa: UP007 - of as many as there are
    if origin is tuple:
        return Annotated[list[_in_file(args[0])], AfterValidator(tuple)]  # type: ignore[misc]
    if is_dataclass(hint):
        return Annotated[table_of(hint), AfterValidator(lambda table: table.value)]  # type: ignore[arg-type]
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return Annotated[Text, AfterValidator(_member(hint))]
    return hint


def _inner(hint: Any, metadata: tuple[object, ...]) -> Any:  # noqa: ANN401 - any type of a field
    for mark in metadata:
        if isinstance(mark, As):
            return Annotated[table_of(mark.table, mark.defaults), AfterValidator(_plan)]
        if mark is FileForm.CHOICE:
            return Annotated[Literal[tuple(map(str, hint))], AfterValidator(hint)]
        if mark in _TEXTS:
            return _TEXTS[mark]
    return _in_file(hint)


def _validator(metadata: object) -> object:
    if metadata is FileForm.MOMENT:
        return BeforeValidator(nanoseconds)
    return AfterValidator(metadata.read) if isinstance(metadata, FileUnit) else metadata


def nanoseconds(value: object) -> int:
    """Return a time in ISO 8601 with its offset from UTC as ns since 1970."""
    try:
        moment = datetime.fromisoformat(value) if isinstance(value, str) else None
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        raise field_error(f"{value!r} is not a time with its offset from UTC, as in 2024-01-08T05:30:00Z")
    since = moment.replace(microsecond=0) - EPOCH
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise field_error(f"{value!r} is outside the years {FIRST_YEAR} to {LAST_YEAR}")
    decimals = _DECIMALS.search(str(value))
    rest_ns = int(decimals[1][:9].ljust(9, "0")) if decimals else 0
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + rest_ns


def _plan(table: ValueTable) -> Any:  # noqa: ANN401 - whatever it stands for
    return table.value.plan() if hasattr(table.value, "plan") else table.value


def _member(names: type[StrEnum]) -> Callable[[str], StrEnum]:
    def member(text: str) -> StrEnum:
        with suppress(ValueError):
            return names(text)
        raise field_error(f"{text!r} is none of {', '.join(names)}")

    return member


def _made(value_type: Any, content: dict[str, Any], given: frozenset[str]) -> Any:  # noqa: ANN401 - a dataclass
    """Return a value from the content of its table, which may hold that of others; checked as a file first."""
    value = object.__new__(value_type)
    hints = get_type_hints(value_type, include_extras=True)
    for item in fields(value_type):
        inline = next((mark for mark in _metadata(hints[item.name]) if isinstance(mark, Inline)), None)
        if inline is not None:
            made = _inline(inline.table, content, given)
        elif item.name in content:
            made = content[item.name]
        else:
            made = item.default_factory() if item.default_factory is not MISSING else item.default
        object.__setattr__(value, item.name, made)
    try:
        if hasattr(value, "of_file"):
            value = value.of_file(given)
        if hasattr(value, "__post_init__"):
            value.__post_init__()
    except ParameterError as error:
        raise field_error(error.reason, *([error.field] if error.field else [])) from error
    return value


def _inline(table: type, content: dict[str, Any], given: frozenset[str]) -> Any:  # noqa: ANN401 - whatever it stands for
    columns = _columns(table)
    if any(content[name] is MISSING for name in columns):
        return None
    value = _made(table, {name: content[name] for name in columns}, given)
    return value.plan() if hasattr(value, "plan") else value


FileBeside = Annotated[
    Path,
    GetPydanticSchema(
        lambda _, handler: core_schema.with_info_after_validator_function(
            lambda name, info: Path(info.context or ".") / name, handler.generate_schema(Text)
        )
    ),
]
"""A file named in another one; a relative name starts in the folder of that file."""

IncreasingPlaces = Annotated[tuple[NotNegative, ...], AfterValidator(increasing)]

Counted = Annotated[int, Interval(ge=1)]

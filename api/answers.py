"""Answers: JSON or CSV with a strong ETag, pages with a link to the next, preconditions.

A list as a table has one column a number, in an order that follows from the schema alone. Parts of a representation
become columns named after both; of a pair the ends; lists become one cell, of words joined by ``; `` or, of anything
else, as JSON. Paths of related resources are left out.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from http import HTTPMethod, HTTPStatus
from operator import itemgetter
from threading import Lock
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin
from urllib.parse import quote, urlencode

import orjson
from fastapi import Header, Query, Request, Response
from pydantic import BaseModel

from api.contract import CSV, JSON
from api.problems import ProblemError

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
        for name in self.fields:
            item = None if item is None else getattr(item, name)
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
        isinstance(_known(argument)[0], type) and issubclass(_known(argument)[0], _PLAIN)
        for argument in arguments
        if argument is not Ellipsis
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
        present = [argument for argument in arguments if argument is not NoneType]
        return _known(present[0]) if len(present) == 1 else (None, ())
    return (annotation, ()) if origin is None else (origin, arguments)


def _plain(value: Any) -> object:  # noqa: ANN401 - what orjson does not know
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True)
    raise TypeError(f"{type(value).__name__} has no place in a table")


Table = tuple[Sequence[str], Iterable[Sequence[object]]]
BodyT = TypeVar("BodyT", bound=BaseModel)

Limit = Annotated[int, Query(ge=1, le=1000, description="How many items at most.")]
Cursor = Annotated[str | None, Query(description="`next_cursor` of the page before, with the same filter.")]
IfMatch = Annotated[str | None, Header(alias="If-Match", description="ETag of the resource as it was read; required.")]
IfNoneMatch = Annotated[
    str | None, Header(alias="If-None-Match", description="ETag that the client holds; 304 when it is still right.")
]
IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=255,
        description="A repeat with the same key changes nothing and gets the same answer.",
    ),
]
DEFAULT_LIMIT = 100
_CSV_TYPE = f"{CSV}; charset=utf-8; header=present"
_GUARDED = ("=", "+", "-", "@", "\t", "\r")


def payload_of(body: BaseModel) -> bytes:
    """Return the JSON text of a representation."""
    return body.model_dump_json(by_alias=True).encode()


def entity_tag(payload: bytes) -> str:
    """Return the strong ETag of these bytes."""
    return f'"{hashlib.blake2b(payload, digest_size=16).hexdigest()}"'


def _listed(header: str) -> list[str]:
    return [tag.strip() for tag in header.split(",")]


def _unchanged(request: Request, tag: str) -> bool:
    header = request.headers.get("if-none-match")
    if request.method != HTTPMethod.GET or header is None:
        return False
    return header.strip() == "*" or tag in [held.removeprefix("W/") for held in _listed(header)]


def answer_bytes(
    request: Request, payload: bytes, *, media_type: str = JSON, status: int = 200, headers: Mapping[str, str] = {}
) -> Response:
    """Return ``payload`` with its ETag, or 304 where the client holds it already."""
    tag = entity_tag(payload)
    all_headers = {"ETag": tag, "Cache-Control": "no-cache", "Vary": "Accept", **headers}
    if status == HTTPStatus.OK and _unchanged(request, tag):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=all_headers)
    return Response(payload, status, headers=all_headers, media_type=media_type)


def answer(request: Request, body: BaseModel, *, status: int = 200, headers: Mapping[str, str] = {}) -> Response:
    """Return a representation with its ETag: as JSON, or a list as the table that the client asked for."""
    item = item_of(request.scope["route"].response_model) if wants_table(request) else None
    if item is not None:
        rows = csv_text(*table(item, getattr(body, ITEMS)))
        return answer_bytes(request, rows, media_type=_CSV_TYPE, headers=headers)
    return answer_bytes(request, payload_of(body), status=status, headers=headers)


def wants_table(request: Request) -> bool:
    """Return whether the client asked for CSV, and the operation offers it."""
    return getattr(request.state, "media_type", JSON) == CSV


def _cell(value: object) -> object:
    """Return what is written for a value; an apostrophe guards text that a spreadsheet would run as a formula."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str) and value.startswith(_GUARDED):
        return f"'{value}"
    return "" if value is None else value


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """Return a table as CSV (RFC 4180); unknown values are empty, numbers are written to their last digit."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(header)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue().encode()


def table_payload(body: BodyT, media_type: str, table: Callable[[BodyT], Table]) -> bytes:
    """Return a representation as JSON, or its table as CSV."""
    return csv_text(*table(body)) if media_type == CSV else payload_of(body)


def answer_payload(request: Request, payload: bytes, media_type: str) -> Response:
    """Return what :func:`table_payload` gave."""
    return answer_bytes(request, payload, media_type=_CSV_TYPE if media_type == CSV else media_type)


def next_path(request: Request, name: str, cursor: str) -> str:
    """Return the path of the next page: this request with another cursor."""
    kept = [(key, value) for key, value in request.query_params.multi_items() if key != name]
    return f"{quote(request.scope['path'])}?{urlencode([*kept, (name, cursor)])}"


def answer_items(request: Request, items: Iterable[bytes], cursor: str | None, path: str | None) -> Response:
    """Return one page of a list whose items are JSON already."""
    rest = orjson.dumps({"next_cursor": cursor, "next": path})
    return answer_bytes(request, b'{"items":[' + b",".join(items) + b"]," + rest[1:], headers=link(path))


def link(path: str | None) -> Mapping[str, str]:
    """Return the header that names the next page."""
    return {} if path is None else {"Link": f'<{path}>; rel="next"'}


def operation(request: Request) -> str:
    """Return the name of the operation that answers this request."""
    return str(request.scope["route"].name)


def require_match(header: str | None, current: BaseModel) -> None:
    """Refuse (428, 412) a change to something that the client has not seen as it is now."""
    if header is None:
        raise ProblemError(428, "precondition-required", "send the ETag of the resource as If-Match")
    tag = entity_tag(payload_of(current))
    if header.strip() != "*" and tag not in _listed(header):
        raise ProblemError(412, "precondition-failed", "the resource has changed; read it again", headers={"ETag": tag})


CACHED_BYTES = 64 << 20  # size of the representations that one process keeps, in bytes


@dataclass(slots=True)
class RepresentationCache:
    """The least recently used representation is displaced first; safe for threads."""

    limit_bytes: int = CACHED_BYTES
    _held: OrderedDict[Hashable, bytes] = field(default_factory=OrderedDict)
    _bytes: int = 0
    _lock: Lock = field(default_factory=Lock)

    def get_or_make(self, key: Hashable, make: Callable[[], bytes]) -> bytes:
        """Return what is kept under a key, or make it and keep it."""
        return self.get_or_make_all({0: key}, lambda _: {0: make()})[0]

    def get_or_make_all(
        self, keys: Mapping[int, Hashable], make: Callable[[Sequence[int]], Mapping[int, bytes]]
    ) -> Mapping[int, bytes]:
        """Return what is kept of several under one name each, and make and keep what is missing, all at once."""
        with self._lock:
            kept = {number: self._held[key] for number, key in keys.items() if key in self._held}
            for number in kept:
                self._held.move_to_end(keys[number])
        missing = [number for number in keys if number not in kept]
        if missing:
            made = make(missing)
            with self._lock:
                for number, representation in made.items():
                    self._keep(keys[number], representation)
            kept |= made
        return kept

    def _keep(self, key: Hashable, made: bytes) -> None:
        if key in self._held or len(made) > self.limit_bytes:
            return
        self._held[key] = made
        self._bytes += len(made)
        while self._bytes > self.limit_bytes:
            _, displaced = self._held.popitem(last=False)
            self._bytes -= len(displaced)

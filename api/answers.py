"""Answers: JSON or CSV with a strong ETag, pages with a link to the next, preconditions."""

from __future__ import annotations

import csv
import hashlib
import io
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from http import HTTPMethod, HTTPStatus
from threading import Lock
from typing import Annotated, TypeVar
from urllib.parse import quote, urlencode

import orjson
from fastapi import Header, Query, Request, Response
from pydantic import BaseModel, SerializeAsAny

from api import cursors
from api.contract import CSV, JSON
from api.csv_tables import ITEMS, item_of, table
from api.problems import ProblemError
from api.schemas.common import Page

RecordT = TypeVar("RecordT")
ItemT = TypeVar("ItemT", bound=BaseModel)

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
        return _answer_csv(request, table(item, getattr(body, ITEMS)), headers)
    return answer_bytes(request, payload_of(body), status=status, headers=headers)


def wants_table(request: Request) -> bool:
    """Return whether the client asked for CSV, and the operation offers it."""
    return getattr(request.state, "media_type", JSON) == CSV


def _answer_csv(
    request: Request, rows: tuple[Sequence[str], Iterable[Sequence[object]]], headers: Mapping[str, str] = {}
) -> Response:
    return answer_bytes(request, csv_text(*rows), media_type=_CSV_TYPE, headers=headers)


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


def table_payload(body: BaseModel, media_type: str, rows: tuple[Sequence[str], Iterable[Sequence[object]]]) -> bytes:
    """Return a representation as JSON, or its table as CSV."""
    return csv_text(*rows) if media_type == CSV else payload_of(body)


def answer_payload(request: Request, payload: bytes, media_type: str) -> Response:
    """Return what :func:`table_payload` gave."""
    return answer_bytes(request, payload, media_type=_CSV_TYPE if media_type == CSV else media_type)


def next_path(request: Request, name: str, cursor: str) -> str:
    """Return the path of the next page: this request with another cursor."""
    kept = [(key, value) for key, value in request.query_params.multi_items() if key != name]
    return f"{quote(request.scope['path'])}?{urlencode([*kept, (name, cursor)])}"


def answer_page(
    request: Request,
    filters: Mapping[str, object],
    limit: int,
    rows: Sequence[RecordT],
    key: Callable[[RecordT], cursors.Key],
    represent: Callable[[RecordT], ItemT],
) -> Response:
    """Return one page of a list, as JSON or as a table.

    Args:
        rows: Up to ``limit + 1`` records behind the cursor; one more than shown means that there is a next page.
    """
    shown, cursor, path = _shown(request, filters, limit, rows, key)
    return answer(
        request,
        Page[SerializeAsAny[BaseModel]](items=[represent(row) for row in shown], next_cursor=cursor, next=path),
        headers=_link(path),
    )


def answer_payloads(
    request: Request,
    filters: Mapping[str, object],
    limit: int,
    rows: Sequence[RecordT],
    key: Callable[[RecordT], cursors.Key],
    payload: Callable[[RecordT], bytes],
    represent: Callable[[RecordT], ItemT],
) -> Response:
    """Return one page of a list whose items are kept as JSON, for long lists that are read often."""
    if wants_table(request):
        return answer_page(request, filters, limit, rows, key, represent)
    shown, cursor, path = _shown(request, filters, limit, rows, key)
    rest = orjson.dumps({"next_cursor": cursor, "next": path})
    body = b'{"items":[' + b",".join(payload(row) for row in shown) + b"]," + rest[1:]
    return answer_bytes(request, body, headers=_link(path))


def _shown(
    request: Request,
    filters: Mapping[str, object],
    limit: int,
    rows: Sequence[RecordT],
    key: Callable[[RecordT], cursors.Key],
) -> tuple[Sequence[RecordT], str | None, str | None]:
    """Return the records of a page, the cursor of the next and its path; None where this is the last."""
    shown = rows[:limit]
    if len(rows) <= limit:
        return shown, None, None
    cursor = cursors.encode(operation(request), filters, key(shown[-1]))
    return shown, cursor, next_path(request, "cursor", cursor)


def _link(path: str | None) -> Mapping[str, str]:
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


CACHED_BYTES = 64 << 20
"""Size of the representations that one process keeps, in bytes."""


@dataclass(slots=True)
class RepresentationCache:
    """The least recently used representation is displaced first; safe for threads."""

    limit_bytes: int = CACHED_BYTES
    _held: OrderedDict[Hashable, bytes] = field(default_factory=OrderedDict)
    _bytes: int = 0
    _lock: Lock = field(default_factory=Lock)

    def get_or_make(self, key: Hashable, make: Callable[[], bytes]) -> bytes:
        """Return what is kept under a key, or make it and keep it."""
        with self._lock:
            known = self._held.get(key)
            if known is not None:
                self._held.move_to_end(key)
                return known
        made = make()
        with self._lock:
            self._keep(key, made)
        return made

    def get_or_make_all(
        self, keys: Mapping[int, Hashable], make: Callable[[Sequence[int]], Mapping[int, bytes]]
    ) -> Mapping[int, bytes]:
        """Return what is kept of several under one name each, and make and keep what is missing, all at once."""
        with self._lock:
            found = {number: self._held[key] for number, key in keys.items() if key in self._held}
            for number in found:
                self._held.move_to_end(keys[number])
        missing = [number for number in keys if number not in found]
        if missing:
            made = make(missing)
            with self._lock:
                for number, representation in made.items():
                    self._keep(keys[number], representation)
            found |= made
        return found

    def _keep(self, key: Hashable, made: bytes) -> None:
        if key in self._held or len(made) > self.limit_bytes:
            return
        self._held[key] = made
        self._bytes += len(made)
        while self._bytes > self.limit_bytes:
            _, displaced = self._held.popitem(last=False)
            self._bytes -= len(displaced)

"""What routes are asked with: the request and the services, the page of a list, the conditions of a change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Annotated, TypeVar

from fastapi import Depends, Request, Response
from pydantic import BaseModel

from api import cursors
from api.access.caller import Caller, CallerDep
from api.answers import (
    DEFAULT_LIMIT,
    Cursor,
    IdempotencyKey,
    IfMatch,
    IfNoneMatch,
    Limit,
    answer,
    answer_page,
    operation,
)
from api.services import Services, ServicesDep
from fleet_db.storage import SqlUnitOfWork

RecordT = TypeVar("RecordT")
Filters = Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Asked:
    """A request, and what answers it."""

    request: Request
    services: Services

    def read(self) -> AbstractContextManager[SqlUnitOfWork]:
        """Return a transaction that shows what the caller sees."""
        return self.services.storage.read()

    def answer(self, body: BaseModel) -> Response:
        """Return a representation with its ETag."""
        return answer(self.request, body)


@dataclass(frozen=True, slots=True)
class AskedList(Asked):
    """A request for a page of a list."""

    cursor: str | None
    limit: int

    def after(self, filters: Filters) -> object:
        """Return the key that the page begins behind, of any form; None at the beginning."""
        return cursors.decode(operation(self.request), filters, self.cursor)

    def after_number(self, filters: Filters) -> int | None:
        """Return the number that the page begins behind; None at the beginning."""
        return cursors.decode_number(operation(self.request), filters, self.cursor)

    def after_text(self, filters: Filters) -> str | None:
        """Return the text that the page begins behind; None at the beginning."""
        return cursors.decode_text(operation(self.request), filters, self.cursor)

    def page(
        self,
        filters: Filters,
        rows: Sequence[RecordT],
        key: Callable[[RecordT], cursors.Key],
        represent: Callable[[RecordT], BaseModel],
    ) -> Response:
        """Return a page: up to ``limit + 1`` records behind the cursor, as ``answer_page`` does."""
        return answer_page(self.request, filters, self.limit, rows, key, represent)

    def numbered(
        self,
        filters: Filters,
        found: Iterable[RecordT],
        key: Callable[[RecordT], int],
        represent: Callable[[RecordT], BaseModel],
    ) -> Response:
        """Return a page of all records, in the order of a number."""
        after = self.after_number(filters)
        rows = [record for record in sorted(found, key=key) if after is None or key(record) > after]
        return self.page(filters, rows[: self.limit + 1], key, represent)

    def named(
        self,
        found: Iterable[RecordT],
        key: Callable[[RecordT], str],
        represent: Callable[[RecordT], BaseModel],
    ) -> Response:
        """Return a page of all records, in the order of their names."""
        after = self.after_text({})
        rows = [record for record in sorted(found, key=key) if after is None or key(record) > after]
        return self.page({}, rows[: self.limit + 1], key, represent)


@dataclass(frozen=True, slots=True)
class AskedChange(Asked):
    """A request for a change: by whom, of what state, and under which key it may be repeated."""

    caller: Caller
    if_match: str | None = None
    key: str | None = None


async def _asked(request: Request, services: ServicesDep, _held: IfNoneMatch = None) -> Asked:
    return Asked(request, services)


async def _list(
    request: Request, services: ServicesDep, cursor: Cursor = None, limit: Limit = DEFAULT_LIMIT
) -> AskedList:
    return AskedList(request, services, cursor, limit)


async def _change(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    if_match: IfMatch = None,
    idempotency_key: IdempotencyKey = None,
) -> AskedChange:
    return AskedChange(request, services, caller, if_match, idempotency_key)


async def _new(
    request: Request, services: ServicesDep, caller: CallerDep, idempotency_key: IdempotencyKey = None
) -> AskedChange:
    return AskedChange(request, services, caller, None, idempotency_key)


async def _put(request: Request, services: ServicesDep, caller: CallerDep, if_match: IfMatch = None) -> AskedChange:
    return AskedChange(request, services, caller, if_match)


AskedDep = Annotated[Asked, Depends(_asked)]
AskedListDep = Annotated[AskedList, Depends(_list)]
ChangeDep = Annotated[AskedChange, Depends(_change)]
NewDep = Annotated[AskedChange, Depends(_new)]
PutDep = Annotated[AskedChange, Depends(_put)]

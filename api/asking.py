"""What routes are asked with: the request and the services, the page of a list, the conditions of a change.

Changes of the registry are entered as a registry file is, and answered with the record.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Annotated, Literal, TypeVar

import orjson
from fastapi import Depends, Path, Query, Request, Response
from pydantic import BaseModel, Field, SerializeAsAny

from api import cursors
from api.access.gate import CallerDep
from api.access.key_ring import Caller
from api.answers import (
    DEFAULT_LIMIT,
    Cursor,
    IdempotencyKey,
    IfMatch,
    IfNoneMatch,
    Limit,
    answer,
    answer_bytes,
    answer_items,
    link,
    next_path,
    operation,
    payload_of,
    require_match,
    wants_table,
)
from api.problems import ProblemError, invalid
from api.schemas.common import Body, Page
from api.services import Services, ServicesDep
from api.times import Moment, to_rfc3339
from estimation.errors import InputError
from estimation.values.reasons import ReasonCode
from estimation.values.registry import MOST_KM
from fleet_db.records import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.input_file import MEBIBYTE, Location, dotted
from ingest.registry_entry.contents import Entry, RegistryContents, Rule
from ingest.registry_entry.enter import enter

CODE = r"^[^\x00-\x1f\x7f]{1,64}$"
_INT64_MAX = 2**63 - 1

Code = Annotated[str, Path(pattern=CODE, examples=["demo"])]
Serial = Annotated[str, Path(pattern=CODE, description="Serial of the wheelset.", examples=["WS-0001"])]
Version = Annotated[int | None, Query(ge=1, le=2**31 - 1, description="Left out, the latest.")]
OfCode = Annotated[ReasonCode | None, Query(description="Only with this reason code.")]
Number = Annotated[int, Path(ge=1, le=_INT64_MAX, examples=[1])]
FleetFilter = Annotated[str | None, Query(pattern=CODE, description="Only of this fleet.")]
VehicleFilter = Annotated[str | None, Query(pattern=CODE, description="Only what runs under this vehicle now.")]
WheelsetFilter = Annotated[str | None, Query(pattern=CODE, description="Only of this wheelset.")]
AsOf = Annotated[
    Moment | None,
    Query(description="The result as recorded at this time; reproducible.", examples=["2026-01-31T12:00:00Z"]),
]
MeasuredFrom = Annotated[Moment | None, Query(alias="from", description="Measured at or after this time.")]
MeasuredTo = Annotated[Moment | None, Query(alias="to", description="Measured before this time.")]


def require_order(from_ns: int | None, to_ns: int | None, begin: str = "from", end: str = "to") -> None:
    """Refuse (422) a range that ends before it begins; an empty one, `[t, t)`, is allowed; None is open."""
    if from_ns is not None and to_ns is not None and from_ns > to_ns:
        raise invalid(f"#/{begin}", f"is after `{end}`", f"{begin} is after {end}", "query")


def not_in_the_future(as_of_ns: int | None, now_ns: int) -> None:
    """Refuse (422) a time in the future."""
    if as_of_ns is not None and as_of_ns > now_ns:
        raise invalid("#/as_of", "is in the future", "as_of is in the future", "query")


def not_purged(as_of_ns: int | None, purged_before_ns: int | None) -> None:
    """Refuse (410) a time from which replaced results are not kept any more: what was known then is not known now."""
    if as_of_ns is not None and purged_before_ns is not None and as_of_ns < purged_before_ns:
        kept = to_rfc3339(purged_before_ns)
        raise ProblemError(410, "history-purged", f"replaced results are kept from {kept} on, see the retention")


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

    def one(self, represent: Callable[[SqlUnitOfWork], BaseModel]) -> Response:
        """Return the representation of what is read, with its ETag."""
        with self.read() as unit:
            return self.answer(represent(unit))


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

    def after_time(self, filters: Filters, from_ns: int | None) -> int | None:
        """Return the time that the page begins behind, at the beginning that of a filter; None without one."""
        after = self.after_number(filters)
        return from_ns - 1 if after is None and from_ns is not None else after

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
        """Return a page, as JSON or as a table, of up to ``limit + 1`` records behind the cursor."""
        shown, cursor, path = self._shown(filters, rows, key)
        items = [represent(row) for row in shown]
        body = Page[SerializeAsAny[BaseModel]](items=items, next_cursor=cursor, next=path)
        return answer(self.request, body, headers=link(path))

    def payloads(
        self,
        filters: Filters,
        rows: Sequence[RecordT],
        key: Callable[[RecordT], cursors.Key],
        payload: Callable[[RecordT], bytes],
        represent: Callable[[RecordT], BaseModel],
    ) -> Response:
        """Return a page whose items are kept as JSON, for long lists that are read often."""
        if wants_table(self.request):
            return self.page(filters, rows, key, represent)
        shown, cursor, path = self._shown(filters, rows, key)
        return answer_items(self.request, map(payload, shown), cursor, path)

    def _shown(
        self, filters: Filters, rows: Sequence[RecordT], key: Callable[[RecordT], cursors.Key]
    ) -> tuple[Sequence[RecordT], str | None, str | None]:
        shown = rows[: self.limit]
        if len(rows) <= self.limit:
            return shown, None, None
        cursor = cursors.encode(operation(self.request), filters, key(shown[-1]))
        return shown, cursor, next_path(self.request, "cursor", cursor)

    def numbered(
        self,
        filters: Filters,
        records: Iterable[RecordT],
        key: Callable[[RecordT], int],
        represent: Callable[[RecordT], BaseModel],
    ) -> Response:
        """Return a page of all records, in the order of a number."""
        after = self.after_number(filters)
        rows = [record for record in sorted(records, key=key) if after is None or key(record) > after]
        return self.page(filters, rows[: self.limit + 1], key, represent)

    def named(
        self, records: Iterable[RecordT], key: Callable[[RecordT], str], represent: Callable[[RecordT], BaseModel]
    ) -> Response:
        """Return a page of all records, in the order of their names."""
        after = self.after_text({})
        rows = [record for record in sorted(records, key=key) if after is None or key(record) > after]
        return self.page({}, rows[: self.limit + 1], key, represent)


@dataclass(frozen=True, slots=True)
class AskedChange(Asked):
    """A request for a change: by whom, of what state, and under which key it may be repeated."""

    caller: Caller
    if_match: str | None = None
    key: str | None = None

    def once(
        self, body: BaseModel, apply: Callable[[SqlUnitOfWork, int], BaseModel], status: HTTPStatus = HTTPStatus.OK
    ) -> Response:
        """Change something in one transaction; the same request again changes nothing and gets the same answer."""
        post, now_ns = self._post(body), self.services.clock.now_ns()
        with self.services.storage.write() as unit:
            earlier = self._earlier(unit, *post)
            if earlier is not None:
                return earlier
            done = payload_of(apply(unit, now_ns))
            self._remember(unit, *post, status, done)
        return self._answered(done, status)

    def beside(
        self, body: BaseModel | None, act: Callable[[], BaseModel], status: HTTPStatus = HTTPStatus.OK
    ) -> Response:
        """Do what has transactions of its own; the same request again does nothing and gets the same answer."""
        post = self._post(body)
        with self.read() as unit:
            earlier = self._earlier(unit, *post)
        if earlier is not None:
            return earlier
        done = payload_of(act())
        with self.services.storage.write() as unit:
            self._remember(unit, *post, status, done)
        return self._answered(done, status)

    def _post(self, body: BaseModel | None) -> tuple[str | None, str]:
        """Return under what a request is remembered, None without a key, and a digest of what it asks for."""
        asked = [
            self.request.method,
            self.request.scope["path"],
            None if body is None else body.model_dump(mode="json"),
        ]
        key, identity = self.key, self.caller.identity
        if key is not None and identity is not None:  # another key's answers are not for this caller
            key = f"{hashlib.sha256(identity.encode()).hexdigest()[:32]} {hashlib.sha256(key.encode()).hexdigest()}"
        return key, hashlib.sha256(orjson.dumps(asked)).hexdigest()

    def _earlier(self, unit: SqlUnitOfWork, key: str | None, digest: str) -> Response | None:
        stored = None if key is None else unit.idempotency.get(key)
        if stored is None:
            return None
        earlier, status, body = stored
        if earlier != digest:
            detail = "this Idempotency-Key was used for another request; use a new one"
            raise ProblemError(422, "idempotency-key-reused", detail)
        return self._answered(body.encode(), status, {"Idempotency-Replayed": "true"})

    def _remember(self, unit: SqlUnitOfWork, key: str | None, digest: str, status: int, done: bytes) -> None:
        if key is not None:
            unit.idempotency.put(key, digest, status, done.decode(), self.services.clock.now_ns())

    def _answered(self, payload: bytes, status: int, headers: Mapping[str, str] = {}) -> Response:
        if status == HTTPStatus.ACCEPTED:
            headers = {**headers, "Location": orjson.loads(payload)["links"]["self"]}
        return answer_bytes(self.request, payload, status=status, headers=headers)


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


TEXT = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"
MOST_TEXT = MEBIBYTE  # of one file; a request has at most as much
UNNAMED = "unnamed client"  # who changes something where access is open and nobody says who it is
Confirmable = Literal["odometer_backwards", "odometer_jump", "unknown_profile", "unusual_gauge", "unusual_radius"]
Key = Annotated[str, Field(pattern=CODE)]
Note = Annotated[str, Field(max_length=2000, pattern=TEXT)]
Kilometres = Annotated[float, Field(ge=0.0, le=MOST_KM)]


class RegistryChange(Body):
    """What every change of the registry may say."""

    why: Note = Field(default="", description="Kept with the record in its history.", examples=["work order 4711"])
    by: Key | None = Field(
        default=None,
        description="Who; 'unnamed client' if left out where access control is off; else at most the key's owner.",
        examples=["j.smith"],
    )
    confirm: list[Confirmable] = Field(
        default=[], description="Doubts of a refusal that are unfounded: it is so all the same.", examples=[[]]
    )


@dataclass(frozen=True, slots=True)
class BodySource:
    """Names the field of a request's body for a field of a registry file."""

    # by field of the file; by array and index before it (``mountings[1].from``) where several records are entered
    names: Mapping[str, str] = field(default_factory=dict)

    def error(self, reason: str, location: Location = ()) -> InputError:
        """Return the error that names the field of the body."""
        last = next((str(part) for part in location[2:3]), "")
        return InputError(reason, field=self.names.get(dotted(location)) or self.names.get(last, last) or None)


@dataclass(frozen=True, slots=True)
class RegistryRequest:
    """A request that changes the registry."""

    asked: AskedChange
    body: RegistryChange

    def visible(self, find: Callable[[SqlUnitOfWork], object]) -> None:
        """Refuse what the body names and the caller does not see, as if it did not exist."""
        with self.asked.read() as unit:
            find(unit)

    def change(
        self,
        current: Callable[[SqlUnitOfWork], BaseModel] | None,
        apply: Callable[[SqlUnitOfWork, Decision], BaseModel],
        status: HTTPStatus = HTTPStatus.CREATED,
    ) -> Response:
        """Change something once, in one transaction; ``current`` is what ``If-Match`` is of, None if new."""

        def entered(unit: SqlUnitOfWork, now_ns: int) -> BaseModel:
            if current is not None:
                require_match(self.asked.if_match, current(unit))
            return apply(unit, Decision(self.asked.caller.acts_as(self.body.by, UNNAMED), self.body.why, now_ns))

        return self.asked.once(self.body, entered, status)

    def enter(self, unit: SqlUnitOfWork, decision: Decision, contents: RegistryContents, source: BodySource) -> None:
        """Enter records as a registry file does."""
        confirmed = frozenset(map(Rule, self.body.confirm))
        enter(contents, unit, source, Entry(decision, decision.recorded_ns, confirmed))

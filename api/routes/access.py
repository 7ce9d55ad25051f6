"""Keys, made, listed and revoked by who administers all fleets; and the audit log of changes and refusals."""

from __future__ import annotations

from dataclasses import asdict
from http import HTTPStatus
from typing import Annotated, Any, Self

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import Field, Strict, StringConstraints

from api.access.gate import CallerDep, Scope, requires
from api.access.keys import NOBODY_NAMED, Wanted, make_key
from api.answers import answer
from api.asking import CODE, AskedDep, AskedListDep, require_order
from api.problems import described
from api.schemas.common import Body, Derived, Page
from api.services import ServicesDep, writer_slot
from api.times import Moment
from fleet_db.records import ApiKey, AuditEntry
from fleet_db.stores.access import AuditFilter

Owner = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]{1,100}$", strip_whitespace=True)]
FleetCode = Annotated[str, StringConstraints(pattern=CODE)]
WrittenScope = Annotated[Scope, Strict(strict=False)]  # JSON has texts, not members of an enumeration
FLEETS = "Codes of the fleets that it sees; null is all fleets."


class Key(
    Derived,
    of=ApiKey,
    without=("digest",),
    columns="prefix owner scopes fleets created_at created_by expires_at revoked_at last_used_at links",
    links={"self": "/v1/keys/{prefix}"},
):
    """A key, without its secret."""

    scopes: list[Scope] = Field(description="What it allows; each scope stands for itself alone.")

    @classmethod
    def made(cls, value: ApiKey, **more: Any) -> Self:  # noqa: ANN401 - as of every derived class
        """Return the representation of a key, its scopes in their order."""
        return super().made(value, scopes=[scope for scope in Scope if scope in value.scopes], **more)


class NewKey(Body):
    """A key that is to be made."""

    owner: Owner = Field(description="Who it is for.", examples=["depot west"])
    scopes: list[WrittenScope] = Field(min_length=1, description="What it allows.", examples=[["read", "act"]])
    fleets: list[FleetCode] | None = Field(description=FLEETS, examples=[["alpha"]])
    expires_at: Moment | None = Field(default=None, description="When it expires; null is never.")


class KeyWithSecret(Key):
    """A key that was just made, with its secret."""

    key: str = Field(description="The key itself; it is shown this once and not stored.")


class AuditRecord(
    Derived, of=AuditEntry, columns="id recorded_at owner key_prefix method path status object address request_id"
):
    """One change, or one request that was refused for want of a right."""


router = APIRouter(prefix="/v1", tags=["access"], dependencies=[Depends(requires(Scope.ADMIN, all_fleets=True))])
Prefix = Annotated[str, Path(pattern=r"^[a-z2-7]{8}$", description="Prefix of the key.", examples=["3fq2xh7a"])]


@router.get("/keys", response_model=Page[Key], responses=described(400))
def list_keys(asked: AskedListDep) -> Response:
    """List the keys by prefix, also those that are revoked or have expired; never their secrets."""
    after = asked.after_text({})
    with asked.read() as unit:
        rows = unit.api_keys.page(after, asked.limit + 1)
    return asked.page({}, rows, lambda record: record.prefix, Key.made)


@router.get("/keys/{prefix}", response_model=Key, responses=described(404))
def get_key(asked: AskedDep, prefix: Prefix) -> Response:
    """Return one key, without its secret."""
    return asked.one(lambda unit: Key.made(unit.api_keys.get(prefix)))


@router.post(
    "/keys",
    status_code=HTTPStatus.CREATED,
    response_model=KeyWithSecret,
    responses=described(404, 413, 415),
    dependencies=[Depends(writer_slot)],
)
def create_key(request: Request, services: ServicesDep, caller: CallerDep, body: NewKey) -> Response:
    """Make a key; its secret is in this answer alone. There is no `Idempotency-Key`: its answer would be stored."""
    fleets = None if body.fleets is None else frozenset(body.fleets)
    wanted = Wanted(body.owner, frozenset(body.scopes), fleets, body.expires_at)
    with services.storage.write() as unit:
        made, token = make_key(unit, wanted, caller.name or NOBODY_NAMED, services.clock.now_ns())
    headers = {"Location": f"/v1/keys/{made.prefix}", "Cache-Control": "no-store"}
    return answer(request, KeyWithSecret.made(made, key=token), status=HTTPStatus.CREATED, headers=headers)


@router.post(
    "/keys/{prefix}/revoke", response_model=Key, responses=described(404, 409, 415), dependencies=[Depends(writer_slot)]
)
def revoke_key(request: Request, services: ServicesDep, prefix: Prefix) -> Response:
    """Revoke a key for ever; it is refused after at most 5 s."""
    with services.storage.write() as unit:
        revoked = unit.api_keys.revoke(prefix, services.clock.now_ns())
    return answer(request, Key.made(revoked))


OfOwner = Annotated[str | None, Query(max_length=100, description="Only of this owner of a key or token.")]
OfKey = Annotated[str | None, Query(pattern=r"^[a-z2-7]{8}$", description="Only of the key with this prefix.")]
OfStatus = Annotated[int | None, Query(ge=0, le=599, description="Only answered with this status.")]
OfMethod = Annotated[str | None, Query(pattern="^[A-Za-z]{1,16}$", description="Only of this method.")]
From = Annotated[Moment | None, Query(alias="from", description="Recorded at or after this time.")]
To = Annotated[Moment | None, Query(alias="to", description="Recorded before this time.")]


@router.get("/audit", response_model=Page[AuditRecord], responses=described(400))
def list_audit_entries(
    asked: AskedListDep,
    owner: OfOwner = None,
    key_prefix: OfKey = None,
    status: OfStatus = None,
    method: OfMethod = None,
    recorded_from: From = None,
    recorded_to: To = None,
) -> Response:
    """List changes and refusals, newest first."""
    require_order(recorded_from, recorded_to)
    chosen = AuditFilter(owner, key_prefix, status, method, recorded_from, recorded_to)
    filters = asdict(chosen) | {"from": recorded_from, "to": recorded_to}
    del filters["from_ns"], filters["to_ns"]
    before = asked.after_number(filters)
    with asked.read() as unit:
        rows = unit.audit.page(chosen, before, asked.limit + 1)
    return asked.page(filters, rows, lambda entry: entry.entry_id, AuditRecord.made)

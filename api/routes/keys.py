"""Keys: made, listed and revoked by who administers all fleets."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response

from api.access.caller import NOBODY_NAMED, CallerDep
from api.access.key_ring import Wanted, make_key
from api.access.scopes import Scope, requires
from api.answers import answer
from api.asking import AskedDep, AskedListDep
from api.problems import described
from api.schemas import access
from api.schemas.common import Page
from api.services import ServicesDep, writer_slot

router = APIRouter(prefix="/v1/keys", tags=["access"], dependencies=[Depends(requires(Scope.ADMIN, all_fleets=True))])
Prefix = Annotated[str, Path(pattern=r"^[a-z2-7]{8}$", description="Prefix of the key.", examples=["3fq2xh7a"])]


@router.get("", response_model=Page[access.Key], responses=described(400))
def list_keys(asked: AskedListDep) -> Response:
    """List the keys by prefix, also those that are revoked or have expired; never their secrets."""
    after = asked.after_text({})
    with asked.read() as unit:
        rows = unit.api_keys.page(after, asked.limit + 1)
    return asked.page({}, rows, lambda record: record.prefix, access.key)


@router.get("/{prefix}", response_model=access.Key, responses=described(404))
def get_key(asked: AskedDep, prefix: Prefix) -> Response:
    """Return one key, without its secret."""
    with asked.read() as unit:
        found = unit.api_keys.get(prefix)
    return asked.answer(access.key(found))


@router.post(
    "",
    status_code=HTTPStatus.CREATED,
    response_model=access.KeyWithSecret,
    responses=described(404, 413, 415),
    dependencies=[Depends(writer_slot)],
)
def create_key(request: Request, services: ServicesDep, caller: CallerDep, body: access.NewKey) -> Response:
    """Make a key; its secret is in this answer alone. There is no `Idempotency-Key`: its answer would be stored."""
    fleets = None if body.fleets is None else frozenset(body.fleets)
    wanted = Wanted(body.owner, frozenset(body.scopes), fleets, body.expires_at)
    with services.storage.write() as unit:
        made, token = make_key(unit, wanted, caller.name or NOBODY_NAMED, services.clock.now_ns())
    shown = access.key_with_secret(made, token.text)
    headers = {"Location": f"/v1/keys/{made.prefix}", "Cache-Control": "no-store"}
    return answer(request, shown, status=HTTPStatus.CREATED, headers=headers)


@router.post(
    "/{prefix}/revoke",
    response_model=access.Key,
    responses=described(404, 409, 415),
    dependencies=[Depends(writer_slot)],
)
def revoke_key(request: Request, services: ServicesDep, prefix: Prefix) -> Response:
    """Revoke a key for ever; it is refused after at most 5 s."""
    with services.storage.write() as unit:
        revoked = unit.api_keys.revoke(prefix, services.clock.now_ns())
    return answer(request, access.key(revoked))

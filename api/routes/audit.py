"""The audit log: who changed what, and who was refused."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response

from api.access.scopes import Scope, requires
from api.asking import AskedListDep
from api.parameters import require_order
from api.problems import described
from api.schemas import access
from api.schemas.common import Page
from api.times import Moment
from fleet_db.stores.access import AuditFilter

router = APIRouter(prefix="/v1/audit", tags=["access"], dependencies=[Depends(requires(Scope.ADMIN, all_fleets=True))])
OfOwner = Annotated[str | None, Query(max_length=100, description="Only of this owner of a key or token.")]
OfKey = Annotated[str | None, Query(pattern=r"^[a-z2-7]{8}$", description="Only of the key with this prefix.")]
OfStatus = Annotated[int | None, Query(ge=0, le=599, description="Only answered with this status.")]
OfMethod = Annotated[str | None, Query(pattern="^[A-Za-z]{1,16}$", description="Only of this method.")]
From = Annotated[Moment | None, Query(alias="from", description="Recorded at or after this time.")]
To = Annotated[Moment | None, Query(alias="to", description="Recorded before this time.")]


@router.get("", response_model=Page[access.AuditRecord], responses=described(400))
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
    filters = {
        "owner": owner,
        "key_prefix": key_prefix,
        "status": status,
        "method": method,
        "from": recorded_from,
        "to": recorded_to,
    }
    before = asked.after_number(filters)
    chosen = AuditFilter(owner, key_prefix, status, method, recorded_from, recorded_to)
    with asked.read() as unit:
        rows = unit.audit.page(chosen, before, asked.limit + 1)
    return asked.page(filters, rows, lambda entry: entry.entry_id, access.AuditRecord.made)

"""What failed by itself and is kept apart."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from api import cursors
from api.asking import AskedListDep
from api.known import require_known
from api.parameters import CODE
from api.problems import described
from api.schemas import recordings
from api.schemas.common import Page
from estimation.values.reasons import ReasonCode
from estimation.values.runs import Quarantined, QuarantineState, SubjectKind
from fleet_db.stores.quarantine import Place

router = APIRouter(prefix="/v1/quarantine", tags=["quarantine"])
Kind = Annotated[SubjectKind | None, Query(description="Only of this kind.")]
InState = Annotated[QuarantineState | None, Query(description="Only in this state; `held` is what waits.")]
OfCode = Annotated[ReasonCode | None, Query(description="Only with this reason code.")]
OfVehicle = Annotated[
    str | None, Query(pattern=CODE, description="Only recordings and windows of this vehicle, and the vehicle itself.")
]
PARTS = 3


@router.get("", response_model=Page[recordings.QuarantinedItem], responses=described(400, 404))
def list_quarantine(
    asked: AskedListDep, kind: Kind = None, state: InState = None, reason_code: OfCode = None, vehicle: OfVehicle = None
) -> Response:
    """List what failed by itself, by kind, key and stage; held, and resolved by a later success."""
    filters = {"kind": kind, "state": state, "reason_code": reason_code, "vehicle": vehicle}
    after = _place(asked.after_text(filters))
    with asked.read() as unit:
        rows = unit.quarantine.page(
            kind=kind, state=state, code=reason_code, vehicle=vehicle, after=after, limit=asked.limit + 1
        )
        if not rows:
            require_known(unit, vehicle=vehicle)
    return asked.page(filters, rows, _key, recordings.quarantined)


def _key(item: Quarantined) -> str:
    """Return kind, stage and key as one text; the first two have no slash."""
    return f"{item.kind}/{item.stage}/{item.key}"


def _place(key: str | None) -> Place | None:
    if key is None:
        return None
    parts = key.split("/", PARTS - 1)
    if len(parts) != PARTS:
        raise cursors.refused("this is no cursor of this list")
    kind, stage, subject = parts
    return kind, subject, stage

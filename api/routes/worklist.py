"""The worklist: all wheelsets with how they are, in the order of what is asked; one query, whatever the order."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from api import cursors
from api.answers import DEFAULT_LIMIT, Cursor, Limit, answer_payloads, operation, payload_of
from api.asking import AskedDep
from api.known import require_known
from api.parameters import CODE, FleetFilter, Serial, VehicleFilter
from api.problems import described
from api.schemas import worklist
from api.schemas.alerts import KnownKind
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.values.alerts import Severity, Urgency
from estimation.values.quantities import Status
from fleet_db.stores.worklist import WorklistEntry, WorklistFilter, WorklistOrder, WorklistPlace

REMEMBERED = 8192
"""Rows whose JSON text is kept, by their content: it never gets out of date."""

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])
ClassFilter = Annotated[str | None, Query(pattern=CODE, description="Only what runs under vehicles of this class now.")]
InStatus = Annotated[Status | None, Query(description="Only with a conicity of this status.")]
OfUrgency = Annotated[Urgency | None, Query(description="Only of this urgency.")]
AlertKindFilter = Annotated[KnownKind | None, Query(description="Only with an open alert of this kind.")]
SeverityFilter = Annotated[Severity | None, Query(description="Only where this is the worst severity of open alerts.")]
Sort = Annotated[
    worklist.WorklistSort,
    Query(
        description="What the list is ordered by, the smallest or most urgent first; `-` in front turns it round. What "
        "is not known comes last in both, ties are in the order of the serial."
    ),
]


@router.get("", response_model=Page[worklist.WheelsetRow], responses=described(400, 404))
def list_wheelsets(
    request: Request,
    services: ServicesDep,
    fleet: FleetFilter = None,
    vehicle: VehicleFilter = None,
    vehicle_class: ClassFilter = None,
    status: InStatus = None,
    urgency: OfUrgency = None,
    alert_kind: AlertKindFilter = None,
    alert_severity: SeverityFilter = None,
    sort: Sort = worklist.WorklistSort("serial"),  # noqa: B008 - a constant
    cursor: Cursor = None,
    limit: Limit = DEFAULT_LIMIT,
) -> Response:
    """List the wheelsets with where they run, how they are and how urgent that is; by serial, or by `sort`."""
    chosen = WorklistFilter(fleet, vehicle, vehicle_class, status, urgency, alert_kind, alert_severity)
    filters = {
        "fleet": fleet,
        "vehicle": vehicle,
        "vehicle_class": vehicle_class,
        "status": status,
        "urgency": urgency,
        "alert_kind": alert_kind,
        "alert_severity": alert_severity,
        "sort": sort,
    }
    after = _place(cursors.decode(operation(request), filters, cursor))
    order = WorklistOrder(sort.value.removeprefix("-"))
    with services.storage.read() as unit:
        rows = unit.worklist.page(chosen, order, after, limit + 1, descending=sort.value.startswith("-"))
        if not rows:
            require_known(unit, fleet=fleet, vehicle=vehicle, vehicle_class=vehicle_class)
    return answer_payloads(request, filters, limit, rows, _key, _payload, _row)


@router.get("/{serial}/state", response_model=worklist.WheelsetRow, responses=described(404))
def get_wheelset_state(asked: AskedDep, serial: Serial) -> Response:
    """Return one wheelset as the list has it: where it runs, how it is, and how urgent that is."""
    with asked.read() as unit:
        found = unit.worklist.row(serial)
    return asked.answer(worklist.row_of_document(found))


def _key(entry: WorklistEntry) -> list[float | int | str | None]:
    return [entry.place.key, entry.place.serial]


def _payload(entry: WorklistEntry) -> bytes:
    return _payload_of_document(entry.document)


@lru_cache(REMEMBERED)
def _payload_of_document(document: str) -> bytes:
    return payload_of(worklist.row_of_document(document))


def _row(entry: WorklistEntry) -> worklist.WheelsetRow:
    return worklist.row_of_document(entry.document)


def _place(key: object) -> WorklistPlace | None:
    """Return the place in a cursor; None at the beginning.

    Raises:
        ProblemError: 400: it is no place of this list.
    """
    if key is None:
        return None
    match key:
        case [None | int() | float() as number, str() as serial] if (
            number is None or cursors.is_number(number)
        ) and "\0" not in serial:
            return WorklistPlace(number, serial)
    raise cursors.refused("this is no cursor of this list")

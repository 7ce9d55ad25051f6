"""Work on the sensors of vehicles: exchanged, calibrated."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request, Response

from api import cursors
from api.access.caller import CallerDep
from api.access.scopes import Scope, requires
from api.answers import DEFAULT_LIMIT, Cursor, IdempotencyKey, IfMatch, Limit, answer_page, operation
from api.parameters import Code
from api.problems import described
from api.registry_changes import BodySource, RegistryRequest
from api.schemas import registry, registry_changes
from api.schemas.common import Page
from api.schemas.registry_changes import NewSensorChange
from api.services import ServicesDep, writer_slot
from estimation.errors import ConflictError
from estimation.values.registry import SensorChange, SensorWork
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.registry_entry.contents import RegistryContents

router = APIRouter(prefix="/v1/vehicles", tags=["vehicles"])


@router.get(
    "/{code}/sensor-changes", response_model=Page[registry_changes.SensorChangeRecord], responses=described(400, 404)
)
def list_sensor_changes(
    request: Request, services: ServicesDep, code: Code, cursor: Cursor = None, limit: Limit = DEFAULT_LIMIT
) -> Response:
    """List when sensors of the vehicle were exchanged or calibrated, oldest first."""
    filters = {"vehicle": code}
    after = cursors.decode_number(operation(request), filters, cursor)

    def key(record: SensorChange) -> int:
        return record.at_ns

    with services.storage.read() as unit:
        unit.registry.vehicle(code)
        found = unit.sensor_changes.list(code)
    rows = [record for record in found if after is None or record.at_ns > after]
    return answer_page(request, filters, limit, rows[: limit + 1], key, registry_changes.sensor_change)


@router.post(
    "/{code}/sensor-changes",
    status_code=201,
    dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)],
    response_model=registry_changes.SensorChangeRecord,
    responses=described(404, 409, 412, 413, 415, 428),
)
def add_sensor_change(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    code: Code,
    body: NewSensorChange,
    if_match: IfMatch = None,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Record that the sensors of an axle were exchanged or calibrated: alerts on the sensor before are closed.

    `If-Match` carries the ETag of the vehicle.
    """
    change = RegistryRequest(request, services, caller, body, if_match, idempotency_key)
    record = SensorChange(code, body.axle, body.worked_at, SensorWork(body.work), body.removed, body.fitted, body.note)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry_changes.SensorChangeRecord:
        if unit.sensor_changes.stored(code, record.at_ns) is not None:
            reason = f"work on the sensors of vehicle {code!r} was recorded at the same time; give another time"
            raise ConflictError(reason, kind="vehicle", key=code)
        change.enter(unit, decision, RegistryContents(sensor_changes=(record,)), BodySource({"at": "worked_at"}))
        return registry_changes.sensor_change(record)

    return change.change(lambda unit: registry.vehicle(unit.registry.vehicle(code)), apply)

"""Work on the sensors of vehicles: exchanged, calibrated."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Response

from api.access.scopes import Scope, requires
from api.asking import AskedListDep, ChangeDep
from api.parameters import Code
from api.problems import described
from api.registry_changes import BodySource, RegistryRequest
from api.schemas import registry
from api.schemas.common import Page
from api.schemas.registry_changes import NewSensorChange, SensorChangeRecord
from api.services import writer_slot
from estimation.errors import ConflictError
from estimation.values.registry import SensorChange, SensorWork
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.registry_entry.contents import RegistryContents

router = APIRouter(prefix="/v1/vehicles", tags=["vehicles"])


@router.get("/{code}/sensor-changes", response_model=Page[SensorChangeRecord], responses=described(400, 404))
def list_sensor_changes(asked: AskedListDep, code: Code) -> Response:
    """List when sensors of the vehicle were exchanged or calibrated, oldest first."""
    with asked.read() as unit:
        unit.registry.vehicle(code)
        found = unit.sensor_changes.list(code)
    return asked.numbered({"vehicle": code}, found, lambda record: record.at_ns, SensorChangeRecord.made)


@router.post(
    "/{code}/sensor-changes",
    status_code=201,
    dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)],
    response_model=SensorChangeRecord,
    responses=described(404, 409, 412, 413, 415, 428),
)
def add_sensor_change(asked: ChangeDep, code: Code, body: NewSensorChange) -> Response:
    """Record that the sensors of an axle were exchanged or calibrated: alerts on the sensor before are closed.

    `If-Match` carries the ETag of the vehicle.
    """
    change = RegistryRequest(asked, body)
    record = SensorChange(code, body.axle, body.worked_at, SensorWork(body.work), body.removed, body.fitted, body.note)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> SensorChangeRecord:
        if unit.sensor_changes.stored(code, record.at_ns) is not None:
            reason = f"work on the sensors of vehicle {code!r} was recorded at the same time; give another time"
            raise ConflictError(reason, kind="vehicle", key=code)
        change.enter(unit, decision, RegistryContents(sensor_changes=(record,)), BodySource({"at": "worked_at"}))
        return SensorChangeRecord.made(record)

    return change.change(lambda unit: registry.vehicle(unit.registry.vehicle(code)), apply)

"""Visits of wheelsets to the lathe."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Response

from api.access.scopes import Scope, requires
from api.asking import AskedListDep, ChangeDep
from api.parameters import Serial
from api.problems import described
from api.registry_changes import BodySource, RegistryRequest
from api.schemas import registry
from api.schemas.common import Page
from api.schemas.registry_changes import NewReprofiling
from api.services import writer_slot
from estimation.errors import ConflictError
from estimation.values.registry import Reprofiling
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.registry_entry.contents import RegistryContents

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get("/{serial}/reprofilings", response_model=Page[registry.ReprofilingRecord], responses=described(400, 404))
def list_reprofilings(asked: AskedListDep, serial: Serial) -> Response:
    """List the wheelset's visits to the lathe, oldest first."""
    with asked.read() as unit:
        found = unit.registry.wheelset(serial).reprofilings
    return asked.numbered({"wheelset": serial}, found, lambda record: record.at_ns, registry.ReprofilingRecord.made)


@router.post(
    "/{serial}/reprofilings",
    status_code=201,
    dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)],
    response_model=registry.ReprofilingRecord,
    responses=described(404, 409, 412, 413, 415, 428),
)
def add_reprofiling(asked: ChangeDep, serial: Serial, body: NewReprofiling) -> Response:
    """Record a visit to the lathe; later windows belong to a new baseline, and the next evaluation closes old alerts.

    `If-Match` carries the ETag of the wheelset. A visit that contradicts what is on file is refused with the records
    that it contradicts: one in the future, before the first mounting, or with a mileage that runs backwards.
    """
    change = RegistryRequest(asked, body)
    record = Reprofiling(serial, body.reprofiled_at, body.mileage_km, body.note)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.ReprofilingRecord:
        if any(one.at_ns == record.at_ns for one in unit.registry.wheelset(serial).reprofilings):
            reason = "a reprofiling of this wheelset was recorded at the same time; void it to enter another"
            raise ConflictError(reason, kind="wheelset", key=serial)
        change.enter(unit, decision, RegistryContents(reprofilings=(record,)), BodySource({"at": "reprofiled_at"}))
        return registry.ReprofilingRecord.made(record)

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply)

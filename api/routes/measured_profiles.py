"""Profiles of wheelsets as gauges measured them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from fastapi import APIRouter, Depends, Response

from api.access.scopes import Scope, requires
from api.asking import AskedListDep, ChangeDep
from api.parameters import Serial
from api.problems import ProblemError, ProblemItem, described, pointer
from api.registry_changes import BodySource, RegistryRequest
from api.schemas import registry
from api.schemas.common import Page
from api.schemas.registry_changes import NewMeasuredProfiles, ProfileFile
from api.services import writer_slot
from estimation.contact.profiles import MeasuredProfiles, Profile
from estimation.errors import ConflictError, ProfileError
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.profiles.files import wheel_profile_of
from ingest.registry_entry.contents import RegistryContents

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get(
    "/{serial}/measured-profiles", response_model=Page[registry.MeasuredProfilesRecord], responses=described(400, 404)
)
def list_measured_profiles(asked: AskedListDep, serial: Serial) -> Response:
    """List when the profiles of the wheelset's wheels were measured, oldest first."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        found = unit.registry.measured_profiles(serial)
    return asked.numbered({"wheelset": serial}, found, lambda record: record.at_ns, registry.measured_profiles)


@router.post(
    "/{serial}/measured-profiles",
    status_code=201,
    dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)],
    response_model=registry.MeasuredProfilesRecord,
    responses=described(404, 409, 412, 413, 415, 428),
)
def add_measured_profiles(asked: ChangeDep, serial: Serial, body: NewMeasuredProfiles) -> Response:
    """Record the profiles of both wheels: the files of the gauge as text in JSON, both in one call.

    `If-Match` carries the ETag of the wheelset. Half a wheel, a rail, and what is no profile are refused.
    """
    change = RegistryRequest(asked, body)
    left, right = _wheel(body.left, "left"), _wheel(body.right, "right")
    record = MeasuredProfiles(serial, body.measured_at, body.mileage_km, left, right, 1e-3 * body.std_mm)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.MeasuredProfilesRecord:
        if any(one.at_ns == record.at_ns for one in unit.registry.measured_profiles(serial)):
            reason = "profiles of this wheelset were measured at the same time on file; void them to enter others"
            raise ConflictError(reason, kind="wheelset", key=serial)
        change.enter(unit, decision, RegistryContents(measured_profiles=(record,)), BodySource({"at": "measured_at"}))
        return registry.measured_profiles(record)

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply)


def _wheel(file: ProfileFile, side: Literal["left", "right"]) -> Profile:
    try:
        return wheel_profile_of(file.text, Path(file.file_name))
    except ProfileError as error:
        item = ProblemItem(part="body", pointer=pointer([side, "text"]), detail=str(error))
        raise ProblemError(422, "invalid-request", f"{side}: {error}", [item]) from error

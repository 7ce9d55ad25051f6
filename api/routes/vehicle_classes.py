"""Vehicle classes."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from api.asking import AskedDep, AskedListDep
from api.parameters import Code
from api.problems import described
from api.schemas import vehicle_classes
from api.schemas.common import Page
from estimation.errors import NotFoundError
from estimation.vehicle.vehicle_class import ClassOnFile
from ingest.vehicle_class_file import shipped_class, shipped_classes

router = APIRouter(prefix="/v1/vehicle-classes", tags=["vehicles"])
Version = Annotated[int | None, Query(ge=1, le=2**31 - 1, description="Left out, the latest.")]


@router.get("", response_model=Page[vehicle_classes.VehicleClassRepresentation], responses=described(400))
def list_vehicle_classes(asked: AskedListDep) -> Response:
    """List the newest version of each vehicle class, by code; those of the package too, unless registered again."""
    with asked.read() as unit:
        registered = {found.vehicle_class.code: found for found in unit.registry.vehicle_classes()}
    known = {code: ClassOnFile(shipped_class(code)) for code in shipped_classes()} | registered
    return asked.named(known.values(), lambda found: found.vehicle_class.code, vehicle_classes.vehicle_class)


@router.get("/{code}", response_model=vehicle_classes.VehicleClassRepresentation, responses=described(404))
def get_vehicle_class(asked: AskedDep, code: Code, version: Version = None) -> Response:
    """Return one vehicle class: each parameter with its standard deviation."""
    with asked.read() as unit:
        found = unit.registry.vehicle_class(code, version)
    if found is None:
        raise NotFoundError("vehicle class", code if version is None else f"{code} version {version}")
    return asked.answer(vehicle_classes.vehicle_class(found))

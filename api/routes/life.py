"""A wheelset over its life: its mileage intervals of all baselines, and the quality of its data over time."""

from __future__ import annotations

from fastapi import APIRouter, Response

from api.asking import AskedDep, AskedListDep
from api.parameters import Serial
from api.problems import described
from api.schemas import geometry
from api.schemas.common import Page
from api.window_reasons import WindowReasons
from fleet_db.stores.window_counts import window_counts

MOST_STRETCHES = 100
router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get("/{serial}/intervals", response_model=Page[geometry.Interval], responses=described(400, 404))
def list_intervals(asked: AskedListDep, serial: Serial) -> Response:
    """List what was estimated from each mileage interval of the wheelset, over all reprofilings, oldest first."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        found = [one for one in unit.geometries.intervals(serial) if one.geometry.windows]
    found.sort(key=lambda one: one.mileage_km)
    return asked.numbered({"wheelset": serial}, found, lambda one: one.from_ns, geometry.interval)


@router.get("/{serial}/data-quality", response_model=geometry.DataQuality, responses=described(404))
def get_data_quality(asked: AskedDep, serial: Serial) -> Response:
    """Return how many windows of the wheelset are accepted over time, and why the others are not."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        found = window_counts(unit.connection, serial, MOST_STRETCHES)
        waiting = WindowReasons(unit).waiting(wheelset=serial)
    return asked.answer(geometry.data_quality(serial, found, waiting))

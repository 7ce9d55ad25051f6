"""A wheelset over its life: its mileage intervals of all baselines, and the quality of its data over time."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from api import cursors
from api.answers import DEFAULT_LIMIT, Cursor, IfNoneMatch, Limit, answer, answer_page, operation
from api.parameters import Serial
from api.problems import described
from api.schemas import geometry
from api.schemas.common import Page
from api.services import ServicesDep
from api.window_reasons import WindowReasons
from fleet_db.stores.window_counts import window_counts

MOST_STRETCHES = 100
router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get("/{serial}/intervals", response_model=Page[geometry.Interval], responses=described(400, 404))
def list_intervals(
    request: Request, services: ServicesDep, serial: Serial, cursor: Cursor = None, limit: Limit = DEFAULT_LIMIT
) -> Response:
    """List what was estimated from each mileage interval of the wheelset, over all reprofilings, oldest first."""
    filters = {"wheelset": serial}
    after = cursors.decode_number(operation(request), filters, cursor)
    with services.storage.read() as unit:
        unit.registry.wheelset(serial)
        records = [one for one in unit.geometries.intervals(serial) if one.geometry.windows]
    found = sorted(records, key=lambda one: (one.from_ns, one.mileage_km))
    rows = [one for one in found if after is None or one.from_ns > after]
    return answer_page(request, filters, limit, rows[: limit + 1], lambda one: one.from_ns, geometry.interval)


@router.get("/{serial}/data-quality", response_model=geometry.DataQuality, responses=described(404))
def get_data_quality(request: Request, services: ServicesDep, serial: Serial, _held: IfNoneMatch = None) -> Response:
    """Return how many windows of the wheelset are accepted over time, and why the others are not."""
    with services.storage.read() as unit:
        unit.registry.wheelset(serial)
        found = window_counts(unit.connection, serial, MOST_STRETCHES)
        waiting = WindowReasons(unit).waiting(wheelset=serial)
    return answer(request, geometry.data_quality(serial, found, waiting))

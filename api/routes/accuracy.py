"""Estimates against measurements: of one wheelset, and over a fleet; and the contact geometry of its design."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Path, Query, Response

from api.accuracy.placed import placed_comparisons
from api.answers import answer_payload, table_payload
from api.asking import AskedDep
from api.contract import CSV, Accepted
from api.known import require_known
from api.parameters import FleetFilter, MeasuredFrom, MeasuredTo, Serial, require_order
from api.problems import described
from api.schemas import accuracy, wheel_contact
from api.services import Services
from api.times import Moment, to_rfc3339
from estimation.accuracy.fleet_accuracy import fleet_accuracy
from estimation.accuracy.wheel_contact import RailShare, WheelContact, WheelPair
from estimation.contact.profiles import wheel_profile
from estimation.errors import NotFoundError, ProfileError
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.measured_wheelsets import ComparisonReader
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.measured_profiles import newest_measurements

router = APIRouter(prefix="/v1", tags=["accuracy"])
_TABLE: dict[int | str, dict[str, Any]] = {200: {"content": {CSV: {"schema": {"type": "string"}}}}}
MeasuredAt = Annotated[Moment, Path(description="When the profiles were measured.", examples=["2026-01-31T12:00:00Z"])]
Newest = Annotated[int, Query(ge=1, le=500, description="How many measurements at most, the newest.")]


@router.get(
    "/wheelsets/{serial}/contact", response_model=wheel_contact.DesignContact, responses={**described(404), **_TABLE}
)
def get_design_contact(asked: AskedDep, accepted: Accepted, serial: Serial) -> Response:
    """Return rolling radii and conicity of the wheelset's design profile; as `text/csv`, the curve alone."""
    with asked.read() as unit:
        wheelset = unit.registry.wheelset(serial)
        rails = _reader(asked.services, unit).rails(serial, unit.geometries.current(serial))
        found = _design(asked.services, wheelset, rails)
    body = wheel_contact.design_contact(wheelset, found)
    return answer_payload(asked.request, table_payload(body, accepted, wheel_contact.table(body.contact)), accepted)


@router.get(
    "/wheelsets/{serial}/measured-profiles/{measured_at}/comparison",
    response_model=accuracy.ProfileComparison,
    responses=described(404),
)
def get_profile_comparison(asked: AskedDep, serial: Serial, measured_at: MeasuredAt) -> Response:
    """Return a measurement of both wheels beside the estimate that belongs to its date."""
    with asked.read() as unit:
        wheelset = unit.registry.wheelset(serial)
        wanted = [one for one in unit.registry.measured_profiles(serial) if one.at_ns == measured_at]
        found = _reader(asked.services, unit).of_wheelset(wheelset, wanted)
    if not found:
        raise NotFoundError("measured profiles", f"{serial} at {to_rfc3339(measured_at)}")
    return asked.answer(accuracy.profile_comparison(found[0]))


@router.get("/accuracy", response_model=accuracy.Accuracy, responses={**described(404), **_TABLE})
def get_accuracy(
    asked: AskedDep,
    accepted: Accepted,
    fleet: FleetFilter = None,
    measured_from: MeasuredFrom = None,
    measured_to: MeasuredTo = None,
    limit: Newest = 100,
) -> Response:
    """Return whether the intervals of the estimates cover what was measured; as `text/csv`, the measurements alone."""
    require_order(measured_from, measured_to)
    with asked.read() as unit:
        require_known(unit, fleet=fleet)
        on_file, keys = newest_measurements(unit.connection, fleet, measured_from, measured_to, limit)
        placed = placed_comparisons(unit, _reader(asked.services, unit), keys)
    query = f"?{urlencode(asked.request.query_params.multi_items())}" if asked.request.query_params else ""
    body = accuracy.accuracy(fleet_accuracy(placed.rows), placed, on_file, {"self": f"/v1/accuracy{query}"})
    return answer_payload(asked.request, table_payload(body, accepted, accuracy.table(body.measurements)), accepted)


def _reader(services: Services, unit: SqlUnitOfWork) -> ComparisonReader:
    return ComparisonReader(unit, services.contacts.contact, EstimationSettings().interval_km)


def _design(services: Services, wheelset: WheelsetRecord, rails: Sequence[RailShare]) -> WheelContact | Reason:
    try:
        design = wheel_profile(wheelset.wheel_profile)
    except ProfileError as error:
        return Reason(ReasonCode.CONTACT_IMPOSSIBLE, str(error))
    return services.contacts.contact(WheelPair(design, design, wheelset.nominal_radius_m), rails)

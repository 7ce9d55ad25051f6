"""The worklist: all wheelsets with how they are, in the order of what is asked; one query, whatever the order."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from functools import lru_cache
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field

from api import cursors
from api.answers import payload_of
from api.asking import CODE, AskedDep, AskedListDep, FleetFilter, Serial, VehicleFilter
from api.problems import described
from api.schemas import common
from api.schemas.alerts import AlertKind, KnownKind
from api.schemas.common import Derived, Page, Representation, Uncertain
from api.schemas.trend import DateForecast, DistanceForecast, date_forecast, distance_forecast
from api.services import require_known
from api.times import Timestamp, to_rfc3339
from estimation.values.alerts import AxlePosition, OpenAlert, Severity, Urgency, WorklistState
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from fleet_db.packed_values import from_document
from fleet_db.stores.worklist import WorklistFilter, WorklistOrder, WorklistPlace

WorklistSort = StrEnum(  # type: ignore[misc] # mypy wants the members written out; they are those of the order, twice
    "WorklistSort",
    {f"{name}{order.name}": f"{sign}{order}" for order in WorklistOrder for name, sign in (("", ""), ("DOWN_", "-"))},
)


class WorklistPosition(Derived, of=AxlePosition):
    """Where a wheelset is under its vehicle; nulls where the vehicle has no bogies or its class is not on file."""


class WorklistReason(Representation):
    """Why a wheelset is as urgent as it is."""

    code: ReasonCode
    text: str = Field(description="In words.", examples=["due in 12,400 km (p10 8,050 km)"])


class WorklistAlert(Derived, of=OpenAlert):
    """An open alert, in short."""

    kind: AlertKind


_OWN = ("distance_to_limit_km", "date_of_limit_ns", "forecast_reason", "mileage", "reasons")


class WheelsetState(
    Derived,
    of=WorklistState,
    without=_OWN,
    columns="status urgency urgency_rank reasons conicity_1 measured_until slope_1_per_1000_km limit_1"
    " probability_over_limit_1 distance_to_limit_km since_trend_km date_of_limit mileage_km mileage_at last_data_at"
    " alerts worst_severity",
):
    """How a wheelset is now: what is stored of it, kept current with every change."""

    status: Status
    conicity_1: Uncertain
    last_data_at: Timestamp | None
    urgency_rank: int = Field(description="1 is the most urgent class of `urgency`.", examples=[3])
    reasons: list[WorklistReason] = Field(description="Why it is so urgent, the most important reason first.")
    distance_to_limit_km: DistanceForecast = Field(
        description="Still to run from `mileage_km` on; 0 where the limit is reached."
    )
    date_of_limit: DateForecast
    mileage_km: float | None = Field(description="Since new, by the last reading that is believed.")
    mileage_at: Timestamp | None = Field(description="When it was read.")
    worst_severity: Severity | None = Field(description="Of the open alerts; null where none is open.")


class WheelsetRow(common.Wheelset):
    """A wheelset with where it runs and how it is."""

    vehicle: str | None = Field(description="That it runs under now; null where it is not mounted.", examples=["V-101"])
    vehicle_class: str | None = Field(description="Class of that vehicle.", examples=["coach"])
    axle: int | None = Field(description="Number of its axle there, from 1.", examples=[1])
    position: WorklistPosition | None = Field(
        description="Where it is under its vehicle; null where nothing is known of that."
    )
    state: WheelsetState


def row_of_document(document: str) -> WheelsetRow:
    """Return the representation of a stored row."""
    row = from_document(document)
    mounting, state = row.wheelset.mounting, row.state
    return WheelsetRow(
        **dict(common.wheelset(row.wheelset)),
        vehicle=None if mounting is None else mounting.vehicle,
        vehicle_class=row.vehicle_class,
        axle=None if mounting is None else mounting.axle,
        position=None if row.position is None else WorklistPosition.made(row.position),
        state=WheelsetState.made(
            state,
            urgency_rank=state.urgency.rank,
            reasons=[WorklistReason(code=reason.code, text=reason.text) for reason in state.reasons],
            distance_to_limit_km=distance_forecast(state.distance_to_limit_km, state.forecast_reason),
            date_of_limit=date_forecast(state.date_of_limit_ns, state.forecast_reason),
            mileage_km=None if state.mileage is None else state.mileage.mileage_km,
            mileage_at=None if state.mileage is None else to_rfc3339(state.mileage.at_ns),
            worst_severity=state.alerts[0].severity if state.alerts else None,
        ),
    )


REMEMBERED = 8192  # rows whose JSON text is kept, by their content: it never gets out of date

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])
ClassFilter = Annotated[str | None, Query(pattern=CODE, description="Only what runs under vehicles of this class now.")]
InStatus = Annotated[Status | None, Query(description="Only with a conicity of this status.")]
OfUrgency = Annotated[Urgency | None, Query(description="Only of this urgency.")]
AlertKindFilter = Annotated[KnownKind | None, Query(description="Only with an open alert of this kind.")]
SeverityFilter = Annotated[Severity | None, Query(description="Only where this is the worst severity of open alerts.")]
Sort = Annotated[
    WorklistSort,
    Query(
        description="What the list is ordered by, the smallest or most urgent first; `-` in front turns it round. What "
        "is not known comes last in both, ties are in the order of the serial."
    ),
]


@router.get("", response_model=Page[WheelsetRow], responses=described(400, 404))
def list_wheelsets(
    asked: AskedListDep,
    fleet: FleetFilter = None,
    vehicle: VehicleFilter = None,
    vehicle_class: ClassFilter = None,
    status: InStatus = None,
    urgency: OfUrgency = None,
    alert_kind: AlertKindFilter = None,
    alert_severity: SeverityFilter = None,
    sort: Sort = WorklistSort("serial"),  # noqa: B008 - a constant
) -> Response:
    """List the wheelsets with where they run, how they are and how urgent that is; by serial, or by `sort`."""
    chosen = WorklistFilter(fleet, vehicle, vehicle_class, status, urgency, alert_kind, alert_severity)
    filters = asdict(chosen) | {"sort": sort}
    after = _place(asked.after(filters))
    order = WorklistOrder(sort.value.removeprefix("-"))
    with asked.read() as unit:
        rows = unit.worklist.page(chosen, order, after, asked.limit + 1, descending=sort.value.startswith("-"))
        if not rows:
            require_known(unit, fleet=fleet, vehicle=vehicle, vehicle_class=vehicle_class)
    return asked.payloads(
        filters,
        rows,
        lambda entry: [entry.place.key, entry.place.serial],
        lambda entry: _payload(entry.document),
        lambda entry: row_of_document(entry.document),
    )


@router.get("/{serial}/state", response_model=WheelsetRow, responses=described(404))
def get_wheelset_state(asked: AskedDep, serial: Serial) -> Response:
    """Return one wheelset as the list has it: where it runs, how it is, and how urgent that is."""
    return asked.one(lambda unit: row_of_document(unit.worklist.row(serial)))


@lru_cache(REMEMBERED)
def _payload(document: str) -> bytes:
    return payload_of(row_of_document(document))


def _place(key: object) -> WorklistPlace | None:
    if key is None:
        return None
    match key:
        case [None | int() | float() as number, str() as serial] if (
            number is None or cursors.is_number(number)
        ) and "\0" not in serial:
            return WorklistPlace(number, serial)
    raise cursors.refused()


@router.get("/{serial}", response_model=common.Wheelset, responses=described(404))
def get_wheelset(asked: AskedDep, serial: Serial) -> Response:
    """Return one wheelset, with links to its bin table, its trend and its alerts."""
    return asked.one(lambda unit: common.wheelset(unit.registry.wheelset(serial)))

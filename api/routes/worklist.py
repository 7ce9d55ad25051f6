"""The worklist: all wheelsets with how they are, in the order of what is asked; and the plan which to turn together."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from functools import lru_cache
from typing import Annotated
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from api import cursors
from api.answers import answer, payload_of
from api.asking import CODE, AskedDep, AskedListDep, FleetFilter, Serial, VehicleFilter
from api.problems import described
from api.schemas import common
from api.schemas.alerts import AlertKind, KnownKind
from api.schemas.common import Derived, Links, Page, Representation, Uncertain, finite
from api.schemas.trend import DateForecast, DistanceForecast, date_forecast, distance_forecast
from api.services import ServicesDep, require_known
from api.times import Timestamp, to_rfc3339
from estimation.trend.now import SCALE
from estimation.values.alerts import OVER, AxlePosition, OpenAlert, Severity, Urgency, WorklistRow, WorklistState
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import DAY_NS, IN_MM, MILLIMETRE
from estimation.worklist.turning_plan import Candidate, Cause, DiameterLimits, PlanLine, Radii, turning_plan
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


class TurningPlanLine(Representation):
    """One wheelset of the plan."""

    vehicle: str = Field(examples=["V-101"])
    visit: int | None = Field(
        description="Number of the vehicle's visit to the lathe in this plan; null where it is not assessed.",
        examples=[1],
    )
    turn_by: Timestamp | None = Field(description="Date of the visit: when the first of its wheelsets is due (p10).")
    axle: int
    bogie: int | None = Field(description="Number of the bogie; null where that is not known.", examples=[1])
    wheelset: str = Field(examples=["WS-0001"])
    cause: Cause = Field(
        description="`due` itself; `together` with another, for the diameters; `replace`, since turning would leave "
        "too small a wheel; `not_assessed`, since nothing is known of it."
    )
    reason: str = Field(description="In words.", examples=["due in 12,400 km (p10 8,050 km)"])
    urgency: Urgency
    distance_to_limit_km: DistanceForecast
    date_of_limit: DateForecast
    radius_mm: float | None = Field(description="Radius before, of the smaller wheel; null where none is used.")
    radius_after_mm: float | None = Field(description="Radius after the visit; null where it is not known.")
    not_checked: list[str] = Field(description="Which limits could not be held against it, and why.")


class TurningLimits(Derived, of=DiameterLimits):
    """The limits that the plan was made with; null was not checked."""


class TurningPlan(Representation):
    """Visits to the lathe, the earliest first; wheelsets of which nothing is known come last."""

    made_at: Timestamp = Field(description="Our time that the plan counts from.")
    horizon_days: float = Field(description="How far ahead was planned.")
    together_days: float = Field(description="What becomes due so soon after a visit is turned in it.")
    limits: TurningLimits = Field(description="The limits of the operator.")
    items: list[TurningPlanLine]
    links: Links


def candidate(row: WorklistRow, *, nominal_radii: bool) -> Candidate | None:
    """Return a wheelset as the plan needs it; None where it is not mounted."""
    mounting, state = row.wheelset.mounting, row.state
    if mounting is None:
        return None
    due = state.date_of_limit_ns.p10
    return Candidate(
        serial=row.wheelset.serial,
        vehicle=mounting.vehicle,
        axle=mounting.axle,
        bogie=None if row.position is None else row.position.bogie,
        over_limit=state.urgency in OVER,
        due_ns=None if due is None else round(due),
        reason="; ".join(reason.text for reason in state.reasons),
        unknown=_unknown(state),
        radii=Radii(row.wheelset.nominal_radius_m) if nominal_radii else None,
    )


def _unknown(state: WorklistState) -> Reason | None:
    missing = state.forecast_reason
    if missing is not None and missing.code is not ReasonCode.BEYOND_HORIZON and not SCALE.far_below(state):
        return missing
    if state.urgency is Urgency.DUE and state.date_of_limit_ns.p10 is None:
        return Reason(ReasonCode.SINGLE_DATE, f"no date is known: {state.reasons[0].text}")
    return state.reasons[0] if state.urgency is Urgency.UNKNOWN else None


def _turning_plan_line(line: PlanLine, row: WorklistRow) -> TurningPlanLine:
    wheelset, state = line.candidate, row.state
    return TurningPlanLine(
        vehicle=wheelset.vehicle,
        visit=line.visit,
        turn_by=None if line.turn_by_ns is None else to_rfc3339(line.turn_by_ns),
        axle=wheelset.axle,
        bogie=wheelset.bogie,
        wheelset=wheelset.serial,
        cause=line.cause,
        reason=line.reason,
        urgency=state.urgency,
        distance_to_limit_km=distance_forecast(state.distance_to_limit_km, state.forecast_reason),
        date_of_limit=date_forecast(state.date_of_limit_ns, state.forecast_reason),
        radius_mm=None if wheelset.radii is None else finite(min(wheelset.radii.wheels), IN_MM),
        radius_after_mm=finite(line.radius_after, IN_MM),
        not_checked=list(line.not_checked),
    )


plans_router = APIRouter(prefix="/v1/plans", tags=["plans"])
Horizon = Annotated[float, Query(ge=0.0, le=3650.0, description="How far ahead is planned.")]
Together = Annotated[
    float, Query(ge=0.0, le=3650.0, description="What becomes due so soon after a visit is turned in it.")
]
NominalRadii = Annotated[
    bool, Query(description="Take the radius on file for that of both wheels; else diameters are not checked.")
]
Cut = Annotated[float | None, Query(ge=0.0, le=100.0, description="Radius that a turning takes off at least.")]
LeastRadius = Annotated[float | None, Query(gt=0.0, le=1000.0, description="Least radius of a wheel.")]
Difference = Annotated[
    float | None,
    Query(
        ge=0.0,
        le=1000.0,
        description="Greatest difference of diameters; of the maintenance plan, where EN 15313 leaves it. Not checked "
        "unless given.",
    ),
]


@plans_router.get("/reprofiling", response_model=TurningPlan, responses=described(404))
def plan_reprofiling(
    request: Request,
    services: ServicesDep,
    fleet: FleetFilter = None,
    vehicle: VehicleFilter = None,
    horizon_days: Horizon = 90.0,
    together_days: Together = 30.0,
    nominal_radii: NominalRadii = False,  # noqa: FBT002 - a query parameter
    cut_mm: Cut = None,
    minimum_radius_mm: LeastRadius = None,
    axle_difference_mm: Difference = None,
    bogie_difference_mm: Difference = None,
    vehicle_difference_mm: Difference = None,
) -> Response:
    """Plan which wheelsets of each vehicle to turn together, by date, each with its reason; nothing is stored."""
    with services.storage.read() as unit:
        documents = unit.worklist.documents(WorklistFilter(fleet=fleet, vehicle=vehicle))
        if not documents:
            require_known(unit, fleet=fleet, vehicle=vehicle)
    given = (cut_mm, minimum_radius_mm, axle_difference_mm, bogie_difference_mm, vehicle_difference_mm)
    limits = DiameterLimits(*(None if value is None else value * MILLIMETRE for value in given))
    rows = {row.wheelset.serial: row for row in map(from_document, documents)}
    candidates = [candidate(row, nominal_radii=nominal_radii) for row in rows.values()]
    now_ns = services.clock.now_ns()
    lines = turning_plan(
        [wheelset for wheelset in candidates if wheelset is not None],
        limits,
        now_ns,
        round(horizon_days * DAY_NS),
        round(together_days * DAY_NS),
    )
    named = {"fleet": fleet, "vehicle": vehicle, "sort": "urgency"}
    chosen = {name: value for name, value in named.items() if value is not None}
    body = TurningPlan(
        made_at=to_rfc3339(now_ns),
        horizon_days=horizon_days,
        together_days=together_days,
        limits=TurningLimits.made(limits),
        items=[_turning_plan_line(line, rows[line.candidate.serial]) for line in lines],
        links={"wheelsets": f"/v1/wheelsets?{urlencode(chosen, quote_via=quote)}"},
    )
    return answer(request, body)

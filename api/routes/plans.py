"""Plans: which wheelsets to turn together, by date."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from api.answers import answer
from api.asking import FleetFilter, VehicleFilter
from api.problems import described
from api.schemas.common import Derived, Links, Representation, finite
from api.schemas.trend import DateForecast, DistanceForecast, date_forecast, distance_forecast
from api.services import ServicesDep, require_known
from api.times import Timestamp, to_rfc3339
from estimation.trend.now import SCALE
from estimation.values.alerts import OVER, Urgency, WorklistRow, WorklistState
from estimation.values.reasons import Reason, ReasonCode
from estimation.worklist.turning_plan import Candidate, Cause, DiameterLimits, PlanLine, Radii, turning_plan
from fleet_db.packed_values import from_document
from fleet_db.stores.worklist import WorklistFilter

_TO_MM = 1e3


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
        radius_mm=None if wheelset.radii is None else finite(min(wheelset.radii.wheels), _TO_MM),
        radius_after_mm=finite(line.radius_after, _TO_MM),
        not_checked=list(line.not_checked),
    )


router = APIRouter(prefix="/v1/plans", tags=["plans"])
DAY_NS = 86_400_000_000_000
_MM = 1e-3
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


@router.get("/reprofiling", response_model=TurningPlan, responses=described(404))
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
    limits = DiameterLimits(*(None if value is None else value * _MM for value in given))
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

"""Rows of the worklist: a wheelset, where it runs, how it is, and how urgent that is."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field

from api.schemas import registry
from api.schemas.alerts import AlertKind
from api.schemas.common import Links, Representation, Uncertain, finite
from api.schemas.derived import Derived
from api.schemas.registry import segment
from api.schemas.trend import DateForecast, DistanceForecast, date_forecast, distance_forecast
from api.times import Timestamp, to_rfc3339
from estimation.values.alerts import AxlePosition, OpenAlert, Severity, Urgency, WorklistRow, WorklistState
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.worklist.turning_plan import Candidate, Cause, DiameterLimits, PlanLine, Radii
from fleet_db.stores.worklist import WorklistOrder
from fleet_db.worklist_documents import from_document

WorklistSort = StrEnum(  # type: ignore[misc] # mypy wants the members written out; they are those of the order, twice
    "WorklistSort",
    {f"{name}{order.name}": f"{sign}{order}" for order in WorklistOrder for name, sign in (("", ""), ("DOWN_", "-"))},
)


class WorklistPosition(Derived, of=AxlePosition):
    """Where a wheelset is under its vehicle; nulls where the vehicle has no bogies or its class is not on file."""


class WorklistReason(Representation):
    """Why a wheelset is as urgent as it is."""

    code: ReasonCode
    text: str = Field(description="In words.", examples=["due in 12,400 km (p10 8,000 km)"])


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
        description="Still to run from `mileage_km`: the trend's own distance less `since_trend_km`."
    )
    date_of_limit: DateForecast
    mileage_km: float | None = Field(description="Since new, by the last reading that is believed.")
    mileage_at: Timestamp | None = Field(description="When it was read.")
    worst_severity: Severity | None = Field(description="Of the open alerts; null where none is open.")


class WheelsetRow(registry.Wheelset):
    """A wheelset with where it runs and how it is."""

    vehicle: str | None = Field(description="That it runs under now; null where it is not mounted.", examples=["V-101"])
    vehicle_class: str | None = Field(description="Class of that vehicle.", examples=["coach"])
    axle: int | None = Field(description="Number of its axle there, from 1.", examples=[1])
    position: WorklistPosition | None
    state: WheelsetState


def wheelset_row(row: WorklistRow) -> WheelsetRow:
    """Return the representation of a row of the worklist."""
    mounting = row.wheelset.mounting
    return WheelsetRow(
        **dict(registry.wheelset(row.wheelset)),
        vehicle=None if mounting is None else mounting.vehicle,
        vehicle_class=row.vehicle_class,
        axle=None if mounting is None else mounting.axle,
        position=None if row.position is None else WorklistPosition.made(row.position),
        state=_state(row.state),
    )


def row_of_document(document: str) -> WheelsetRow:
    """Return the representation of a stored row."""
    return wheelset_row(from_document(document))


def _state(state: WorklistState) -> WheelsetState:
    return WheelsetState.made(
        state,
        urgency_rank=state.urgency.rank,
        reasons=[WorklistReason(code=reason.code, text=reason.text) for reason in state.reasons],
        distance_to_limit_km=distance_forecast(state.distance_to_limit_km, state.forecast_reason),
        date_of_limit=date_forecast(state.date_of_limit_ns, state.forecast_reason),
        mileage_km=None if state.mileage is None else state.mileage.mileage_km,
        mileage_at=None if state.mileage is None else to_rfc3339(state.mileage.at_ns),
        worst_severity=state.alerts[0].severity if state.alerts else None,
    )


_MM = 1e3


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
    reason: str = Field(description="In words.", examples=["due in 12,400 km (p10 8,000 km)"])
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
    horizon_days: float
    together_days: float
    limits: TurningLimits
    items: list[TurningPlanLine]
    links: Links


def candidate(row: WorklistRow, *, nominal_radii: bool) -> Candidate | None:
    """Return a wheelset as the plan needs it; None where it is not mounted.

    Args:
        nominal_radii: Whether the radius on file is taken for that of both wheels.
    """
    mounting, state = row.wheelset.mounting, row.state
    if mounting is None:
        return None
    due = state.date_of_limit_ns.p10
    return Candidate(
        serial=row.wheelset.serial,
        vehicle=mounting.vehicle,
        axle=mounting.axle,
        bogie=None if row.position is None else row.position.bogie,
        over_limit=state.urgency is Urgency.OVER_LIMIT,
        due_ns=None if due is None else round(due),
        reason="; ".join(reason.text for reason in state.reasons),
        unknown=_unknown(state),
        radii=Radii(row.wheelset.nominal_radius_m) if nominal_radii else None,
    )


def _unknown(state: WorklistState) -> Reason | None:
    """Return why nothing can be said of a wheelset's limit; None where something can."""
    missing = state.forecast_reason
    if missing is not None and missing.code is not ReasonCode.BEYOND_HORIZON:
        return missing
    if state.urgency is Urgency.DUE and state.date_of_limit_ns.p10 is None:
        return Reason(ReasonCode.SINGLE_DATE, f"no date is known: {state.reasons[0].text}")
    return state.reasons[0] if state.urgency is Urgency.UNKNOWN else None


def turning_plan_line(line: PlanLine, row: WorklistRow) -> TurningPlanLine:
    """Return the representation of a line of the plan, with the forecast of its wheelset."""
    one, state = line.candidate, row.state
    return TurningPlanLine(
        vehicle=one.vehicle,
        visit=line.visit,
        turn_by=None if line.turn_by_ns is None else to_rfc3339(line.turn_by_ns),
        axle=one.axle,
        bogie=one.bogie,
        wheelset=one.serial,
        cause=line.cause,
        reason=line.reason,
        urgency=state.urgency,
        distance_to_limit_km=distance_forecast(state.distance_to_limit_km, state.forecast_reason),
        date_of_limit=date_forecast(state.date_of_limit_ns, state.forecast_reason),
        radius_mm=None if one.radii is None else finite(min(one.radii.wheels), _MM),
        radius_after_mm=finite(line.radius_after, _MM),
        not_checked=list(line.not_checked),
    )


def plan_links(fleet: str | None, vehicle: str | None) -> dict[str, str]:
    """Return the paths of what the plan was made from."""
    chosen = [
        f"{name}={segment(value)}" for name, value in (("fleet", fleet), ("vehicle", vehicle)) if value is not None
    ]
    return {"wheelsets": "?".join(["/v1/wheelsets", "&".join([*chosen, "sort=urgency"])])}

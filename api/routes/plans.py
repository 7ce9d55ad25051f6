"""Plans: which wheelsets to turn together, by date."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from api.answers import answer
from api.known import require_known
from api.parameters import FleetFilter, VehicleFilter
from api.problems import described
from api.schemas import worklist
from api.services import ServicesDep
from api.times import to_rfc3339
from estimation.worklist.turning_plan import DiameterLimits, turning_plan
from fleet_db.stores.worklist import WorklistFilter
from fleet_db.worklist_documents import from_document

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


@router.get("/reprofiling", response_model=worklist.TurningPlan, responses=described(404))
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
    candidates = [worklist.candidate(row, nominal_radii=nominal_radii) for row in rows.values()]
    now_ns = services.clock.now_ns()
    lines = turning_plan(
        [one for one in candidates if one is not None],
        limits,
        now_ns,
        round(horizon_days * DAY_NS),
        round(together_days * DAY_NS),
    )
    body = worklist.TurningPlan(
        made_at=to_rfc3339(now_ns),
        horizon_days=horizon_days,
        together_days=together_days,
        limits=worklist.TurningLimits.made(limits),
        items=[worklist.turning_plan_line(line, rows[line.candidate.serial]) for line in lines],
        links=worklist.plan_links(fleet, vehicle),
    )
    return answer(request, body)

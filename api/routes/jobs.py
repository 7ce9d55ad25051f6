"""Jobs, their runs, running one now, and what failed in them and is kept apart."""

from __future__ import annotations

from dataclasses import replace
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from pydantic import Field

from api import cursors
from api.access.gate import CallerDep, Scope, requires
from api.access.key_ring import Caller
from api.asking import CODE, AskedDep, AskedListDep, Code, NewDep, Number, OfCode
from api.problems import described
from api.schemas.common import Derived, Links, Page, Representation, segment, without_folders
from api.services import Services, require_known, writer_slot
from api.times import Timestamp, to_rfc3339
from estimation.values.runs import JobRun as JobRunValue
from estimation.values.runs import Quarantined, QuarantineState, SubjectKind
from fleet_db.stores.stage_marks import Place


class JobRun(
    Derived, of=JobRunValue, columns="id job trigger started_at finished_at duration_s outcome counts error links"
):
    """One run of one job and what it did; `finished_at` is null while it runs."""

    duration_s: float | None = Field(description="How long it took; null while it runs.")
    links: Links


class Job(Representation):
    """A scheduled job with its last run; `next_due_at` is when the schedule is due; it needs a running scheduler."""

    name: str = Field(examples=["estimate_windows"])
    description: str = Field(description="What it does.")
    every_s: float = Field(description="Interval of its schedule.")
    last_run: JobRun | None = Field(description="Its last run; null where it has never run.")
    next_due_at: Timestamp | None = Field(description="Null before the first run.")
    links: Links


_RESOURCES = {
    SubjectKind.WHEELSET: "wheelsets",
    SubjectKind.SECTION: "track-sections",
    SubjectKind.VEHICLE: "vehicles",
    SubjectKind.FLEET: "fleets",
}


class QuarantinedItem(
    Derived,
    of=Quarantined,
    without=("error", "inputs", "due_ns"),
    columns="kind key stage state reason_code reason attempts first_failed_at last_failed_at next_attempt_at links",
):
    """One thing at which one stage of the work failed, and when it is tried again; kept when it succeeds later."""

    reason: str = Field(description="First line of the error.")
    next_attempt_at: Timestamp | None = Field(description="Null once it has succeeded.")
    links: Links


def _quarantined(item: Quarantined) -> QuarantinedItem:
    resource = _RESOURCES.get(item.kind)
    return QuarantinedItem.made(
        item,
        reason=without_folders(item.error),
        next_attempt_at=to_rfc3339(item.due_ns) if item.state is QuarantineState.HELD else None,
        links={} if resource is None else {item.kind.value: f"/v1/{resource}/{segment(item.key)}"},
    )


router = APIRouter(prefix="/v1", tags=["jobs"])
FOR_ALL_FLEETS = "the message is shown to keys of all fleets"


def _run(record: JobRunValue, caller: Caller) -> JobRun:
    """Return a run; without its counts and its message, which are of all fleets, for a caller who is bound to some."""
    if caller.fleets is not None:
        record = replace(record, counts={}, error=None if record.error is None else FOR_ALL_FLEETS)
    finished = record.finished_ns
    return JobRun.made(
        record,
        duration_s=None if finished is None else max(0, finished - record.started_ns) / 1e9,
        links={"self": f"/v1/job-runs/{record.run_id}", "job_runs": f"/v1/jobs/{segment(record.job)}/runs"},
    )


def _job(services: Services, caller: Caller, name: str) -> Job:
    job, path = services.job(name), f"/v1/jobs/{segment(name)}"
    with services.storage.read() as unit:
        last = next(iter(unit.jobs.page(name, None, 1)), None)
    return Job(
        name=job.name,
        description=job.description,
        every_s=job.every_s,
        last_run=None if last is None else _run(last, caller),
        next_due_at=None if last is None else to_rfc3339(last.started_ns + int(job.every_s * 1e9)),
        links={"self": path, "runs": f"{path}/runs"},
    )


@router.get("/jobs", response_model=Page[Job], responses=described(400))
def list_jobs(asked: AskedListDep, caller: CallerDep) -> Response:
    """List the jobs with their last runs, in the order of their names."""
    return asked.named(asked.services.jobs, lambda name: name, lambda name: _job(asked.services, caller, name))


@router.get("/jobs/{name}", response_model=Job, responses=described(404))
def get_job(asked: AskedDep, caller: CallerDep, name: Code) -> Response:
    """Return one job with its last run."""
    return asked.answer(_job(asked.services, caller, name))


@router.get("/jobs/{name}/runs", response_model=Page[JobRun], responses=described(400, 404))
def list_job_runs(asked: AskedListDep, caller: CallerDep, name: Code) -> Response:
    """List the runs of a job, newest first."""
    filters = {"job": asked.services.job(name).name}
    before = asked.after_number(filters)
    with asked.read() as unit:
        rows = unit.jobs.page(name, before, asked.limit + 1)
    return asked.page(filters, rows, lambda record: record.run_id, lambda record: _run(record, caller))


@router.post(
    "/jobs/{name}/runs",
    status_code=HTTPStatus.ACCEPTED,
    response_model=JobRun,
    responses=described(404, 409, 415),
    dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)],
)
def run_job_now(asked: NewDep, name: Code) -> Response:
    """Run a job now, in the background; `Location` is where its run can be watched."""
    job, runner = asked.services.job(name), asked.services.runner
    return asked.beside(None, lambda: _run(runner.start(job), asked.caller), HTTPStatus.ACCEPTED)


@router.get("/job-runs/{run_id}", response_model=JobRun, responses=described(404))
def get_job_run(asked: AskedDep, caller: CallerDep, run_id: Number) -> Response:
    """Return one run of a job."""
    return asked.one(lambda unit: _run(unit.jobs.get(run_id), caller))


quarantine_router = APIRouter(prefix="/v1/quarantine", tags=["quarantine"])
Kind = Annotated[SubjectKind | None, Query(description="Only of this kind.")]
InState = Annotated[QuarantineState | None, Query(description="Only in this state; `held` is what waits.")]
OfVehicle = Annotated[
    str | None, Query(pattern=CODE, description="Only recordings and windows of this vehicle, and the vehicle itself.")
]


@quarantine_router.get("", response_model=Page[QuarantinedItem], responses=described(400, 404))
def list_quarantine(
    asked: AskedListDep, kind: Kind = None, state: InState = None, reason_code: OfCode = None, vehicle: OfVehicle = None
) -> Response:
    """List what failed by itself, by kind, key and stage; held, and resolved by a later success."""
    filters = {"kind": kind, "state": state, "reason_code": reason_code, "vehicle": vehicle}
    after = _place(asked.after_text(filters))
    with asked.read() as unit:
        rows = unit.quarantine.page(
            kind=kind, state=state, code=reason_code, vehicle=vehicle, after=after, limit=asked.limit + 1
        )
        if not rows:
            require_known(unit, vehicle=vehicle)
    return asked.page(filters, rows, lambda item: f"{item.kind}/{item.stage}/{item.key}", _quarantined)


def _place(key: str | None) -> Place | None:
    if key is None:
        return None
    match key.split("/", 2):
        case [kind, stage, subject]:
            return kind, subject, stage
    raise cursors.refused()

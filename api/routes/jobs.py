"""Jobs, their runs, and running one now."""

from __future__ import annotations

from dataclasses import replace
from http import HTTPStatus

from fastapi import APIRouter, Depends, Request, Response

from api.access.caller import Caller, CallerDep
from api.access.scopes import Scope, requires
from api.answers import IdempotencyKey, answer
from api.asking import AskedDep, AskedListDep
from api.idempotency import idempotent_post
from api.parameters import Code, Number
from api.problems import described
from api.schemas import jobs
from api.schemas.common import Page
from api.services import Services, ServicesDep, writer_slot
from estimation.values.runs import JobRun

router = APIRouter(prefix="/v1", tags=["jobs"])


FOR_ALL_FLEETS = "the message is shown to keys of all fleets"


def _seen(run: JobRun, caller: Caller) -> JobRun:
    """Return a run; without its counts and its message, which are of all fleets, for a caller who is bound to some."""
    if caller.fleets is None:
        return run
    return replace(run, counts={}, error=None if run.error is None else FOR_ALL_FLEETS)


def _job(services: Services, caller: Caller, name: str) -> jobs.Job:
    found = services.job(name)
    with services.storage.read() as unit:
        last = next(iter(unit.jobs.page(name, None, 1)), None)
    return jobs.job(found.name, found.description, found.every_s, None if last is None else _seen(last, caller))


@router.get("/jobs", response_model=Page[jobs.Job], responses=described(400))
def list_jobs(asked: AskedListDep, caller: CallerDep) -> Response:
    """List the jobs with their last runs, in the order of their names."""
    return asked.named(asked.services.jobs, lambda name: name, lambda name: _job(asked.services, caller, name))


@router.get("/jobs/{name}", response_model=jobs.Job, responses=described(404))
def get_job(asked: AskedDep, caller: CallerDep, name: Code) -> Response:
    """Return one job with its last run."""
    return asked.answer(_job(asked.services, caller, name))


@router.get("/jobs/{name}/runs", response_model=Page[jobs.JobRun], responses=described(400, 404))
def list_job_runs(asked: AskedListDep, caller: CallerDep, name: Code) -> Response:
    """List the runs of a job, newest first."""
    filters = {"job": asked.services.job(name).name}
    before = asked.after_number(filters)
    with asked.read() as unit:
        rows = unit.jobs.page(name, before, asked.limit + 1)
    return asked.page(filters, rows, lambda record: record.run_id, lambda record: jobs.run(_seen(record, caller)))


@router.post(
    "/jobs/{name}/runs",
    status_code=HTTPStatus.ACCEPTED,
    response_model=jobs.JobRun,
    responses=described(404, 409, 415),
    dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)],
)
def run_job_now(
    request: Request, services: ServicesDep, caller: CallerDep, name: Code, idempotency_key: IdempotencyKey = None
) -> Response:
    """Run a job now, in the background; `Location` is where its run can be watched."""
    job = services.job(name)
    post = idempotent_post(request, idempotency_key)
    with services.storage.read() as unit:
        earlier = post.earlier(request, unit)
    if earlier is not None:
        return earlier
    body = jobs.run(_seen(services.runner.start(job), caller))
    with services.storage.write() as unit:
        post.remember(unit, HTTPStatus.ACCEPTED, body, services.clock.now_ns())
    return answer(request, body, status=HTTPStatus.ACCEPTED, headers={"Location": body.links["self"]})


@router.get("/job-runs/{run_id}", response_model=jobs.JobRun, responses=described(404))
def get_job_run(asked: AskedDep, caller: CallerDep, run_id: Number) -> Response:
    """Return one run of a job."""
    with asked.read() as unit:
        found = unit.jobs.get(run_id)
    return asked.answer(jobs.run(_seen(found, caller)))

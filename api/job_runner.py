"""Jobs that are run now, in the background of the process that was asked."""

from __future__ import annotations

import threading
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace

from estimation.errors import ConflictError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.runs import JobOutcome, JobRun, JobTrigger
from fleet_db.session import BUSY_TIMEOUT_MS
from fleet_db.storage import SqlStorage


class JobRunner:
    """Runs one job at a time, in a thread of its own; built by the factory, closed with the app."""

    def __init__(self, context: JobContext, storage: SqlStorage, holder: str) -> None:
        self._holder = holder
        self._stopping = threading.Event()
        self._storage = storage
        self._context = replace(context, stopping=self._stopping.is_set)
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="job")
        self._starting = threading.Lock()
        self._running: Future[JobRun] | None = None

    def start(self, job: Job) -> JobRun:
        """Start a run and return its record as soon as it is committed; refused while it, or another one here, runs."""
        with self._starting:
            self._refuse_second(job)
            begun: Future[JobRun] = Future()
            self._running = self._executor.submit(self._run, job, begun)
            wait([begun, self._running], return_when=FIRST_COMPLETED)
            return begun.result() if begun.done() else self._running.result()

    def _run(self, job: Job, begun: Future[JobRun]) -> JobRun:
        with self._storage.owned(JobTrigger.API, self._holder, self._context.lease_s) as owned:
            patient = replace(owned, patience_s=BUSY_TIMEOUT_MS / 1000)  # requests do not wait for the job
            return run_job(job, replace(self._context, storage=patient), JobTrigger.API, started=begun.set_result)

    def _refuse_second(self, job: Job) -> None:
        if self._running is not None and not self._running.done():
            raise ConflictError("a job that was started here is still running", kind="job", key=job.name)
        with self._storage.read() as unit:
            latest = unit.jobs.page(job.name, None, 1)
        for run in latest:
            if run.outcome is JobOutcome.RUNNING:
                raise ConflictError(
                    f"job {job.name} is running (run {run.run_id})", kind="job-run", key=str(run.run_id)
                )

    def close(self) -> None:
        """Ask the running job to stop at its next checkpoint and wait for it."""
        self._stopping.set()
        self._executor.shutdown(wait=True, cancel_futures=True)

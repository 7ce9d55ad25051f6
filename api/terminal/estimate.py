"""The scheduled jobs, once, now, in order, under a progress bar."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace

import typer
from rich.console import Console
from rich.progress import TaskID
from rich.table import Table

from api import logs
from api.factory import job_context, open_store, process_name, scheduled_jobs
from api.progress import bar
from api.settings import Settings
from api.terminal.reasons import fleet_reasons, summary_lines
from api.tracing import start_tracing
from api.workers.choice import executor_of
from estimation.errors import ParameterError
from estimation.jobs.estimate_windows import REFUSED, refusals
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.stop_signals import stop_on_signals
from estimation.values.runs import JobOutcome, JobRun, JobTrigger


def run_jobs_once(name: str | None, settings: Settings) -> bool:
    """Run every job, or one, print what the runs did, and return whether all succeeded."""
    logs.configure(settings)
    start_tracing()
    jobs = _chosen(settings, name)
    console = Console(stderr=True)
    stopping = threading.Event()
    stop_on_signals(stopping)
    with closing(open_store(settings)) as storage, executor_of(settings) as executor:
        context = replace(job_context(settings, storage), stopping=stopping.is_set, executor=executor)
        with storage.owned(JobTrigger.CLI, process_name(), context.lease_s) as owned:
            runs = run_in_order(jobs, replace(context, storage=owned), console)
        Console().print(summary(runs))
        for unfit in executor.unfit if executor is not None else ():
            typer.echo(f"left out: {unfit}")
        with storage.read() as unit:
            without = summary_lines(fleet_reasons(unit))
    for line in without:
        typer.echo(line)
    return all(run.outcome is JobOutcome.SUCCEEDED for run in runs)


def _chosen(settings: Settings, name: str | None) -> Sequence[Job]:
    jobs = scheduled_jobs(settings)
    chosen = [job for job in jobs if name in {None, job.name}]
    if not chosen:
        known = ", ".join(job.name for job in jobs)
        raise ParameterError(f"no job {name!r}; there are {known}", field="--job")
    return chosen


def run_in_order(
    jobs: Sequence[Job], context: JobContext, console: Console, trigger: JobTrigger = JobTrigger.CLI
) -> list[JobRun]:
    """Run the jobs one after the other, with a line of progress each; return their records.

    Args:
        jobs: In the order in which they run.
        context: What the jobs may touch.
    """
    runs = []
    with bar(console) as progress:
        for job in jobs:
            task = progress.add_task(job.description, total=None)

            def show(done: int, total: int, task: TaskID = task) -> None:
                progress.update(task, completed=done, total=total)

            run = run_job(job, replace(context, progress=show), trigger)
            runs.append(run)
            progress.update(task, total=1, completed=1)
            if run.outcome is JobOutcome.ABANDONED:
                break
    return runs


def summary(runs: Sequence[JobRun]) -> Table:
    """Return what the jobs did, as a table."""
    table = Table("job", "outcome", "seconds", "what it did")
    for run in runs:
        seconds = "" if run.finished_ns is None else f"{(run.finished_ns - run.started_ns) / 1e9:.1f}"
        table.add_row(run.job, run.outcome, seconds, run.error or _counts(run.counts))
    return table


def _counts(counts: Mapping[str, int]) -> str:
    """Return what a run has counted in words; refused windows with their reasons behind them."""
    why = ", ".join(f"{count} {code.value}" for code, count in refusals(counts).items())
    named = [f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if not name.startswith(REFUSED)]
    return ", ".join(f"{one}: {why}" if why and one.endswith(" refused") else one for one in named)

"""``treadwatch estimate``: the scheduled jobs, once, now, in order."""

from __future__ import annotations

from typing import Annotated

import typer

from api.commands.worker_options import DaskScheduler, Workers
from estimation.errors import ParameterError


def estimate(
    *,
    job: Annotated[str | None, typer.Option(help="Only this job, such as estimate_windows.")] = None,
    reasons: Annotated[
        bool, typer.Option("--reasons", help="Run nothing; say of every wheelset without an estimate why it has none.")
    ] = False,
    workers: Workers = None,
    dask_scheduler: DaskScheduler = None,
) -> None:
    """Run every job once, now, in the order in which one hands its results to the next; say what has no estimate."""
    from api.settings import load_settings
    from api.terminal.estimate import run_jobs_once
    from api.terminal.reasons import print_each

    if reasons:
        if job is not None:
            raise ParameterError("runs nothing: leave --job out", field="--reasons")
        print_each(load_settings())
        return
    if not run_jobs_once(job, load_settings(workers=workers, dask_scheduler=dask_scheduler)):
        raise typer.Exit(1)

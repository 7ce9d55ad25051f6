"""``treadwatch estimate``: the scheduled jobs, once, now, in order."""

from __future__ import annotations

from typing import Annotated

import typer

from api.commands.worker_options import DaskScheduler, Workers


def estimate(
    *,
    job: Annotated[str | None, typer.Option(help="Only this job, such as estimate_windows.")] = None,
    workers: Workers = None,
    dask_scheduler: DaskScheduler = None,
) -> None:
    """Run every job once, now, in the order in which one hands its results to the next."""
    from api.settings import load_settings
    from api.terminal.estimate import run_jobs_once

    if not run_jobs_once(job, load_settings(workers=workers, dask_scheduler=dask_scheduler)):
        raise typer.Exit(1)

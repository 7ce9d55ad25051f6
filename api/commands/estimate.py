"""``treadwatch estimate``: the scheduled jobs, once, now, in order."""

from __future__ import annotations

from typing import Annotated

import typer


def estimate(
    *, job: Annotated[str | None, typer.Option(help="Only this job, such as estimate_windows.")] = None
) -> None:
    """Run every job once, now, in the order in which one hands its results to the next."""
    from api.terminal.estimate import run_jobs_once

    if not run_jobs_once(job):
        raise typer.Exit(1)

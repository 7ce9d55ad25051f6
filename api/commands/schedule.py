"""``treadwatch schedule``: the jobs on their schedules; exactly one per deployment."""

from __future__ import annotations

from typing import Annotated

import typer

from api.commands.worker_options import DaskScheduler, Workers


def schedule(
    *,
    wait: Annotated[
        bool, typer.Option("--wait", help="Stand by while another scheduler is at work, and take its place.")
    ] = False,
    workers: Workers = None,
    dask_scheduler: DaskScheduler = None,
) -> None:
    """Run the jobs on schedule until asked to stop; refused where another scheduler is at work on the database."""
    import threading
    from contextlib import closing
    from dataclasses import replace
    from functools import partial

    from api import logs
    from api.factory import (
        job_context,
        once_the_database_answers,
        open_store,
        process_name,
        scheduled_jobs,
        upkeep_jobs,
    )
    from api.settings import load_settings
    from api.tracing import start_tracing
    from api.workers.choice import executor_of
    from estimation.jobs.scheduler import serve_jobs
    from estimation.jobs.stop_signals import stop_on_signals

    settings = load_settings(workers=workers, dask_scheduler=dask_scheduler)
    logs.configure(settings)
    start_tracing()
    stopping = threading.Event()
    stop_on_signals(stopping)
    opened = once_the_database_answers(partial(open_store, settings), settings, stopping)
    if opened is None:
        return
    with closing(opened) as storage, executor_of(settings) as executor:
        context = replace(job_context(settings, storage), executor=executor)
        jobs = (*scheduled_jobs(settings), *upkeep_jobs(settings))
        serve_jobs(context, jobs, stopping, holder=process_name(), wait=wait)

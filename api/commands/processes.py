"""Subcommands that run as processes of a deployment: REST API, scheduler, worker, and the jobs once."""

from __future__ import annotations

from typing import Annotated

import typer

from estimation.errors import ParameterError

Workers = Annotated[
    str | None,
    typer.Option(
        help="Processes that estimate; auto is one for each processor.  [env var: TREADWATCH_WORKERS; default: 1]"
    ),
]
DaskScheduler = Annotated[
    str | None,
    typer.Option(
        help=(
            "Address of a Dask scheduler whose workers estimate instead.  "
            "[env var: TREADWATCH_DASK_SCHEDULER; default: none]"
        )
    ),
]


def serve(
    *,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on.  [env var: TREADWATCH_HOST; default: 127.0.0.1]")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(help="Port to listen on; 0 takes a free one.  [env var: TREADWATCH_PORT; default: 8000]"),
    ] = None,
) -> None:
    """Serve the REST API; its documentation is on /docs."""
    from api import factory, logs
    from api.settings import load_settings
    from api.terminal.store import begun

    settings = load_settings(host=host, port=port)
    stopping = begun(settings)  # the server hands its signal on when it has stopped
    with logs.in_background():
        factory.serve(settings, stopping)


def schedule(
    *,
    wait: Annotated[
        bool, typer.Option("--wait", help="Stand by while another scheduler is at work, and take its place.")
    ] = False,
    workers: Workers = None,
    dask_scheduler: DaskScheduler = None,
) -> None:
    """Run the jobs on schedule until asked to stop; refused where another scheduler is at work on the database."""
    from contextlib import closing
    from dataclasses import replace

    from api.factory import job_context, process_name, scheduled_jobs, upkeep_jobs
    from api.settings import load_settings
    from api.terminal.store import begun, executor_of, store_once_it_answers
    from estimation.jobs.scheduler import serve_jobs

    settings = load_settings(workers=workers, dask_scheduler=dask_scheduler)
    stopping = begun(settings)
    opened = store_once_it_answers(settings, stopping)
    if opened is None:
        return
    with closing(opened) as storage, executor_of(settings) as executor:
        context = replace(job_context(settings, storage), executor=executor)
        jobs = (*scheduled_jobs(settings), *upkeep_jobs(settings))
        serve_jobs(context, jobs, stopping, holder=process_name(), wait=wait)


def worker(*, workers: Workers = None, dask_scheduler: DaskScheduler = None) -> None:
    """Let processes of this machine work for a Dask scheduler; each has the settings of this environment."""
    import threading

    from api import logs
    from api.settings import load_settings
    from api.terminal.store import store_once_it_answers
    from api.workers.on_dask import serve_dask
    from estimation.jobs.stop_signals import stop_on_signals

    settings = load_settings(workers=workers, dask_scheduler=dask_scheduler)
    if settings.dask_scheduler is None:
        raise ParameterError("is needed: the address of the Dask scheduler", field="--dask-scheduler")
    logs.configure(settings)
    stopping = threading.Event()
    stop_on_signals(stopping)
    opened = store_once_it_answers(settings, stopping)
    if opened is not None:
        opened.close()
        serve_dask(settings.dask_scheduler, settings, stopping)


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
    from api.terminal.estimate import print_each, run_jobs_once

    if reasons:
        if job is not None:
            raise ParameterError("runs nothing: leave --job out", field="--reasons")
        print_each(load_settings())
        return
    if not run_jobs_once(job, load_settings(workers=workers, dask_scheduler=dask_scheduler)):
        raise typer.Exit(1)

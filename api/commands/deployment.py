"""Subcommands of a deployment: its processes, database, backups, settings, and the OpenAPI document."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from estimation.errors import ParameterError

db = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@db.command("upgrade")
def upgrade_database() -> None:
    """Create the database if there is none, and run every migration that it lacks."""
    from api.settings import load_settings
    from fleet_db.migrate import upgrade

    typer.echo(f"the database is at migration {upgrade(load_settings().url)}")


@db.command("check")
def check_database(
    *,
    deep: Annotated[
        bool, typer.Option("--deep", help="Read everything that is stored; compare rows, files and digests.")
    ] = False,
) -> None:
    """Check that the database answers and is at the migration that this version needs."""
    from api.settings import load_settings
    from fleet_db.migrate import check_head, head
    from fleet_db.session import database_engine

    engine = database_engine(load_settings().url)
    try:
        check_head(engine)
    finally:
        engine.dispose()
    typer.echo(f"the database is at migration {head()}, as this version needs")
    if deep:
        from api.terminal.keeping import check_and_report

        check_and_report()


@db.command("purge")
def purge_database() -> None:
    """Delete what has been kept long enough (TREADWATCH_RETENTION_FILE), in small batches, while services run."""
    from contextlib import closing

    from api.factory import SystemClock, open_store, raw_store, retention_of
    from api.settings import load_settings
    from fleet_db.keeping.purge import purge

    settings = load_settings()
    with closing(open_store(settings)) as storage:
        done = purge(storage, raw_store(settings), retention_of(settings), SystemClock().now_ns(), lambda: None)
    for purged in done:
        size = f", {purged.item_bytes:,} bytes" if purged.item_bytes else ""
        typer.echo(f"{purged.kind.value.replace('_', ' ')}: {purged.items:,} deleted{size}")


@db.command("stats")
def show_stored_bytes(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    hours_per_day: Annotated[
        float | None,
        typer.Option(min=0.0, max=24.0, metavar="<hours>", help="Running of a wheelset; without, as in its last days."),
    ] = None,
) -> None:
    """Show where the bytes are, by kind, and what a wheelset keeps of a year."""
    from api.terminal.keeping import print_stored_bytes

    print_stored_bytes(as_json=as_json, hours_per_day=hours_per_day)


Folder = Annotated[Path, typer.Argument(help="Folder of the backups; those in it share their files.")]


def backup(
    folder: Folder,
    *,
    windows: Annotated[
        bool, typer.Option(help="Back up the samples of windows, too; they can be made again from the recordings.")
    ] = True,
    recordings: Annotated[
        bool | None,
        typer.Option(help="Back up the raw recordings, too; by default those of a folder, not those of a bucket."),
    ] = None,
) -> None:
    """Back up the database and all files, while services run, and verify what was written."""
    from api.terminal.keeping import back_up_and_report

    back_up_and_report(folder, windows=windows, recordings=recordings)


def restore(
    folder: Folder,
    *,
    name: Annotated[str | None, typer.Option(help="Which backup of the folder; by default the newest.")] = None,
) -> None:
    """Restore a backup into an empty database and the data folder; stop all services first."""
    from api.terminal.keeping import restore_and_report

    restore_and_report(folder, name)


def settings() -> None:
    """List the environment variables of a deployment with their defaults; no value that is set is shown."""
    from api.terminal.settings import print_settings

    print_settings()


def openapi(
    *, write: Annotated[bool, typer.Option("--write", help="Write it to the committed file instead.")] = False
) -> None:
    """Print the OpenAPI document, or write it to the file that is committed."""
    from importlib.resources import as_file, files

    from api.app import COMMITTED, document_text

    if not write:
        typer.echo(document_text(), nl=False)
        return
    with as_file(files("api") / COMMITTED) as path:
        path.write_text(document_text(), encoding="utf-8")
        typer.echo(f"written: {path}")


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
    from api import logs, serving
    from api.settings import load_settings
    from api.terminal.processes import begun

    settings = load_settings(host=host, port=port)
    stopping = begun(settings)
    with logs.in_background():
        serving.serve(settings, stopping)


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

    from api.factory import process_name
    from api.pipeline import job_context, scheduled_jobs, upkeep_jobs
    from api.settings import load_settings
    from api.terminal.processes import begun, executor_of, store_once_it_answers
    from estimation.jobs.scheduler import serve_jobs

    settings = load_settings(workers=workers, dask_scheduler=dask_scheduler)
    stopping = begun(settings)
    with closing(store_once_it_answers(settings, stopping)) as storage, executor_of(settings) as executor:
        context = replace(job_context(settings, storage), executor=executor)
        jobs = (*scheduled_jobs(settings), *upkeep_jobs(settings))
        serve_jobs(context, jobs, stopping, holder=process_name(), wait=wait)


def worker(*, workers: Workers = None, dask_scheduler: DaskScheduler = None) -> None:
    """Let processes of this machine work for a Dask scheduler; each has the settings of this environment."""
    import threading

    from api import logs
    from api.settings import load_settings
    from api.terminal.processes import store_once_it_answers
    from api.terminal.stopping import stop_on_signals
    from api.workers.on_dask import serve_dask

    settings = load_settings(workers=workers, dask_scheduler=dask_scheduler)
    if settings.dask_scheduler is None:
        raise ParameterError("is needed: the address of the Dask scheduler", field="--dask-scheduler")
    logs.configure(settings)
    stopping = threading.Event()
    stop_on_signals(stopping)
    store_once_it_answers(settings, stopping).close()
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

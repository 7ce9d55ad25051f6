"""Subcommands of a deployment: its database, backups, compiled code, settings, and the OpenAPI document."""

from __future__ import annotations

import json
import time
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from estimation.errors import StorageError

db = typer.Typer(no_args_is_help=True, help="Upgrade, check, measure or purge the database.", rich_markup_mode=None)


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
    from api.terminal.keeping import purge_and_report

    purge_and_report()


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


def compile() -> None:  # noqa: A001 - the name of the command
    """Compile every kernel into TREADWATCH_COMPILED_DIR, or load what is already there."""
    from estimation.compiled import COUNTS, directories

    started = time.process_time()
    compile_kernels()
    if COUNTS.not_kept:
        raise StorageError(f"{directories()[0]}: {COUNTS.not_kept} compiled functions could not be written")
    typer.echo(
        f"{COUNTS.compiled} compiled, {COUNTS.loaded} already there, {time.process_time() - started:.1f} s of CPU"
    )


SIGNATURES = Path(__file__).parents[1] / "kernel_signatures.json"
"""A test compares it with runs of every kernel."""


def compile_kernels() -> None:
    """Compile every kernel with every type of arguments, or load what is already there."""
    for name, signatures in json.loads(SIGNATURES.read_text(encoding="utf-8")).items():
        kernel = _named(name)
        for signature in signatures:
            kernel.compile(tuple(_type_of(described) for described in signature))


def _named(path: str) -> Any:  # noqa: ANN401 - a compiled function, or a class
    module, _, name = path.rpartition(".")
    return getattr(import_module(module), name)


def _type_of(described: Any) -> Any:  # noqa: ANN401 - JSON, and a type of numba
    """Return a type: a scalar, an array with its dimensions, a tuple of types, or a named tuple by its class."""
    import numba
    import numpy as np

    types: Any = numba.types
    if isinstance(described, dict):
        ((name, parts),) = described.items()
        return types.BaseTuple.from_types([_type_of(part) for part in parts], pyclass=_named(name))
    if isinstance(described, list):
        return types.BaseTuple.from_types([_type_of(part) for part in described])
    kind, *dimensions = described.split()
    scalar = numba.from_dtype(np.dtype(kind))
    if not dimensions:
        return scalar
    return types.Array(scalar, int(dimensions[0]), "C", readonly="readonly" in dimensions)


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

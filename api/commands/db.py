"""``treadwatch db``: bring the database to this version, or check that it is there."""

from __future__ import annotations

from typing import Annotated

import typer

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
    from api.terminal.stored_bytes import print_stored_bytes

    print_stored_bytes(as_json=as_json, hours_per_day=hours_per_day)

"""``treadwatch keys``: make, list and revoke the keys of the REST API, in the database itself."""

from __future__ import annotations

from typing import Annotated

import typer

keys = typer.Typer(no_args_is_help=True, help="Make, list and revoke keys of the REST API.", rich_markup_mode=None)


@keys.command("create")
def create_key(
    *,
    owner: Annotated[str, typer.Option(help="Who it is for; recorded with what is done with it.")],
    scope: Annotated[list[str], typer.Option(help="What it allows: read, act, ingest, admin; may be given again.")],
    fleet: Annotated[list[str] | None, typer.Option(help="A fleet that it sees; may be given again.")] = None,
    all_fleets: Annotated[bool, typer.Option("--all-fleets", help="It sees all fleets.")] = False,
    days: Annotated[float | None, typer.Option(help="It expires after so many days; left out, never.")] = None,
) -> None:
    """Make a key and print it, this once: what is stored is its digest."""
    from api.terminal.keys import create_and_print

    create_and_print(owner, scope, fleet or [], days, all_fleets=all_fleets)


@keys.command("list")
def list_keys() -> None:
    """List the keys: prefix, owner, scopes, fleets, and when they were used last."""
    from api.terminal.keys import key_list

    typer.echo(key_list())


@keys.command("revoke")
def revoke_key(prefix: Annotated[str, typer.Argument(help="Prefix of the key.")]) -> None:
    """Revoke a key for ever; a running service refuses it after at most 5 s."""
    from api.terminal.keys import revoke_and_print

    revoke_and_print(prefix)

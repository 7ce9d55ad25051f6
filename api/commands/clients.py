"""Subcommands for those who use the REST API: keys, webhooks, and the feed of alerts."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

keys = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


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
    from api.terminal.store import note, writing

    with writing() as unit:
        revoked = unit.api_keys.revoke(prefix, time.time_ns())
        note(unit, "keys", "revoke", revoked.prefix)
    typer.echo(f"key {revoked.prefix} of {revoked.owner} is revoked")


webhooks = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
Number = Annotated[int, typer.Argument(help="Number of the webhook.", min=1)]


@webhooks.command("add")
def add_webhook(
    url: Annotated[str, typer.Argument(help="Where events are posted to.")],
    *,
    description: Annotated[str, typer.Option(help="What it is for.")] = "",
    fleet: Annotated[list[str] | None, typer.Option(help="Only of this fleet; may be given again.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only of this kind; may be given again.")] = None,
    severity: Annotated[
        list[str] | None, typer.Option(help="Only alerts that have had this severity; may be given again.")
    ] = None,
) -> None:
    """Make a webhook of all fleets and print its secret, this once."""
    from api.terminal.webhooks import add_and_print

    add_and_print(url, description, fleet or [], kind or [], severity or [])


@webhooks.command("list")
def list_webhooks() -> None:
    """List the webhooks: number, state and since when, what waits, and where to."""
    from api.terminal.webhooks import webhook_list

    typer.echo(webhook_list())


@webhooks.command("test")
def try_webhook(number: Number) -> None:
    """Send one signed event that only tries it out; exit 1 where it is not taken."""
    from api.terminal.webhooks import try_and_print

    if not try_and_print(number):
        raise typer.Exit(1)


@webhooks.command("pause")
def pause_webhook(number: Number) -> None:
    """Send nothing more for now; it waits where it stands."""
    from api.terminal.webhooks import put_and_print

    put_and_print(number, active=False)


@webhooks.command("activate")
def activate_webhook(number: Number) -> None:
    """Go on where it stood when it was paused or disabled."""
    from api.terminal.webhooks import put_and_print

    put_and_print(number, active=True)


@webhooks.command("replay")
def replay_webhook(
    number: Number,
    *,
    after: Annotated[str | None, typer.Option(help="Go on behind this cursor or event id; 'latest': skip.")] = None,
    from_time: Annotated[
        str | None, typer.Option("--from", help="Go on with what was recorded from this time on (RFC 3339).")
    ] = None,
) -> None:
    """Go on from another place of the feed; what was sent already is sent again, under the same ids."""
    from api.terminal.webhooks import replay_and_print

    replay_and_print(number, after, from_time)


@webhooks.command("delete")
def delete_webhook(number: Number) -> None:
    """Delete it with its secrets and the records of its deliveries."""
    from api.terminal.store import note, writing

    with writing() as unit:
        unit.webhooks.locked(number)
        unit.webhooks.delete(number)
        note(unit, "webhooks", "delete", str(number))
    typer.echo(f"webhook {number} is deleted")


def feed(
    *,
    follow: Annotated[
        bool, typer.Option("--follow/--once", help="Go on until Ctrl-C is pressed, or end with what there is.")
    ] = False,
    after: Annotated[str | None, typer.Option(help="Begin behind this cursor; 'latest': behind the newest.")] = None,
    fleet: Annotated[list[str] | None, typer.Option(help="Only of this fleet; may be repeated.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only of this kind; may be repeated.")] = None,
    severity: Annotated[
        list[str] | None, typer.Option(help="Only alerts that have had this severity; may be repeated.")
    ] = None,
    state: Annotated[
        Path | None, typer.Option(help="File that keeps the cursor; the next call goes on behind it.")
    ] = None,
    url: Annotated[
        str, typer.Option(envvar="TREADWATCH_URL", help="Address of the service.")
    ] = "http://127.0.0.1:8000",
    as_json: Annotated[bool, typer.Option("--json", help="Print events as JSON, one a line.")] = False,
) -> None:
    """Print what happens to alerts, in commit order; the key of the service is read from TREADWATCH_KEY."""
    import os

    import httpx

    from api.feed_client import Follower, Lines, read_state
    from estimation.errors import ParameterError

    if not url.startswith(("http://", "https://")):
        raise ParameterError("must begin with http:// or https://", field="--url")
    kept = read_state(state)
    key = os.environ.get("TREADWATCH_KEY")
    if key is not None and not (key.isascii() and key.isprintable()):
        raise ParameterError("holds characters that no key has", field="TREADWATCH_KEY")
    named = (("fleet", fleet), ("kind", kind), ("severity", severity))
    query = [(name, value) for name, values in named for value in values or ()]
    headers = {} if key is None else {"Authorization": f"Bearer {key}"}
    with httpx.Client(base_url=url, headers=headers, timeout=30.0, trust_env=False) as http:
        follower = Follower(http, query, Lines(as_json, state), after if kept is None else kept)
        try:
            follower.follow() if follow else follower.once()
        except KeyboardInterrupt:
            return
        except BrokenPipeError:  # whoever read the lines has gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

"""``treadwatch webhooks``: make, list, try out, move and delete webhooks, in the database itself."""

from __future__ import annotations

from typing import Annotated

import typer

webhooks = typer.Typer(no_args_is_help=True, help="Send what happens to alerts to a URL.", rich_markup_mode=None)
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
    from api.terminal.webhooks import delete_and_print

    delete_and_print(number)

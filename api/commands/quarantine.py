"""``treadwatch quarantine``: list what failed by itself, and let it be tried again now."""

from __future__ import annotations

from typing import Annotated

import typer

from estimation.values.runs import SubjectKind

quarantine = typer.Typer(no_args_is_help=True, help="List and retry what failed by itself.", rich_markup_mode=None)


@quarantine.command("list")
def list_quarantine(
    *,
    everything: Annotated[bool, typer.Option("--all", help="Also what has succeeded since.")] = False,
) -> None:
    """List what failed, with its reason code, how often, and when it is tried again."""
    from api.terminal.recordings import quarantine_list

    typer.echo(quarantine_list(everything=everything))


@quarantine.command("retry")
def retry_quarantine(
    kind: Annotated[SubjectKind | None, typer.Argument(help="Only this kind.")] = None,
    key: Annotated[str | None, typer.Argument(help="Only this one of that kind.")] = None,
) -> None:
    """Decode recordings in quarantine now, and let the next run of the jobs try the rest."""
    from api.terminal.recordings import retry_and_report

    retry_and_report(kind, key)

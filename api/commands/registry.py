"""``treadwatch registry``: load a registry file; void and restore records; list what was decided on them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fleet_db.registry_events import RecordAction, RecordKind

registry = typer.Typer(no_args_is_help=True, help="Load and correct the registry.", rich_markup_mode=None)

_Kind = Annotated[RecordKind, typer.Argument(help="What kind of record.")]
_Subject = Annotated[str, typer.Argument(metavar="NAME", help="Serial of the wheelset, or code of the section.")]
_At = Annotated[str | None, typer.Option(help="Time of the record: 'from' of a mounting, 'at' of the others.")]
_Why = Annotated[str, typer.Option(help="Why; kept with the decision.")]
_Actor = Annotated[str, typer.Option("--by", help="Who; by default the user of the system.")]


@registry.command("load")
def load(file: Annotated[Path, typer.Argument(help="Registry file.")]) -> None:
    """Load a registry file: new records are added, those of the same key changed."""
    from api.terminal.registry import load_and_report

    load_and_report(file)


@registry.command("void")
def void(kind: _Kind, subject: _Subject, *, why: _Why, at: _At = None, actor: _Actor = "") -> None:
    """Take a record out that was wrong; what rests on it is made again."""
    from api.terminal.registry import decide_and_report

    decide_and_report(RecordAction.VOIDED, kind, subject, at, actor, why)


@registry.command("restore")
def restore(kind: _Kind, subject: _Subject, *, why: _Why, at: _At = None, actor: _Actor = "") -> None:
    """Put a record back that was voided."""
    from api.terminal.registry import decide_and_report

    decide_and_report(RecordAction.RESTORED, kind, subject, at, actor, why)


@registry.command("history")
def history(subject: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Only of this one.")] = None) -> None:
    """List what was changed, voided and restored, the oldest first."""
    from api.terminal.registry import history_lines

    for line in history_lines(subject):
        typer.echo(line)

"""``treadwatch registry``: load, check and export a registry; void and restore records; list what was decided."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from estimation.errors import ParameterError
from fleet_db.registry_events import RecordAction, RecordKind
from ingest.registry_entry.contents import CONFIRMABLE, Rule

_DOUBTS = ", ".join(sorted(CONFIRMABLE))

registry = typer.Typer(no_args_is_help=True, help="Load and correct the registry.", rich_markup_mode=None)

_Kind = Annotated[RecordKind, typer.Argument(help="What kind of record.")]
_Subject = Annotated[str, typer.Argument(metavar="NAME", help="Serial of the wheelset, or code of the section.")]
_At = Annotated[str | None, typer.Option(help="Time of the record: 'from' of a mounting, 'at' of the others.")]
_Why = Annotated[str, typer.Option(help="Why; kept with the decision.")]
_EntryWhy = Annotated[str, typer.Option("--why", help="Why; kept with every record that changes.")]
_Actor = Annotated[str, typer.Option("--by", help="Who; by default the user of the system.")]


_File = Annotated[Path, typer.Argument(metavar="FILE", help="Registry file.")]
_Confirmed = Annotated[
    list[Rule] | None,
    typer.Option("--confirm", metavar="DOUBT", help=f"What is so all the same: {_DOUBTS}. May be repeated."),
]


def _doubts(confirmed: list[Rule] | None) -> list[Rule]:
    """Refuse rules that nobody can confirm away."""
    impossible = [one for one in confirmed or () if one not in CONFIRMABLE]
    if impossible:
        raise ParameterError(f"{impossible[0]} cannot be confirmed; what can: {_DOUBTS}", field="--confirm")
    return confirmed or []


@registry.command("load")
def load(file: _File, *, confirm: _Confirmed = None, why: _EntryWhy = "", actor: _Actor = "") -> None:
    """Load a registry file, whole or not at all: new records are added, those of the same key changed."""
    from api.terminal.registry_files import load_and_report

    load_and_report(file, _doubts(confirm), actor, why)


@registry.command("check")
def check(file: _File, *, confirm: _Confirmed = None) -> None:
    """Print everything in a registry file that is wrong or contradicts what is on file, and store nothing."""
    from api.terminal.registry_files import check_and_report

    check_and_report(file, _doubts(confirm))


@registry.command("export")
def export(file: Annotated[Path, typer.Argument(metavar="FILE", help="Registry file to be written.")]) -> None:
    """Write the registry as a file that loads to the same registry, and the files it names beside it."""
    from api.terminal.registry_files import export_and_report

    export_and_report(file)


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

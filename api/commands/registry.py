"""Subcommands of what is on file: the registry, vehicle classes and alert rules."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from estimation.errors import ParameterError
from fleet_db.records import RecordAction, RecordKind
from ingest.registry_entry.contents import CONFIRMABLE, Rule

_DOUBTS = ", ".join(sorted(CONFIRMABLE))

registry = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

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
    impossible = [rule for rule in confirmed or () if rule not in CONFIRMABLE]
    if impossible:
        raise ParameterError(f"{impossible[0]} cannot be confirmed; what can: {_DOUBTS}", field="--confirm")
    return confirmed or []


@registry.command("load")
def load(file: _File, *, confirm: _Confirmed = None, why: _EntryWhy = "", actor: _Actor = "") -> None:
    """Load a registry file, whole or not at all: new records are added, those of the same key changed."""
    from api.terminal.registry import load_and_report

    load_and_report(file, _doubts(confirm), actor, why)


@registry.command("check")
def check(file: _File, *, confirm: _Confirmed = None) -> None:
    """Print everything in a registry file that is wrong or contradicts what is on file, and store nothing."""
    from api.terminal.registry import check_and_report

    check_and_report(file, _doubts(confirm))


@registry.command("export")
def export(file: Annotated[Path, typer.Argument(metavar="FILE", help="Registry file to be written.")]) -> None:
    """Write the registry as a file that loads to the same registry, and the files it names beside it."""
    from api.terminal.store import reading
    from ingest.registry_export import write_export

    with reading() as unit:
        written = write_export(file, unit)
    typer.echo(f"wrote {file}: {written.records:,} records, {len(written.files):,} files beside it")


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


vehicle = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

_Class = Annotated[str, typer.Argument(metavar="FILE|NAME", help="A TOML file, or the name of a shipped class.")]
_Name = Annotated[str, typer.Argument(metavar="NAME", help="The name of a shipped class.")]
_Speed = Annotated[float, typer.Option(min=1.0, max=150.0, help="m/s.")]
_Conicity = Annotated[float, typer.Option(min=0.005, max=1.0, help="Equivalent conicity of all wheelsets.")]


@vehicle.command("list")
def list_classes() -> None:
    """List the classes that are shipped."""
    from ingest.vehicle_class_schema import shipped_class, shipped_classes

    for item in map(shipped_class, shipped_classes()):
        typer.echo(f"{item.code:<12}{item.arrangement:<17}{item.name}")


@vehicle.command("show")
def show_class(name: _Name) -> None:
    """Print the file of a shipped class, to copy from."""
    from ingest.vehicle_class_schema import shipped_path

    typer.echo(shipped_path(name).read_text(encoding="utf-8"), nl=False)


@vehicle.command("check")
def check_class(file: _Class, speed: _Speed = 20.0, conicity: _Conicity = 0.2) -> None:
    """Print modes, critical speed, and what the sensors see with which std; refuse what no railway vehicle is."""
    from api.terminal.vehicle import check_report, named_class

    typer.echo(check_report(named_class(file), speed, conicity))


rules = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@rules.command("check")
def check_rules(file: Annotated[Path, typer.Argument(metavar="FILE", help="A TOML file of alert rules.")]) -> None:
    """Print the rules of every fleet and class that a file leads to; refuse one that is wrong or contradicts itself."""
    from api.rules_file import load_rules
    from api.terminal.rules import print_rules

    print_rules(load_rules(file))


@rules.command("show")
def show_rules() -> None:
    """Print the rules in force: those of TREADWATCH_RULES_FILE, or the shipped ones."""
    from api.rules_file import load_rules
    from api.settings import load_settings
    from api.terminal.rules import print_rules
    from estimation.alerts.rule_book import RuleBook

    file = load_settings().rules_file
    print_rules(RuleBook() if file is None else load_rules(file))


@rules.command("replay")
def replay_rules(
    from_: Annotated[str, typer.Option("--from", help="Date, or time as in RFC 3339, of the vehicles' clocks.")],
    *,
    to: Annotated[str | None, typer.Option(help="End of the time that is looked at; now by default.")] = None,
    rules_file: Annotated[
        Path | None, typer.Option("--rules", help="Rules to try; without it those in force are replayed.")
    ] = None,
    fleet: Annotated[str | None, typer.Option(help="Only the wheelsets of this fleet.")] = None,
) -> None:
    """Show which alerts other rules would have raised over what is stored; nothing is written."""
    from api.terminal.rules import replay

    replay(from_, to, rules_file, fleet)

"""``treadwatch rules``: check alert rules, and try them on what is stored."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

rules = typer.Typer(
    no_args_is_help=True, help="Check alert rules, and try them on what is stored.", rich_markup_mode=None
)


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
    from estimation.alerts.rules.book import RuleBook

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
    from api.terminal.rules_replay import replay

    replay(from_, to, rules_file, fleet)

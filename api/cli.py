"""The one command, ``treadwatch``: every service and every tool is a subcommand of it.

Only the subcommand that is called is imported, and a subcommand imports what it runs only when it runs: help does not
wait for the numerics or the web server.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated

import typer

from api.compiled_code import choose_compiled_code
from estimation.errors import TreadwatchError

REFUSED = 2
EPILOG = (
    "A deployment is set up by environment variables (TREADWATCH_...) or a file .env: "
    "'treadwatch settings' lists them with their defaults."
)
COMPLETED = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")
"""Variables in which bash, and the other shells, hand over the line that is to be completed."""


@dataclass(frozen=True, slots=True)
class Command:
    """A subcommand: what ``module`` of ``api.commands`` has under its name, a function or a Typer group."""

    name: str
    module: str
    summary: str
    reads_settings: bool = True


COMMANDS = (
    Command("demo", "studies", "Run the main job end to end on the embedded default."),
    Command("simulate", "studies", "Simulate a fleet that sends CAN frames.", reads_settings=False),
    Command("ingest", "receiving", "Receive CAN frames from log files or a live bus."),
    Command("registry", "registry", "Load, void, restore and list records of the registry."),
    Command("reassemble", "receiving", "Make the windows of a vehicle again."),
    Command("recordings", "receiving", "List and correct what was received."),
    Command("chunk", "receiving", "Watch a drop folder, decode what is received, scrub raw files."),
    Command("quarantine", "receiving", "List and retry what failed by itself."),
    Command("estimate", "processes", "Run the scheduled jobs once, now, in order."),
    Command("serve", "processes", "Serve the REST API."),
    Command("keys", "clients", "Make, list and revoke keys of the REST API."),
    Command("webhooks", "clients", "Make, list, try out and move webhooks."),
    Command("schedule", "processes", "Run the jobs on schedule; one per deployment."),
    Command("worker", "processes", "Work for a Dask scheduler, on any machine."),
    Command("feed", "clients", "Print what happens to alerts, or follow it.", reads_settings=False),
    Command("rules", "registry", "Check alert rules, and try them on what is stored."),
    Command("contact", "studies", "Compute the contact geometry of a wheel on a rail.", reads_settings=False),
    Command("vehicle", "registry", "List, show and check vehicle classes.", reads_settings=False),
    Command("compare", "studies", "Compare estimators on a simulated section.", reads_settings=False),
    Command("reproduce", "studies", "Reproduce the published figures.", reads_settings=False),
    Command("compile", "deployment", "Compile every kernel, so that the first start need not."),
    Command("db", "deployment", "Upgrade, check, measure or purge the database."),
    Command("backup", "deployment", "Back up database and files while everything runs."),
    Command("restore", "deployment", "Restore a backup into an empty database."),
    Command("settings", "deployment", "List the settings of a deployment with their defaults."),
    Command("openapi", "deployment", "Print or write the OpenAPI document.", reads_settings=False),
)


def _print_version(wanted: bool) -> None:  # noqa: FBT001 - typer hands an option's value by position
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415 - other commands do not wait for it

        typer.echo(f"treadwatch {version('treadwatch')}")
        raise typer.Exit


def _root(
    *,
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Wheel-rail wear of a fleet, from CAN frames to trends and alerts."""


def _not_imported() -> None:
    """Stand for a subcommand that was not called."""


def build(arguments: Sequence[str]) -> typer.Typer:
    """Return the command line with the subcommand named in ``arguments`` loaded; the others only as their summary."""
    app = typer.Typer(
        no_args_is_help=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        epilog=EPILOG,
    )
    app.callback()(_root)
    chosen = next((word for word in arguments if not word.startswith("-")), None)
    for command in COMMANDS:
        if command.name != chosen:
            app.command(command.name, help=command.summary)(_not_imported)
            continue
        epilog = EPILOG if command.reads_settings else None
        target = getattr(import_module(f"api.commands.{command.module}"), command.name)
        if isinstance(target, typer.Typer):
            app.add_typer(target, name=command.name, help=command.summary, epilog=epilog)
        else:
            app.command(command.name, epilog=epilog)(target)
    return app


def _being_completed() -> list[str]:
    """Return the words behind the command's name that a shell asks to complete; none where it does not."""
    return next((os.environ[name].split()[1:] for name in COMPLETED if name in os.environ), [])


def main() -> None:
    """Run the command line; a refusal is one line on standard error and exit code 2.

    Linear algebra runs on one thread unless the environment sets it: the matrices are small, and threads that
    wait for each other on busy cores made the estimation eight times slower.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    choose_compiled_code(os.environ)
    arguments = sys.argv[1:]
    try:
        build(arguments or _being_completed())(arguments, prog_name="treadwatch")
    except TreadwatchError as error:
        print(f"treadwatch: {error}", file=sys.stderr)  # noqa: T201 - the command line's own output
        raise SystemExit(REFUSED) from None

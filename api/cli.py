"""The one command, ``treadwatch``: every service and every tool is a subcommand of it.

Only the subcommand that is called is imported, and a subcommand imports what it runs only when it runs: help does not
wait for the numerics or the web server.
"""

from __future__ import annotations

import gc
import os
import platform
import sys
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

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
    without_gc: tuple[str, ...] = ()  # commands of it that take a second, of which the search for garbage is a fifth


COMMANDS = (
    Command("demo", "studies", "Run the main job end to end on the embedded default."),
    Command("simulate", "studies", "Simulate a fleet that sends CAN frames.", reads_settings=False),
    Command("ingest", "receiving", "Receive CAN frames from log files or a live bus."),
    Command(
        "registry", "registry", "Load, void, restore and list records of the registry.", without_gc=("check", "history")
    ),
    Command("reassemble", "receiving", "Make the windows of a vehicle again."),
    Command("recordings", "receiving", "List and correct what was received.", without_gc=("list", "show")),
    Command("chunk", "receiving", "Watch a drop folder, decode what is received, scrub raw files."),
    Command("quarantine", "receiving", "List and retry what failed by itself."),
    Command("estimate", "deployment", "Run the scheduled jobs once, now, in order."),
    Command("serve", "deployment", "Serve the REST API."),
    Command("keys", "clients", "Make, list and revoke keys of the REST API.", without_gc=("create", "list", "revoke")),
    Command("webhooks", "clients", "Make, list, try out and move webhooks.", without_gc=("list",)),
    Command("schedule", "deployment", "Run the jobs on schedule; one per deployment."),
    Command("worker", "deployment", "Work for a Dask scheduler, on any machine."),
    Command("feed", "clients", "Print what happens to alerts, or follow it.", reads_settings=False),
    Command("rules", "registry", "Check alert rules, and try them on what is stored."),
    Command("contact", "studies", "Compute the contact geometry of a wheel on a rail.", reads_settings=False),
    Command("vehicle", "registry", "List, show and check vehicle classes.", reads_settings=False),
    Command("compare", "studies", "Compare estimators on a simulated section.", reads_settings=False),
    Command("reproduce", "studies", "Reproduce the published figures.", reads_settings=False),
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


def _chosen(arguments: Sequence[str]) -> Command | None:
    name = next((word for word in arguments if not word.startswith("-")), None)
    return next((command for command in COMMANDS if command.name == name), None)


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
    chosen = _chosen(arguments)
    for command in COMMANDS:
        if command is not chosen:
            app.command(command.name, help=command.summary)(_not_imported)
            continue
        epilog = EPILOG if command.reads_settings else None
        target = getattr(import_module(f"api.commands.{command.module}"), command.name)
        if isinstance(target, typer.Typer):
            app.add_typer(target, name=command.name, help=command.summary, epilog=epilog)
        else:
            app.command(command.name, epilog=epilog)(target)
    return app


DIRECTORY, CPU = "TREADWATCH_COMPILED_DIR", "TREADWATCH_COMPILED_CPU"
PORTABLE = "portable"
GENERIC = ("generic", "")
LEVEL_3 = ("x86-64-v3", "+avx2,+fma,+bmi,+bmi2,+f16c,+lzcnt,+movbe")
"""Name and features, as LLVM takes them, of what servers have had since 2015."""
NEEDED_OF_LEVEL_3 = frozenset({"avx2", "fma", "bmi1", "bmi2", "f16c", "abm", "movbe"})  # as Linux names them
CPU_FACTS = Path("/proc/cpuinfo")


def choose_compiled_code(environment: MutableMapping[str, str], dot_env: Path = Path(".env")) -> None:
    """Say to numba, and to every process that this one starts, where compiled code is and for which CPU."""
    settings = _of_file(dot_env) | dict(environment)
    if settings.get(DIRECTORY):
        environment.setdefault("NUMBA_CACHE_DIR", str(Path(settings[DIRECTORY]).absolute()))
    if settings.get(CPU) == PORTABLE and "NUMBA_CPU_NAME" not in environment:
        environment["NUMBA_CPU_NAME"], environment["NUMBA_CPU_FEATURES"] = portable_cpu()


def portable_cpu(machine: str | None = None, facts: Path = CPU_FACTS) -> tuple[str, str]:
    """Return name and features of the CPU to compile for, so that other machines load the same code."""
    try:
        lines = facts.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    flags = next((line.partition(":")[2].split() for line in lines if line.startswith("flags")), [])
    wide = (machine or platform.machine()) == "x86_64" and set(flags) >= NEEDED_OF_LEVEL_3
    return LEVEL_3 if wide else GENERIC


def _of_file(path: Path) -> dict[str, str]:
    if not path.is_file():
        return {}
    from dotenv import dotenv_values  # noqa: PLC0415 - most starts have no such file

    settings = dotenv_values(path, interpolate=False)
    return {name: value for name in (DIRECTORY, CPU) if (value := settings.get(name))}


def main() -> None:
    """Run the command line; a refusal is one line on standard error and exit code 2.

    Linear algebra runs on one thread unless the environment sets it: the matrices are small, and threads that
    wait for each other on busy cores made the estimation eight times slower.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    choose_compiled_code(os.environ)
    arguments = sys.argv[1:]
    completed = next((os.environ[name].split()[1:] for name in COMPLETED if name in os.environ), [])
    command = _chosen(arguments)
    if command is not None and not set(command.without_gc).isdisjoint(arguments[1:2]):
        gc.disable()
    try:
        build(arguments or completed)(arguments, prog_name="treadwatch")
    except TreadwatchError as error:
        print(f"treadwatch: {error}", file=sys.stderr)  # noqa: T201 - the command line's own output
        raise SystemExit(REFUSED) from None

"""Registry files on the terminal: loaded, checked and exported."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path

import typer

from api.factory import SystemClock, open_store
from api.settings import load_settings
from api.terminal.ingest import registry_lines
from api.terminal.registry import spans_line
from api.terminal.store import reading, user_name, writing
from estimation.errors import InputError, TreadwatchError
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlStorage
from ingest.registry_entry.contents import Entry, RegistryRefusedError, Rule
from ingest.registry_export import write_export
from ingest.registry_file import load_registry

CONTRADICTED = 1
REFUSED = 2


class _NothingStoredError(TreadwatchError):
    """Ends a transaction that only tried something."""


def load_and_report(file: Path, confirmed: Sequence[Rule], actor: str, why: str) -> None:
    """Load a registry file and print what people must know of it; exit 2 with all that is wrong, if anything is."""
    entry = _entry(confirmed, actor or user_name(), why)
    try:
        with writing() as unit:
            loaded = load_registry(file, unit, entry.recorded_ns, entry)
            spans = len(unit.stale_spans.all())
    except RegistryRefusedError as error:
        for line in refusal_lines(error):
            typer.echo(f"treadwatch: {line}", err=True)
        raise typer.Exit(REFUSED) from None
    for line in registry_lines(loaded):
        typer.echo(line)
    typer.echo(f"loaded {file}; {spans_line(spans)}")


def check_and_report(file: Path, confirmed: Sequence[Rule]) -> None:
    """Print all that is wrong with a registry file or contradicts what is on file, and exit 1 if anything is.

    The file is loaded as :func:`load_and_report` does, in a transaction that is rolled back: nothing is stored.
    """
    with closing(open_store(load_settings())) as storage:
        lines = _problems(file, storage, _entry(confirmed, "", ""))
    for line in lines:
        typer.echo(line)
    if lines:
        raise typer.Exit(CONTRADICTED)
    typer.echo(f"{file}: nothing is wrong with it")


def _problems(file: Path, storage: SqlStorage, entry: Entry) -> list[str]:
    try:
        with suppress(_NothingStoredError), storage.write() as unit:
            load_registry(file, unit, entry.recorded_ns, entry)
            _roll_back()
    except RegistryRefusedError as error:
        return refusal_lines(error)
    except InputError as error:
        return [str(error)]
    return []


def _roll_back() -> None:
    """End a transaction without storing anything."""
    raise _NothingStoredError


def export_and_report(file: Path) -> None:
    """Write the registry as a file, and print how much it holds."""
    with reading() as unit:
        found = write_export(file, unit)
    typer.echo(f"wrote {file}: {found.records:,} records, {len(found.files):,} files beside it")


def refusal_lines(error: RegistryRefusedError) -> list[str]:
    """Return everything that is wrong, a line each, in the order of the file."""
    return [str(one.error) for one in error.refusals]


def _entry(confirmed: Sequence[Rule], actor: str, why: str) -> Entry:
    now_ns = SystemClock().now_ns()
    return Entry(Decision(actor, why, now_ns), now_ns, frozenset(confirmed))

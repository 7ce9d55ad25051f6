"""Records of the registry corrected on the terminal, and what was decided on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import typer

from api.factory import SystemClock
from api.terminal.store import reading, user_name, writing
from api.times import from_rfc3339, to_rfc3339
from estimation.errors import InputError, ParameterError, TreadwatchError
from estimation.values.fields import JsonValue
from fleet_db.records import Decision, RecordAction, RecordKind, RegistryEvent
from fleet_db.stores.registry_history import RecordKey
from ingest.registry_entry.contents import Entry, LoadedRegistry, RegistryRefusedError, Rule
from ingest.registry_entry.enter import refuse_contradicted
from ingest.registry_file import load_registry

LONG = ("packed", "parameters", "bogie", "sensors", "relative_std")  # values of a record that are not for reading


def decide_and_report(
    action: RecordAction, kind: RecordKind, subject: str, at: str | None, actor: str, why: str
) -> None:
    """Void or restore a record and print what it is."""
    key = RecordKey(kind, subject, _at(kind, at))
    decision = Decision(actor or user_name(), why, SystemClock().now_ns())
    with writing() as unit:
        decide = unit.corrections.void if action is RecordAction.VOIDED else unit.corrections.restore
        record = decide(key, decision)
        if action is RecordAction.RESTORED:
            refuse_contradicted(unit, key, decision.recorded_ns or 0)
        spans = len(unit.stale_spans.all())
    typer.echo(f"{action} {kind} {subject}: {_text(record)}")
    typer.echo(spans_line(spans))


def history_lines(subject: str | None) -> list[str]:
    """Return what was decided on records, a line each, the oldest first."""
    with reading() as unit:
        return [_line(event) for event in unit.registry_history.list(subject)]


def _at(kind: RecordKind, at: str | None) -> int | None:
    if not kind.dated:
        if at is not None:
            raise ParameterError(f"is no part of a {kind}", field="--at")
        return None
    try:
        return from_rfc3339(at)
    except ValueError as error:
        raise ParameterError(str(error), field="--at") from None


def _line(event: RegistryEvent) -> str:
    when = "" if event.recorded_ns is None else to_rfc3339(event.recorded_ns)
    moment = "" if event.at_ns is None else f" {to_rfc3339(event.at_ns)}"
    who = f" by {event.actor}" if event.actor else ""
    why = f" ({event.reason})" if event.reason else ""
    return f"{when} {event.action} {event.kind} {event.subject}{moment}{who}{why}: {_text(event.record)}"


def _text(record: Mapping[str, JsonValue]) -> str:
    shown = {name: value for name, value in record.items() if name not in LONG and value is not None}
    times = {
        name: to_rfc3339(value) for name, value in shown.items() if name.endswith("_ns") and isinstance(value, int)
    }
    return ", ".join(f"{name.removesuffix('_ns')} {value}" for name, value in (shown | times).items())


def spans_line(spans: int) -> str:
    """Return what follows from stale spans."""
    return f"spans of windows to be assembled again, by an ingest or by the jobs: {spans}"


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


def registry_lines(loaded: LoadedRegistry) -> list[str]:
    """Return what people must know of a registry that was loaded: what is estimated again, and what is not at all."""
    lines = []
    for again in loaded.again:
        whose = ", ".join(again.subjects)
        if again.windows and again.from_ns is not None:
            since = to_rfc3339(again.from_ns)
            sections = f", and the alignment of {', '.join(again.sections)}" if again.sections else ""
            lines.append(f"estimated again: {again.windows:,} windows of {whose} since {since}{sections}")
        elif again.from_ns is not None:
            lines.append(f"estimated again: geometries of {whose}, with other standard deviations")
    for code in sorted({vehicle.vehicle_class for vehicle in loaded.without_class}):
        vehicles = ", ".join(item.code for item in loaded.without_class if item.vehicle_class == code)
        lines.append(f"warning: class {code!r} is not on file: {vehicles} will not be estimated until it is")
    return lines


def check_and_report(file: Path, confirmed: Sequence[Rule]) -> None:
    """Print all that is wrong with a registry file or contradicts what is on file, and exit 1 if anything is.

    The file is loaded as :func:`load_and_report` does, in a transaction that is rolled back: nothing is stored.
    """
    lines: list[str] = []
    entry = _entry(confirmed, "", "")
    try:
        with suppress(_NothingStoredError), writing() as unit:
            load_registry(file, unit, entry.recorded_ns, entry)
            raise _NothingStoredError
    except RegistryRefusedError as error:
        lines = refusal_lines(error)
    except InputError as error:
        lines = [str(error)]
    for line in lines:
        typer.echo(line)
    if lines:
        raise typer.Exit(CONTRADICTED)
    typer.echo(f"{file}: nothing is wrong with it")


def refusal_lines(error: RegistryRefusedError) -> list[str]:
    """Return everything that is wrong, a line each, in the order of the file."""
    return [str(refusal.error) for refusal in error.refusals]


def _entry(confirmed: Sequence[Rule], actor: str, why: str) -> Entry:
    now_ns = SystemClock().now_ns()
    return Entry(Decision(actor, why, now_ns), now_ns, frozenset(confirmed))

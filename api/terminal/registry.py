"""Records of the registry corrected on the terminal, and what was decided on them."""

from __future__ import annotations

from collections.abc import Mapping

import typer

from api.factory import SystemClock
from api.terminal.store import reading, user_name, writing
from api.times import from_rfc3339, to_rfc3339
from estimation.errors import ParameterError
from estimation.values.fields import JsonValue
from fleet_db.registry_events import Decision, RecordAction, RecordKind, RegistryEvent
from fleet_db.stores.registry_history import RecordKey
from ingest.registry_entry.enter import refuse_contradicted

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
    at = "" if event.at_ns is None else f" {to_rfc3339(event.at_ns)}"
    who = f" by {event.actor}" if event.actor else ""
    why = f" ({event.reason})" if event.reason else ""
    return f"{when} {event.action} {event.kind} {event.subject}{at}{who}{why}: {_text(event.record)}"


def _text(record: Mapping[str, JsonValue]) -> str:
    shown = {name: value for name, value in record.items() if name not in LONG and value is not None}
    times = {
        name: to_rfc3339(value) for name, value in shown.items() if name.endswith("_ns") and isinstance(value, int)
    }
    return ", ".join(f"{name.removesuffix('_ns')} {value}" for name, value in (shown | times).items())


def spans_line(spans: int) -> str:
    """Return what follows from stale spans."""
    return f"spans of windows to be assembled again, by an ingest or by the jobs: {spans}"

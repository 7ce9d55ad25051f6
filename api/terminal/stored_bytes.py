"""Where the bytes are, on the terminal: a table, or JSON."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict

import typer

from api.factory import open_store, raw_store, retention_of
from api.settings import load_settings
from fleet_db.keeping.stored_bytes import StoredBytes, StoredKind, stored_bytes

FOR_EVER = "for ever"
UNITS = ("B", "kB", "MB", "GB", "TB", "PB")
THOUSAND = 1000.0


def print_stored_bytes(*, as_json: bool, hours_per_day: float | None) -> None:
    """Print what is stored by kind, most first."""
    settings = load_settings()
    with closing(open_store(settings)) as storage:
        raw = raw_store(settings)
        found = stored_bytes(storage, raw, retention_of(settings), hours_per_day)
    typer.echo(json.dumps(_document(found, raw.url), indent=2) if as_json else _table(found, raw.url))


def _document(found: StoredBytes, raw_url: str) -> dict[str, object]:
    kinds = [{**asdict(kind), "bytes": kind.bytes} for kind in found.kinds]
    year = sum(kind.wheelset_year_bytes or 0 for kind in found.kinds)
    totals = {"total_bytes": found.total, "free_bytes": found.free_bytes, "wheelset_year_bytes": year}
    return {**totals, "raw_store": raw_url, "running": asdict(found.running), "kinds": kinds}


def _table(found: StoredBytes, raw_url: str) -> str:
    running = found.running
    head = (
        f"{running.wheelsets:,} wheelsets of {running.vehicles:,} vehicles have data: {running.wheelset_hours:,.0f} "
        f"hours of wheelsets, {running.hours_per_day:.1f} hours a day lately"
    )
    columns = (
        f"{'kind':22}{'items':>14}{'bytes':>10}{'indexes':>10}{'share':>7}{'a wheelset':>12}{'days':>10}{'a year':>10}"
    )
    lines = [_line(kind, found) for kind in found.kinds if kind.bytes]
    year = sum(kind.wheelset_year_bytes or 0 for kind in found.kinds)
    each = _each(found.total, found)
    total = f"{'sum':36}{size(found.total):>10}{'':>17}{each:>12}{'':>10}{size(year):>10}"
    notes = [
        "a year: what one wheelset keeps of a year at this running and these days",
        "~ sampled, or as the database estimates it",
        f"raw recordings are in {raw_url}",
    ]
    if found.free_bytes:
        notes.append(f"{size(found.free_bytes)} of the database file are free: SQLite uses them again")
    return "\n".join([head, "", columns, *lines, total, "", *notes])


def _line(kind: StoredKind, found: StoredBytes) -> str:
    about = "~" if kind.estimated else ""
    days = FOR_EVER if kind.days is None else f"{kind.days:g}"
    year = "" if kind.wheelset_year_bytes is None else size(kind.wheelset_year_bytes)
    return (
        f"{kind.kind:22}{about + format(kind.items, ','):>14}{about + size(kind.bytes):>10}{size(kind.index_bytes):>10}"
        f"{kind.bytes / max(found.total, 1):>7.1%}{_each(kind.bytes, found):>12}{days:>10}{year:>10}"
    )


def _each(of_all: int, found: StoredBytes) -> str:
    return size(round(of_all / found.running.wheelsets)) if found.running.wheelsets else ""


def size(count: float) -> str:
    """Return a number of bytes with the unit that gives it two or three digits before the point."""
    for unit in UNITS:
        if abs(count) < THOUSAND or unit == UNITS[-1]:
            break
        count /= THOUSAND
    return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"

"""Backup, restore, deep check and purge on the terminal: progress, a summary, an exit code for scripts."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import typer

from api.factory import SystemClock, open_store, raw_store, retention_of
from api.settings import FOR_EVER, load_settings
from api.terminal.progress import counted
from fleet_db.keeping.backup import BackupPlan, back_up
from fleet_db.keeping.checks import check_deep
from fleet_db.keeping.restore import Installation, restore
from fleet_db.keeping.stored_bytes import StoredBytes, StoredKind, stored_bytes

LISTED = 50  # findings that are printed; the rest is counted


def back_up_and_report(folder: Path, *, windows: bool, recordings: bool | None) -> None:
    """Write a backup and print what it holds; exit 1 where files that the database refers to are missing or damaged."""
    settings, plan = load_settings(), BackupPlan(windows, recordings)
    raw = raw_store(settings)
    with closing(open_store(settings)) as storage, counted("backing up files") as progress:
        manifest = back_up(storage, raw, folder, SystemClock().now_ns(), plan=plan, progress=progress)
    typer.echo(
        f"backup {manifest.name}: {sum(manifest.rows.values()):,} rows, {manifest.raw_files:,} recordings, "
        f"{manifest.window_files:,} windows, {manifest.file_bytes:,} bytes of files"
    )
    if not manifest.recordings_kept:
        typer.echo(f"the recordings stay in {raw.url}: the backup holds their digests")
    _list("not in the backup" if manifest.recordings_kept else "missing", manifest.missing)


def restore_and_report(folder: Path, name: str | None) -> None:
    """Restore a backup and print what is there now; exit 1 where files are missing."""
    settings = load_settings()
    with counted("restoring files") as progress:
        into = Installation(settings.url, settings.data_dir, raw_store(settings))
        restored = restore(into, folder, name, progress=progress)
    typer.echo(
        f"restored backup {restored.manifest.name}: {sum(restored.rows.values()):,} rows, {restored.files:,} files"
    )
    if restored.stale_vehicles:
        typer.echo(f"windows are made again by the next ingest or job: {', '.join(restored.stale_vehicles)}")
    _list("could not be restored", restored.missing)


def check_and_report() -> None:
    """Compare everything that is stored and print what does not belong together; exit 1 where something is lost."""
    settings = load_settings()
    raw = raw_store(settings)
    with closing(open_store(settings)) as storage, counted("reading files") as progress:
        check = check_deep(storage, raw, progress)
    harmful = sum(not finding.harmless for finding in check.findings)
    verdict = f"{harmful:,} damaged or lost, {len(check.findings) - harmful:,} files that nothing refers to"
    typer.echo(f"read {check.files:,} files and {check.rows:,} packed values: {verdict}")
    lines = [f"{finding.kind}: {finding.subject}: {finding.detail}" for finding in check.findings]
    for line in lines[:LISTED]:
        typer.echo(line)
    if len(lines) > LISTED:
        typer.echo(f"and {len(lines) - LISTED:,} more")
    if check.damaged:
        raise typer.Exit(1)


def _list(what: str, lines: tuple[str, ...]) -> None:
    for line in lines[:LISTED]:
        typer.echo(f"{what}: {line}")
    if len(lines) > LISTED:
        typer.echo(f"{what}: {len(lines) - LISTED:,} more")
    if lines:
        raise typer.Exit(1)


UNITS = ("B", "kB", "MB", "GB", "TB", "PB")
THOUSAND = 1000.0


def print_stored_bytes(*, as_json: bool, hours_per_day: float | None) -> None:
    """Print what is stored by kind, most first."""
    settings = load_settings()
    with closing(open_store(settings)) as storage:
        raw = raw_store(settings)
        stored = stored_bytes(storage, raw, retention_of(settings), hours_per_day)
    typer.echo(json.dumps(_document(stored, raw.url), indent=2) if as_json else _table(stored, raw.url))


def _document(stored: StoredBytes, raw_url: str) -> dict[str, object]:
    kinds = [{**asdict(kind), "bytes": kind.bytes} for kind in stored.kinds]
    year = sum(kind.wheelset_year_bytes or 0 for kind in stored.kinds)
    totals = {"total_bytes": stored.total, "free_bytes": stored.free_bytes, "wheelset_year_bytes": year}
    return {**totals, "raw_store": raw_url, "running": asdict(stored.running), "kinds": kinds}


def _table(stored: StoredBytes, raw_url: str) -> str:
    running = stored.running
    head = (
        f"{running.wheelsets:,} wheelsets of {running.vehicles:,} vehicles have data: {running.wheelset_hours:,.0f} "
        f"hours of wheelsets, {running.hours_per_day:.1f} hours a day lately"
    )
    columns = (
        f"{'kind':22}{'items':>14}{'bytes':>10}{'indexes':>10}{'share':>7}{'a wheelset':>12}{'days':>10}{'a year':>10}"
    )
    lines = [_line(kind, stored) for kind in stored.kinds if kind.bytes]
    year = sum(kind.wheelset_year_bytes or 0 for kind in stored.kinds)
    each = _each(stored.total, stored)
    total = f"{'sum':36}{size(stored.total):>10}{'':>17}{each:>12}{'':>10}{size(year):>10}"
    notes = [
        "a year: what one wheelset keeps of a year at this running and these days",
        "~ sampled, or as the database estimates it",
        f"raw recordings are in {raw_url}",
    ]
    if stored.free_bytes:
        notes.append(f"{size(stored.free_bytes)} of the database file are free: SQLite uses them again")
    return "\n".join([head, "", columns, *lines, total, "", *notes])


def _line(kind: StoredKind, stored: StoredBytes) -> str:
    about = "~" if kind.estimated else ""
    days = FOR_EVER if kind.days is None else f"{kind.days:g}"
    year = "" if kind.wheelset_year_bytes is None else size(kind.wheelset_year_bytes)
    return (
        f"{kind.kind:22}{about + format(kind.items, ','):>14}{about + size(kind.bytes):>10}{size(kind.index_bytes):>10}"
        f"{kind.bytes / max(stored.total, 1):>7.1%}{_each(kind.bytes, stored):>12}{days:>10}{year:>10}"
    )


def _each(of_all: int, stored: StoredBytes) -> str:
    return size(round(of_all / stored.running.wheelsets)) if stored.running.wheelsets else ""


def size(count: float) -> str:
    """Return a number of bytes with the unit that gives it two or three digits before the point."""
    for unit in UNITS:
        if abs(count) < THOUSAND or unit == UNITS[-1]:
            break
        count /= THOUSAND
    return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"

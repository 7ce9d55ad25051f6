"""Backup, restore, deep check and purge on the terminal: progress, a summary, an exit code for scripts."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import typer

from api.factory import SystemClock, open_store, raw_store, retention_of
from api.progress import counted
from api.settings import load_settings
from fleet_db.keeping.backup import BackupPlan, back_up
from fleet_db.keeping.checks import DeepCheck, check_deep
from fleet_db.keeping.purge import purge
from fleet_db.keeping.restore import Installation, restore

LISTED = 50
"""Findings that are printed; the rest is counted."""


def back_up_and_report(folder: Path, *, windows: bool, recordings: bool | None) -> None:
    """Write a backup and print what it holds.

    Raises:
        typer.Exit: Code 1: files that the database refers to are missing or damaged; they are listed.
    """
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
    """Restore a backup and print what is there now.

    Raises:
        typer.Exit: Code 1: files are missing; they are listed.
    """
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
    """Compare everything that is stored and print what does not belong together.

    Raises:
        typer.Exit: Code 1: something is damaged or lost.
    """
    settings = load_settings()
    raw = raw_store(settings)
    with closing(open_store(settings)) as storage, counted("reading files") as progress:
        found = check_deep(storage, raw, progress)
    typer.echo(f"read {found.files:,} files and {found.rows:,} packed values: {_verdict(found)}")
    lines = [f"{finding.kind}: {finding.subject}: {finding.detail}" for finding in found.findings]
    for line in lines[:LISTED]:
        typer.echo(line)
    if len(lines) > LISTED:
        typer.echo(f"and {len(lines) - LISTED:,} more")
    if found.damaged:
        raise typer.Exit(1)


def purge_and_report() -> None:
    """Delete what has been kept long enough and print how much of each kind."""
    settings = load_settings()
    with closing(open_store(settings)) as storage:
        done = purge(storage, raw_store(settings), retention_of(settings), SystemClock().now_ns(), lambda: None)
    for one in done:
        size = f", {one.item_bytes:,} bytes" if one.item_bytes else ""
        typer.echo(f"{one.kind.value.replace('_', ' ')}: {one.items:,} deleted{size}")


def _verdict(found: DeepCheck) -> str:
    harmful = sum(not finding.harmless for finding in found.findings)
    orphans = len(found.findings) - harmful
    return f"{harmful:,} damaged or lost, {orphans:,} files that nothing refers to"


def _list(what: str, lines: tuple[str, ...]) -> None:
    for line in lines[:LISTED]:
        typer.echo(f"{what}: {line}")
    if len(lines) > LISTED:
        typer.echo(f"{what}: {len(lines) - LISTED:,} more")
    if lines:
        raise typer.Exit(1)

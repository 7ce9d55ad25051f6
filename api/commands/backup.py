"""``treadwatch backup`` and ``treadwatch restore``: database and files, while everything runs, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Folder = Annotated[Path, typer.Argument(help="Folder of the backups; those in it share their files.")]


def backup(
    folder: Folder,
    *,
    windows: Annotated[
        bool, typer.Option(help="Back up the samples of windows, too; they can be made again from the recordings.")
    ] = True,
    recordings: Annotated[
        bool | None,
        typer.Option(help="Back up the raw recordings, too; by default those of a folder, not those of a bucket."),
    ] = None,
) -> None:
    """Back up the database and all files, while services run, and verify what was written."""
    from api.terminal.keeping import back_up_and_report

    back_up_and_report(folder, windows=windows, recordings=recordings)


def restore(
    folder: Folder,
    *,
    name: Annotated[str | None, typer.Option(help="Which backup of the folder; by default the newest.")] = None,
) -> None:
    """Restore a backup into an empty database and the data folder; stop all services first."""
    from api.terminal.keeping import restore_and_report

    restore_and_report(folder, name)

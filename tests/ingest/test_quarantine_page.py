"""The commands of the page on quarantine and recordings, run in their order on a deployment with such recordings."""

from __future__ import annotations

import re
import shlex
from contextlib import closing
from pathlib import Path

from in_process_command import Run as Command
from vehicle_bus import OFFSETS_M, SECOND_NS, START_NS, Run, register

from estimation.values.registry import VehicleRecord
from fleet_db.records import ChunkState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.stores.chunks import ChosenChunks
from ingest.logs import write_blf

PAGE = Path(__file__).parents[2] / "docs" / "quarantine.md"
COMMANDS = re.findall(
    r"^ {4}treadwatch (.+)$|`treadwatch (recordings [\w-]+ 3f2a[^`]*)`", PAGE.read_text(), re.MULTILINE
)

NEED_ONE = ("quarantine list", "recordings retry 3f2a", "recordings retry 3f2a --clock-was-behind")
"""Commands for which something has to be in quarantine."""


def held(treadwatch: Command, folder: Path, number: int, environment: dict[str, str]) -> None:
    """Receive a recording while the folder of the windows cannot be used."""
    path = folder / f"N-7__{number}.blf"
    write_blf(path, Run(seconds=12.0, start_ns=START_NS + 60 * number * SECOND_NS).frames())
    windows = folder / "data" / "windows"
    windows.rename(folder / "away") if windows.exists() else None
    windows.parent.mkdir(exist_ok=True)
    windows.touch()
    done = treadwatch("ingest", path, **environment)
    assert done.returncode == 0, done.stderr
    assert "stored, not decoded yet" in done.stderr
    windows.unlink()
    if (folder / "away").exists():
        (folder / "away").rename(windows)


def test_every_command_of_the_page_does_what_it_says(treadwatch: Command, sqlite_url: str, tmp_path: Path) -> None:
    environment = {"database_url": sqlite_url, "data_dir": str(tmp_path / "data"), "window_length_s": "10"}
    storage = SqlStorage(database_engine(sqlite_url), tmp_path / "data")
    with closing(storage):
        with storage.write() as unit:
            register(unit)
            unit.registry.add_vehicle(VehicleRecord("N-8", "north", "multiple unit", 2, 40.0, OFFSETS_M))
        ran = [_ran(treadwatch, storage, tmp_path, indented or tabled, environment) for indented, tabled in COMMANDS]
        with storage.read() as unit:
            records = unit.chunks.page(ChosenChunks(), 10)
    assert sorted((one.vehicle, one.state) for one in records) == [
        ("N-7", ChunkState.DECODED),
        ("N-7", ChunkState.DECODED),
        ("N-8", ChunkState.DECODED),
    ]
    assert [name.split()[1] for name in ran].count("reassign") == 1
    assert len(ran) == 13


def _ran(treadwatch: Command, storage: SqlStorage, folder: Path, command: str, environment: dict[str, str]) -> str:
    if command in NEED_ONE:
        held(treadwatch, folder, 1 + NEED_ONE.index(command), environment)
    with storage.read() as unit:
        newest = unit.chunks.page(ChosenChunks(), 1)[0].digest[:12]
    done = treadwatch(*shlex.split(command.replace("3f2a", newest)), **environment)
    assert done.returncode == 0, (command, done.stdout, done.stderr)
    shown = {"quarantine list": "waits_for_storage", "recordings list": newest, "recordings show 3f2a": "state"}
    assert shown.get(command, "") in done.stdout
    return command

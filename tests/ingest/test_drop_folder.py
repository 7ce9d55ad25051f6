"""A drop folder: what is complete gets its receipt and is moved; nothing is lost or doubled, whatever ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from api.terminal.ingest import vehicle_in_name
from estimation.errors import ConflictError, PassingFaultError
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.intake.backlog import BacklogLimits, BacklogWatch, Limit
from ingest.intake.drop_folder import DropFolder, DropSettings, held_folder
from ingest.receipts import ChunkStorage

ROOM = BacklogLimits(chunks=100, size_bytes=10_000_000, free_bytes=0)
ROOT = Path(__file__).parents[2]


@dataclass
class Clock:
    """A clock that the test moves."""

    at_s: float = 0.0

    def now_s(self) -> float:
        return self.at_s

    def now_ns(self) -> int:
        return 1_000_000_000 + round(self.at_s * 1e9)


@dataclass
class Dropped:
    """A drop folder over a storage of the test's own."""

    storage: SqlStorage
    folder: Path
    limits: BacklogLimits = ROOM
    clock: Clock = field(default_factory=Clock)

    @property
    def raw(self) -> FileRawStore:
        return FileRawStore(self.storage.data_dir / "raw")

    def watched(self) -> DropFolder:
        settings = DropSettings(self.folder, quiet_s=5.0, most_bytes=1000, vehicle_of=vehicle_in_name)
        watch = BacklogWatch(self.storage, self.raw.directory, self.limits, self.clock.now_s)
        return DropFolder(settings, self.raw, ChunkStorage(self.storage, self.raw, self.clock), watch, self.clock.now_s)

    def put(self, name: str, content: bytes) -> Path:
        path = self.folder / name
        path.write_bytes(content)
        return path

    def files(self, folder: str = ".") -> list[str]:
        return sorted(path.name for path in (self.folder / folder).iterdir() if path.is_file())

    def stored(self) -> dict[str | None, str]:
        with self.storage.read() as unit:
            return {record.file_name: record.vehicle for record in unit.chunks.with_state(ChunkState.STORED)}


@pytest.fixture
def dropped(storage: SqlStorage, tmp_path: Path) -> Dropped:
    folder = tmp_path / "drop"
    folder.mkdir()
    return Dropped(storage, folder)


def test_a_file_is_taken_once_it_has_not_changed_for_a_while(dropped: Dropped) -> None:
    watched = dropped.watched()
    path = dropped.put("V-1__1.blf", b"half")
    assert (watched.look().incomplete, dropped.stored()) == (1, {})
    dropped.clock.at_s = 4.0
    path.write_bytes(b"half and the other half")
    assert watched.look().incomplete == 1
    dropped.clock.at_s = 8.9
    assert watched.look().incomplete == 1
    dropped.clock.at_s = 9.0
    look = watched.look()
    assert (look.stored, look.known, look.refused, look.incomplete) == (1, 0, (), 0)
    assert dropped.stored() == {"V-1__1.blf": "V-1"}
    assert (dropped.files(), dropped.files("done")) == ([], ["V-1__1.blf"])
    with dropped.storage.read() as unit:
        (record,) = unit.chunks.undecoded(10)
    assert dropped.raw.path(record.digest, ".blf").read_bytes() == b"half and the other half"
    assert record.sender == "folder drop"


def test_what_cannot_be_taken_is_moved_aside_with_its_reason(dropped: Dropped) -> None:
    watched = dropped.watched()
    for name, content in {
        "V-1__large.blf": b"x" * 1001,
        "V-1__empty.blf": b"",
        "nobody.blf": b"1",
        "V-1__1.pdf": b"2",
        "V-1__2.blf": b"3",
        "V-2__2.blf": b"3",  # the same bytes of another vehicle
        ".hidden.blf": b"4",
        "V-1__3.blf.part": b"5",
    }.items():
        dropped.put(name, content)
    (dropped.folder / "V-1__link.blf").symlink_to(dropped.folder / ".hidden.blf")
    watched.look()
    dropped.clock.at_s = 5.0
    look = watched.look()
    assert look.stored == 1
    assert len(look.refused) == 5
    aside = dropped.files("refused")
    for name, why in {
        "V-1__large.blf": "is larger than 1,000 bytes",
        "V-1__empty.blf": "is empty",
        "nobody.blf": "does not name its vehicle",
        "V-1__1.pdf": "is no log file",
    }.items():
        assert name in aside
        assert why in (dropped.folder / "refused" / f"{name}.reason.txt").read_text()
    assert len(dropped.stored()) == 1
    assert dropped.files() == sorted([".hidden.blf", "V-1__3.blf.part", "V-1__link.blf"])


def test_files_wait_in_the_folder_while_too_much_waits_to_be_decoded(storage: SqlStorage, tmp_path: Path) -> None:
    folder = tmp_path / "drop"
    folder.mkdir()
    dropped = Dropped(storage, folder, BacklogLimits(chunks=2, size_bytes=10_000_000, free_bytes=0))
    watched = dropped.watched()
    for number in range(4):
        dropped.put(f"V-1__{number}.blf", bytes([number]))
    watched.look()
    dropped.clock.at_s = 5.0
    look = watched.look()
    assert look.behind is not None
    assert (look.stored, look.behind.limit, len(dropped.files())) == (2, Limit.CHUNKS, 2)
    with storage.write() as unit:
        for record in unit.chunks.undecoded(10):
            unit.chunks.update(replace(record, reason=None))
    dropped.clock.at_s = 6.0
    assert (watched.look().stored, dropped.files()) == (2, [])


def test_a_file_that_was_stored_and_not_moved_is_moved_by_the_next_start(
    dropped: Dropped, monkeypatch: pytest.MonkeyPatch
) -> None:
    dropped.put("V-1__1.blf", b"content")
    watched = dropped.watched()
    watched.look()
    dropped.clock.at_s = 5.0
    with monkeypatch.context() as patch:
        patch.setattr(DropFolder, "_move", lambda *_: (_ for _ in ()).throw(PassingFaultError("killed")))
        with pytest.raises(PassingFaultError, match="killed"):
            watched.look()
    assert (dropped.files(), list(dropped.stored())) == (["V-1__1.blf"], ["V-1__1.blf"])
    again = dropped.watched()
    again.look()
    dropped.clock.at_s = 10.0
    look = again.look()
    assert (look.stored, look.known, dropped.files(), dropped.files("done")) == (0, 1, [], ["V-1__1.blf"])
    assert len(dropped.stored()) == 1
    assert not list(dropped.raw.directory.glob(".incoming-*"))


def test_one_process_watches_a_folder(tmp_path: Path) -> None:
    with held_folder(tmp_path), pytest.raises(ConflictError, match="another process"), held_folder(tmp_path):
        pass
    with held_folder(tmp_path):
        pass


@pytest.mark.slow
def test_a_watcher_that_is_killed_again_and_again_loses_and_doubles_nothing(
    sqlite_storage: SqlStorage, sqlite_url: str, tmp_path: Path
) -> None:
    folder = tmp_path / "drop"
    folder.mkdir()
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "TREADWATCH_DATABASE_URL": sqlite_url,
        "TREADWATCH_DATA_DIR": str(sqlite_storage.data_dir),
    }
    command = [sys.executable, "-c", "from api.cli import main; main()", "chunk", "drop", str(folder), "--quiet-s", "0"]
    contents = {f"V-1__{number:03}.blf": bytes([number]) * 100_000 for number in range(120)}
    for name, content in contents.items():
        (folder / f".{name}").write_bytes(content)
        (folder / f".{name}").rename(folder / name)
    killed = 0
    for _ in range(2):
        process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
        before = moved(folder)
        until = time.monotonic() + 90.0
        while moved(folder) < before + 17 and process.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.wait(120)
        killed += moved(folder) < len(contents)
    assert killed >= 1
    subprocess.run([*command, "--once"], env=environment, check=True, timeout=120)
    done = {path.name: path.read_bytes() for path in (folder / "done").iterdir()}
    assert done == contents
    with sqlite_storage.read() as unit:
        records = unit.chunks.with_state(ChunkState.STORED, 1000)
    assert sorted(str(record.file_name) for record in records) == sorted(contents)
    raw = FileRawStore(sqlite_storage.data_dir / "raw")
    assert all(raw.fault(record.digest, record.suffix) is None for record in records)


def moved(folder: Path) -> int:
    return len(list((folder / "done").iterdir())) if (folder / "done").is_dir() else 0

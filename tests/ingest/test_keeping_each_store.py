"""Recordings in files and in a bucket are deleted, purged, measured, backed up and restored alike."""

from __future__ import annotations

import os
import uuid
from pathlib import Path

import pytest
from each_store import RUN, decode, digests, hand_in, quietly, recordings
from raw_stores import Behind, in_bucket, in_files
from test_receiver import CountingClock
from vehicle_bus import register

from estimation.errors import PassingFaultError
from estimation.values.units import DAY_NS
from fleet_db.keeping.backup import BackupPlan, back_up
from fleet_db.keeping.checks import check_deep
from fleet_db.keeping.kept_files import orphaned_recordings
from fleet_db.keeping.purge import purge
from fleet_db.keeping.restore import Installation, restore
from fleet_db.keeping.retention import Kept, Retention
from fleet_db.keeping.stored_bytes import stored_bytes
from fleet_db.raw import MARK_NAME, PREFIX, check_raw_store
from fleet_db.storage import SqlStorage
from ingest.corrections import Author, RecordingCorrections


@pytest.fixture
def registered(sqlite_storage: SqlStorage) -> SqlStorage:
    with sqlite_storage.write() as unit:
        register(unit)
    return sqlite_storage


def test_a_recording_that_is_deleted_is_gone(registered: SqlStorage, raw_behind: Behind, tmp_path: Path) -> None:
    raw = raw_behind.store
    first, *others = (one.record.digest for one in hand_in(registered, raw, recordings(tmp_path)))
    corrections = RecordingCorrections(registered, CountingClock())
    corrections.delete(first, Author("j.smith", "of a test bench"), raw)
    assert [raw_behind.content(digest, ".blf") is None for digest in (first, *others)] == [True, False, False]
    assert check_deep(registered, raw, quietly).findings == ()


def test_a_purge_removes_old_recordings_and_what_killed_processes_left(
    registered: SqlStorage, raw_behind: Behind, tmp_path: Path
) -> None:
    raw = raw_behind.store
    first, *_ = (one.record.digest for one in hand_in(registered, raw, recordings(tmp_path)))
    decode(registered, raw)
    newer = raw.put_bytes(b"of a newer database", ".blf")
    assert {one.digest for one in orphaned_recordings(registered, raw, -60.0)} == {newer}
    assert orphaned_recordings(registered, raw) == [], "it is young"
    nothing: dict[str, float | None] = dict.fromkeys((kind.value for kind in Kept), None)
    (done,) = purge(registered, raw, Retention(**(nothing | {"recordings": 31.0})), RUN.start_ns + 99 * DAY_NS, quiet)
    assert done.items == 0, "the newest data are less than 31 days old"
    left = raw.receiving / f"{PREFIX}of-a-killed-process.blf"
    raw.receiving.mkdir(exist_ok=True)
    left.write_bytes(b"part")
    os.utime(left, (1e9, 1e9))
    (done,) = purge(registered, raw, Retention(**(nothing | {"orphaned_files": 1.0})), RUN.start_ns, quiet)
    assert (done.items, done.item_bytes, raw_behind.left()) == (1, 4, [])
    with registered.write() as unit:
        unit.chunks.purge(1 << 62, 5, 1000)
    assert {one.digest for one in orphaned_recordings(registered, raw, -60.0)} == {newer, *digests(registered)}
    assert first in digests(registered)


def quiet() -> None:
    """Go on."""


def test_where_the_bytes_are(registered: SqlStorage, raw_behind: Behind, tmp_path: Path) -> None:
    hand_in(registered, raw_behind.store, paths := recordings(tmp_path))
    kinds = {one.kind: one for one in stored_bytes(registered, raw_behind.store, Retention()).kinds}
    found = kinds["raw recordings"]
    assert (found.items, found.bytes) == (3, sum(path.stat().st_size for path in paths))


def test_a_store_of_another_database_is_refused(registered: SqlStorage, raw_behind: Behind, tmp_path: Path) -> None:
    raw = raw_behind.store
    for one in hand_in(registered, raw, recordings(tmp_path)):
        raw.remove(one.record.digest, ".blf")
    ours = raw.read_mark()
    assert check_raw_store(registered, raw, 1) == ours
    raw.write_mark("of another")
    with pytest.raises(PassingFaultError, match="holds no recording of this database and not its mark") as caught:
        hand_in(registered, raw, recordings(tmp_path))
    assert caught.value.file == raw.url
    assert raw_behind.names() == [MARK_NAME]


@pytest.mark.parametrize("into", ["files", "s3"])
@pytest.mark.parametrize("copied", [True, False])
def test_a_backup_of_either_becomes_either(
    registered: SqlStorage,
    raw_behind: Behind,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    into: str,
    *,
    copied: bool,
) -> None:
    raw = raw_behind.store
    hand_in(registered, raw, recordings(tmp_path))
    decode(registered, raw)
    folder = tmp_path / "backups"
    manifest = back_up(registered, raw, folder, 1, plan=BackupPlan(recordings=copied), progress=quietly)
    assert (manifest.raw_files, manifest.recordings_kept, manifest.raw_store) == (3, copied, raw.url)
    assert (manifest.missing, (folder / "raw").is_dir()) == ((), copied)
    if not copied:
        lines = (folder / f"recordings-{manifest.name}.sha256").read_text().splitlines()
        assert sorted(lines) == lines == [f"{name[3:67]}  {name}" for name in raw_behind.names() if name != MARK_NAME]
    data = tmp_path / "restored"
    server = request.getfixturevalue("s3_server") if into == "s3" else None
    target = in_files(data) if server is None else in_bucket(server, uuid.uuid4().hex, data)
    url = f"sqlite:///{data / 'treadwatch.sqlite'}"
    restored = restore(Installation(url, data, target.store), folder, progress=quietly)
    assert len(restored.missing) == (0 if copied else 3)
    assert target.names() == ([name for name in raw_behind.names() if name != MARK_NAME] if copied else [])


def test_a_backup_that_copies_nothing_says_what_is_missing(
    registered: SqlStorage, raw_behind: Behind, tmp_path: Path
) -> None:
    raw = raw_behind.store
    first, second, _ = (one.record.digest for one in hand_in(registered, raw, recordings(tmp_path)))
    raw.remove(first, ".blf")
    raw_behind.write(second, ".blf", b"short")
    manifest = back_up(registered, raw, tmp_path / "b", 1, plan=BackupPlan(recordings=False), progress=quietly)
    assert {line.rpartition(" (")[0] for line in manifest.missing} == {
        f"{raw.place(first, '.blf')} is missing",
        f"{raw.place(second, '.blf')} has 5 bytes, not {size_of(registered, second)}",
    }


def size_of(storage: SqlStorage, digest: str) -> int:
    with storage.read() as unit:
        found = unit.chunks.get(digest)
    assert found is not None
    return found.size_bytes

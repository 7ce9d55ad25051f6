"""A scrub reads every raw file again: damaged and missing ones are marked, and the mark goes when they are whole."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace

import pytest

from estimation.errors import PassingFaultError
from estimation.values.runs import QuarantineState, SubjectKind
from fleet_db.keeping import checks
from fleet_db.keeping.checks import STAGE, ScrubFault, ScrubPlan, scrub
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkRecord, ChunkState, RawScrub
from fleet_db.storage import SqlStorage

WHOLE = ScrubPlan()


def raw_of(storage: SqlStorage) -> FileRawStore:
    return FileRawStore(storage.data_dir / "raw")


def store(storage: SqlStorage, count: int) -> list[str]:
    """Store recordings with their receipts; return their digests in order."""
    digests = []
    for number in range(count):
        content = bytes([number]) * 1000
        digest = raw_of(storage).put_bytes(content, ".blf")
        record = ChunkRecord(digest, "V-1", ".blf", 1000, ChunkState.STORED, None, None, None, 0, {}, 1, 1)
        with storage.write() as unit:
            unit.chunks.put(record)
        digests.append(digest)
    return sorted(digests)


def run(
    storage: SqlStorage, plan: ScrubPlan = WHOLE, stop_after: int | None = None
) -> tuple[RawScrub | None, list[str], list[int]]:
    """Scrub; return how it ended (None where it was stopped), the damaged digests, and the files done."""
    faults: list[ScrubFault] = []
    done: list[int] = []
    clock = itertools.count(100)

    def progress(files: int, _total: int) -> None:
        done.append(files)
        if files == stop_after:
            raise KeyboardInterrupt

    try:
        ended = scrub(storage, raw_of(storage), plan, lambda: next(clock), faults.append, progress)
    except KeyboardInterrupt:
        return None, [one.file.digest for one in faults], done
    return ended, [one.file.digest for one in faults], done


def held(storage: SqlStorage) -> list[str]:
    with storage.read() as unit:
        return sorted(item.key for item in unit.quarantine.held(STAGE))


def test_damaged_and_missing_files_are_marked_until_they_are_whole(storage: SqlStorage) -> None:
    digests = store(storage, 5)
    raw = raw_of(storage)
    damaged, missing = digests[1], digests[3]
    content = raw.path(damaged, ".blf").read_bytes()
    raw.path(damaged, ".blf").write_bytes(content[:-1] + b"!")  # as many bytes
    gone = raw.path(missing, ".blf").read_bytes()
    raw.path(missing, ".blf").unlink()
    ended, faults, _ = run(storage)
    assert ended is not None
    assert (ended.files, ended.file_bytes, ended.faults, ended.finished_ns is None) == (5, 5000, 2, False)
    assert faults == held(storage) == [damaged, missing]
    with storage.read() as unit:
        item = unit.quarantine.get(SubjectKind.RECORDING, damaged, STAGE)
        assert item is not None
        assert "another digest" in item.error
    raw.path(damaged, ".blf").write_bytes(content)
    raw.put_bytes(gone, ".blf")
    ended, faults, _ = run(storage)
    assert (faults, held(storage)) == ([], [])
    with storage.read() as unit:
        item = unit.quarantine.get(SubjectKind.RECORDING, damaged, STAGE)
        assert item is not None
        assert item.state is QuarantineState.RESOLVED


def test_files_that_were_purged_or_deleted_are_not_looked_for(storage: SqlStorage) -> None:
    digests = store(storage, 3)
    with storage.write() as unit:
        for digest, change in ((digests[0], {"purged_ns": 9}), (digests[1], {"state": ChunkState.DELETED})):
            record = unit.chunks.get(digest)
            assert record is not None
            unit.chunks.update(replace(record, **change))  # type: ignore[arg-type]
            raw_of(storage).remove(digest, ".blf")
    ended, faults, _ = run(storage)
    assert ended is not None
    assert (ended.files, faults) == (1, [])


def test_an_interrupted_scrub_goes_on_and_reads_no_file_twice_that_it_had_noted(
    storage: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "FILES_AT_ONCE", 2)
    digests = store(storage, 7)
    raw_of(storage).path(digests[0], ".blf").unlink()
    assert run(storage, stop_after=5) == (None, [digests[0]], [1, 2, 3, 4, 5])
    ended, faults, done = run(storage)
    assert ended is not None
    assert (ended.files, ended.faults, faults, done) == (7, 1, [], [5, 6, 7])
    ended, faults, done = run(storage)  # the next one begins again
    assert (faults, done) == ([digests[0]], [1, 2, 3, 4, 5, 6, 7])
    run(storage, stop_after=4)
    _, _, done = run(storage, ScrubPlan(resume=False))
    assert done[0] == 1


def test_a_scrub_keeps_to_its_rate(sqlite_storage: SqlStorage) -> None:
    store(sqlite_storage, 4)
    waits: list[float] = []
    plan = ScrubPlan(bytes_per_s=500.0)
    scrub(sqlite_storage, raw_of(sqlite_storage), plan, lambda: 1, lambda _: None, lambda *_: None, waits.append)
    assert waits == pytest.approx([2.0, 4.0, 6.0, 8.0], abs=1.0)  # nobody waits here, so each is behind the begin


def test_a_folder_that_is_not_mounted_marks_nothing(sqlite_storage: SqlStorage) -> None:
    store(sqlite_storage, 2)
    run(sqlite_storage)
    raw = raw_of(sqlite_storage)
    raw.directory.rename(raw.directory.with_name("elsewhere"))
    raw.directory.mkdir()
    with pytest.raises(PassingFaultError, match="is it mounted"):
        run(sqlite_storage)
    assert held(sqlite_storage) == []


def test_the_measure_of_files_is_whole(sqlite_storage: SqlStorage) -> None:
    digests: Iterable[str] = store(sqlite_storage, 3)
    with sqlite_storage.read() as unit:
        assert [file.digest for file in unit.raw_scrubs.files_after("", 10)] == list(digests)
        assert unit.raw_scrubs.count_after(min(digests)) == 2
        assert unit.raw_scrubs.last() is None

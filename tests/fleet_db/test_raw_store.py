"""What holds for every store of raw recordings: files in a folder, and objects in a bucket."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest
from raw_stores import Behind
from scipy.stats import uniform

from estimation.errors import InputError, ParameterError, PassingFaultError
from fleet_db.raw import MARK_NAME, PREFIX, LostRecordingError, RawItem, RawTotal
from fleet_db.s3_bucket import PART_BYTES

LARGE = uniform.rvs(size=2 * PART_BYTES // 8 + 12_345, random_state=1).tobytes()
"""Of more than two parts."""


def digest_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def test_bytes_and_file_get_the_same_place(raw_behind: Behind, tmp_path: Path) -> None:
    content = b"frames" * 300_000
    source = tmp_path / "drive.BLF"
    source.write_bytes(content)
    raw = raw_behind.store
    digest = raw.put_bytes(content, ".blf")
    assert digest == digest_of(content)
    assert raw.put_file(source) == digest
    assert raw_behind.content(digest, ".blf") == content
    assert raw_behind.names() == [f"{digest[:2]}/{digest}.blf"]
    assert source.read_bytes() == content
    assert (raw.size(digest, ".blf"), raw.holds(digest, ".blf"), raw.holds("0" * 64, ".blf")) == (
        1_800_000,
        True,
        False,
    )
    assert raw_behind.left() == []


def test_a_large_recording_is_put_and_read_in_parts(raw_behind: Behind) -> None:
    raw = raw_behind.store
    digest = raw.put_bytes(LARGE, ".blf")
    assert raw_behind.content(digest, ".blf") == LARGE
    assert raw.fault(digest, ".blf", len(LARGE)) is None
    with raw.whole(digest, ".blf", len(LARGE)) as path:
        assert path.read_bytes() == LARGE


def test_the_bytes_of_a_file_that_was_put_are_there_to_be_read(raw_behind: Behind, tmp_path: Path) -> None:
    source = tmp_path / "drive.asc"
    source.write_bytes(b"frames")
    with raw_behind.store.taken_in(source) as (digest, path):
        source.write_bytes(b"changed meanwhile")
        assert (digest, path.suffix, path.read_bytes()) == (digest_of(b"frames"), ".asc", b"frames")
    assert raw_behind.left() == []


def test_many_at_once_are_all_there(raw_behind: Behind) -> None:
    contents = [bytes([number]) * 1000 for number in range(20)]
    with ExitStack() as stack:
        files = []
        for content in (*contents, contents[0]):  # one of them twice
            file = stack.enter_context(raw_behind.store.incoming(".blf"))
            file.write(content)
            file.finish()
            files.append(file)
        raw_behind.store.put(files)
        assert all(raw_behind.content(digest_of(content), ".blf") == content for content in contents)
    assert len(raw_behind.names()) == 20
    assert raw_behind.left() == []


def test_the_same_again_changes_nothing(raw_behind: Behind) -> None:
    digest = raw_behind.store.put_bytes(b"once", ".asc")
    before = raw_behind.version(digest, ".asc")
    time.sleep(1.1)  # stores say when an object was written to the second
    raw_behind.store.put_bytes(b"once", ".asc")
    assert raw_behind.version(digest, ".asc") == before


@pytest.mark.parametrize("damage", [b"who", b"whale", b""])
def test_a_damaged_recording_is_found_and_written_again(raw_behind: Behind, damage: bytes) -> None:
    raw = raw_behind.store
    digest = raw.put_bytes(b"whole", ".log")
    raw_behind.write(digest, ".log", damage)
    fault = raw.fault(digest, ".log")
    assert fault is not None
    assert (fault.reason, fault.file) == ("is damaged: its content has another digest", raw.place(digest, ".log"))
    if len(damage) < 5:
        fault = raw.fault(digest, ".log", 5)
        assert fault is not None
        assert fault.reason == f"has {len(damage)} bytes, not 5"
    assert raw.lost(digest, ".log")
    with pytest.raises(LostRecordingError), raw.whole(digest, ".log", 5):
        pass
    assert raw_behind.left() == []
    raw.put_bytes(b"whole", ".log")
    assert raw_behind.content(digest, ".log") == b"whole"
    assert not raw.lost(digest, ".log")


def test_a_recording_that_is_gone_is_missing_until_it_is_put_again(raw_behind: Behind) -> None:
    raw = raw_behind.store
    raw.put_bytes(b"another", ".log")
    digest = raw.put_bytes(b"whole", ".log")
    raw.remove(digest, ".log")
    raw.remove(digest, ".log")  # nothing is there any more
    fault = raw.fault(digest, ".log")
    assert fault is not None
    assert fault.reason == "is missing"
    assert raw.lost(digest, ".log")
    with pytest.raises(PassingFaultError):
        raw.size(digest, ".log")
    raw.put_bytes(b"whole", ".log")
    assert raw.fault(digest, ".log") is None


@pytest.mark.parametrize("make_source", [lambda path: path / "nothing.blf", lambda path: path])
def test_a_source_that_cannot_be_read_is_named_and_leaves_nothing(
    raw_behind: Behind, tmp_path: Path, make_source: Callable[[Path], Path]
) -> None:
    source = make_source(tmp_path)
    with pytest.raises(InputError, match="cannot be read") as caught:
        raw_behind.store.put_file(source)
    assert caught.value.file == str(source)
    assert (raw_behind.names(), raw_behind.left()) == ([], [])


def test_what_is_not_admitted_leaves_nothing(raw_behind: Behind, tmp_path: Path) -> None:
    def refuse(digest: str) -> None:
        raise InputError(f"{digest} was deleted")

    source = tmp_path / "drive.blf"
    source.write_bytes(b"deleted before")
    refused = pytest.raises(InputError, match=digest_of(b"deleted before"))
    with refused, raw_behind.store.taken_in(source, refuse):
        pass
    assert (raw_behind.names(), raw_behind.left()) == ([], [])


@pytest.mark.parametrize(
    ("digest", "suffix"), [("../../etc/passwd", ".blf"), ("A" * 64, ".blf"), ("a" * 64, "/x"), ("a" * 64, ".")]
)
def test_a_name_cannot_lead_elsewhere(raw_behind: Behind, digest: str, suffix: str) -> None:
    raw = raw_behind.store
    for use in (raw.place, raw.size, raw.check, raw.remove, raw.holds):
        with pytest.raises(ParameterError):
            use(digest, suffix)


def test_the_mark_is_kept_and_is_no_recording(raw_behind: Behind) -> None:
    raw = raw_behind.store
    raw.put_bytes(b"one", ".blf")
    assert raw.read_mark() is None
    raw.write_mark("f00d")
    assert raw.read_mark() == "f00d"
    assert MARK_NAME in raw_behind.names()
    assert [item.digest for item in raw.listed()] == [digest_of(b"one")]
    assert raw.total(10) == RawTotal(1, 3, estimated=False)


def test_what_is_listed_and_old_is_removed_unless_it_is_written_again(raw_behind: Behind) -> None:
    raw = raw_behind.store
    digest = raw.put_bytes(b"listed", ".blf")
    raw.receiving.mkdir(exist_ok=True)
    left = raw.receiving / f"{PREFIX}of-a-killed-process.blf"
    left.write_bytes(b"part")
    os.utime(left, (1e9, 1e9))
    found = {item.digest: item for item in raw.listed()}
    assert {name: item.size_bytes for name, item in found.items()} == {digest: 6, "": 4}
    assert found[digest].place == raw.place(digest, ".blf")
    assert found[""] == RawItem(str(left), "", 4, 1e9)
    assert abs(found[digest].changed_s - time.time()) < 60.0
    assert raw.remove_old(found[digest], 3600.0) is None
    assert raw.remove_old(found[digest], -60.0) == 6
    assert raw.remove_old(found[digest], -60.0) is None
    assert raw.remove_old(found[""], 3600.0) == 4
    assert raw.remove_old(replace(found[""], size_bytes=9), 3600.0) is None
    assert (raw_behind.names(), raw_behind.left()) == ([], [])


def test_of_many_a_part_says_how_much_there_is(raw_behind: Behind) -> None:
    for number in range(16):  # names spread evenly, as digests do
        raw_behind.write(f"{16 * number + 15:02x}{'f' * 62}", ".blf", b"x" * 100)
    assert raw_behind.store.total(17) == RawTotal(16, 1600, estimated=False)
    assert raw_behind.store.total(4) == RawTotal(16, 1600, estimated=True)


def test_two_that_put_the_same_at_once_both_succeed(raw_behind: Behind) -> None:
    content = b"the same" * 100_000
    with ThreadPoolExecutor(8) as senders:
        digests = set(senders.map(lambda _: raw_behind.store.put_bytes(content, ".blf"), range(16)))
    assert digests == {digest_of(content)}
    assert raw_behind.content(digest_of(content), ".blf") == content
    assert (len(raw_behind.names()), raw_behind.left()) == (1, [])

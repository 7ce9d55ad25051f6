"""Raw recordings under the digest of their bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from estimation.errors import InputError, ParameterError
from fleet_db.raw import RawStore


@pytest.fixture
def raw(tmp_path: Path) -> RawStore:
    return RawStore(tmp_path / "raw")


def files_in(raw: RawStore) -> list[str]:
    return sorted(path.relative_to(raw.directory).as_posix() for path in raw.directory.rglob("*") if path.is_file())


def test_bytes_and_file_get_the_same_place(raw: RawStore, tmp_path: Path) -> None:
    content = b"frames" * 300_000
    source = tmp_path / "drive.BLF"
    source.write_bytes(content)
    digest = raw.put_bytes(content, ".blf")
    assert digest == hashlib.sha256(content).hexdigest()
    assert raw.put_file(source) == digest
    assert raw.path(digest, ".blf").read_bytes() == content
    assert files_in(raw) == [f"{digest[:2]}/{digest}.blf"]
    assert source.read_bytes() == content


def test_the_same_again_changes_nothing(raw: RawStore) -> None:
    path = raw.path(raw.put_bytes(b"once", ".asc"), ".asc")
    before = path.stat()
    raw.put_bytes(b"once", ".asc")
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_a_file_cut_by_a_loss_of_power_is_written_again(raw: RawStore) -> None:
    path = raw.path(raw.put_bytes(b"whole", ".log"), ".log")
    path.write_bytes(b"who")
    raw.put_bytes(b"whole", ".log")
    assert path.read_bytes() == b"whole"


@pytest.mark.parametrize("make_source", [lambda path: path / "nothing.blf", lambda path: path])
def test_a_source_that_cannot_be_read_is_named_and_leaves_nothing(
    raw: RawStore, tmp_path: Path, make_source: Callable[[Path], Path]
) -> None:
    source = make_source(tmp_path)
    with pytest.raises(InputError, match="cannot be read") as caught:
        raw.put_file(source)
    assert caught.value.file == str(source)
    assert files_in(raw) == []


@pytest.mark.parametrize(
    ("digest", "suffix"), [("../../etc/passwd", ".blf"), ("A" * 64, ".blf"), ("a" * 64, "/x"), ("a" * 64, ".")]
)
def test_a_path_cannot_lead_elsewhere(raw: RawStore, digest: str, suffix: str) -> None:
    with pytest.raises(ParameterError):
        raw.path(digest, suffix)

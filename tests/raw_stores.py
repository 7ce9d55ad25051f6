"""Stores of raw recordings for tests that hold for each of them, with what happens behind their backs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from obstore.store import S3Store
from s3_server import ACCESS_KEY, BUCKET, SECRET_KEY, S3Server

from fleet_db.raw import FileRawStore, RawStore, recording_name
from fleet_db.raw_s3 import S3RawStore
from fleet_db.s3_bucket import S3Bucket, S3Place

KEYS = {"access_key_id": ACCESS_KEY, "secret_access_key": SECRET_KEY}


@dataclass(frozen=True)
class Behind(ABC):
    """A store, and what a test does to it that no process of ours does."""

    store: RawStore

    @abstractmethod
    def content(self, digest: str, suffix: str) -> bytes | None: ...

    @abstractmethod
    def write(self, digest: str, suffix: str, content: bytes) -> None: ...

    @abstractmethod
    def names(self) -> list[str]: ...

    @abstractmethod
    def version(self, digest: str, suffix: str) -> object:
        """Return what changes when a recording is written again."""

    def left(self) -> list[str]:
        """Return the names of files of this machine that are no recordings."""
        return sorted(path.name for path in self.store.receiving.rglob(".*"))


@dataclass(frozen=True)
class BehindFiles(Behind):
    """Of a folder."""

    directory: Path

    def content(self, digest: str, suffix: str) -> bytes | None:
        path = self.directory / recording_name(digest, suffix)
        return path.read_bytes() if path.is_file() else None

    def write(self, digest: str, suffix: str, content: bytes) -> None:
        path = self.directory / recording_name(digest, suffix)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)

    def names(self) -> list[str]:
        found = (path for path in self.directory.rglob("*") if path.is_file() and not path.name.startswith("."))
        return sorted(path.relative_to(self.directory).as_posix() for path in found)

    def version(self, digest: str, suffix: str) -> object:
        status = (self.directory / recording_name(digest, suffix)).stat()
        return status.st_ino, status.st_mtime_ns


@dataclass(frozen=True)
class BehindBucket(Behind):
    """Of a bucket."""

    objects: S3Store

    def content(self, digest: str, suffix: str) -> bytes | None:
        try:
            return bytes(self.objects.get(recording_name(digest, suffix)).bytes())
        except FileNotFoundError:
            return None

    def write(self, digest: str, suffix: str, content: bytes) -> None:
        self.objects.put(recording_name(digest, suffix), content)

    def names(self) -> list[str]:
        return sorted(meta["path"] for page in self.objects.list() for meta in page)

    def version(self, digest: str, suffix: str) -> object:
        meta = self.objects.head(recording_name(digest, suffix))
        return meta["e_tag"], meta["last_modified"]


def in_files(folder: Path) -> BehindFiles:
    """Return a store of files."""
    directory = folder / "raw"
    return BehindFiles(FileRawStore(directory), directory)


def in_bucket(server: S3Server, prefix: str, folder: Path, **changed: object) -> BehindBucket:
    """Return a store of objects below a prefix of a server."""
    given: dict[str, object] = {
        "bucket": BUCKET,
        "prefix": prefix,
        "endpoint": server.endpoint,
        "region": "us-east-1",
        "allow_http": True,
        "timeout_s": 20.0,
        "keys": KEYS,
    }
    place = S3Place(**(given | changed))  # type: ignore[arg-type]
    return BehindBucket(S3RawStore(S3Bucket(place), folder / "receiving"), server.objects(prefix))

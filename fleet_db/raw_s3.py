"""Raw recordings as objects of a bucket: put, read back and compared before they are reported as stored."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from estimation.errors import PassingFaultError
from fleet_db.atomic_files import passing_faults, unlink_old
from fleet_db.raw import (
    DAMAGED,
    MARK_NAME,
    MISSING,
    PREFIX,
    IncomingFile,
    LostRecordingError,
    RawItem,
    RawStore,
    RawTotal,
    check_size,
    recording_name,
)
from fleet_db.s3_bucket import PART_BYTES, S3Bucket

AT_ONCE = 8  # recordings of one call that are sent at the same time
MARK_BYTES = 100
_NAME = re.compile(r"([0-9a-f]{2})/([0-9a-f]{64})\.[A-Za-z0-9]+")
NAMES = 1 << 32  # so many beginnings of a digest, of eight digits, there are


class S3RawStore(RawStore):
    """Recordings in a bucket; they are received, and copied to be read, in a folder of this machine."""

    def __init__(self, bucket: S3Bucket, receiving: Path) -> None:
        # a bucket has copies and versions of its own
        super().__init__(receiving, bucket.place.url, saved_by_backup=False)
        self._bucket = bucket

    def place(self, digest: str, suffix: str) -> str:
        """Return the URL of a recording."""
        return self._bucket.url(recording_name(digest, suffix))

    def incoming(self, suffix: str) -> IncomingFile:
        """Return a file that need not outlive a loss of power: what counts is the object."""
        return IncomingFile(self.receiving, suffix, durable=False)

    def put(self, files: Sequence[IncomingFile]) -> None:
        """Put files, several at the same time; a whole object of a name stays."""
        if len(files) == 1:
            self._put(files[0])
            return
        with ThreadPoolExecutor(AT_ONCE, thread_name_prefix="raw") as senders:
            for sent in [senders.submit(self._put, file) for file in files]:
                sent.result()

    def file_of(self, placed: IncomingFile) -> Path:
        """Return the file that was sent."""
        return placed.path

    def holds(self, digest: str, suffix: str) -> bool:
        """Whether there is an object of this name."""
        return self._bucket.facts(recording_name(digest, suffix)) is not None

    def size(self, digest: str, suffix: str) -> int:
        """Return the size of the object."""
        facts = self._bucket.facts(recording_name(digest, suffix))
        if facts is None:
            raise self._missing(digest, suffix)
        return facts.size_bytes

    def check(self, digest: str, suffix: str, size_bytes: int | None = None) -> None:
        """Read the object, piece by piece."""
        for _ in self._checked(digest, suffix, size_bytes):
            pass

    @contextmanager
    def whole(self, digest: str, suffix: str, size_bytes: int) -> Iterator[Path]:
        """Open a block with a copy on the disk, of the size that is expected; it is deleted at the end."""
        with self.incoming(suffix) as copy:
            for piece in self._checked(digest, suffix, size_bytes):
                copy.write(piece)
            copy.finish()
            yield copy.path

    def remove(self, digest: str, suffix: str) -> None:
        """Remove the object."""
        self._bucket.remove(recording_name(digest, suffix))

    def listed(self) -> Iterator[RawItem]:
        """Yield every recording, and what killed processes left on this machine; not the objects of others."""
        with passing_faults(self.receiving):
            unfinished = [(path, path.stat()) for path in self.receiving.glob(f"{PREFIX}*") if path.is_file()]
        for path, status in unfinished:
            yield RawItem(str(path), "", status.st_size, status.st_mtime)
        for name, facts in self._bucket.listed():
            digest = _digest_in(name)
            if digest is not None:
                yield RawItem(self._bucket.url(name), digest, facts.size_bytes, facts.changed_s)

    def remove_old(self, item: RawItem, least_age_s: float) -> int | None:
        """Remove an object by its URL, or a file by its path."""
        if not item.digest:
            unfinished = Path(item.place)
            with passing_faults(unfinished):
                return unlink_old(unfinished, least_age_s)
        name = item.place.removeprefix(self._bucket.url(""))
        facts = self._bucket.facts(name)
        if facts is None or facts.changed_s > time.time() - least_age_s:
            return None
        self._bucket.remove(name)
        return facts.size_bytes

    def total(self, enough: int) -> RawTotal:
        """Return what is there; of more than ``enough`` by how far their names, which are digests, have come."""
        files = size = 0
        for name, facts in self._bucket.listed():
            digest = _digest_in(name)
            if digest is None:
                continue
            files, size = files + 1, size + facts.size_bytes
            if files == enough:
                reached = (int(digest[:8], 16) + 1) / NAMES
                return RawTotal(round(files / reached), round(size / reached), estimated=True)
        return RawTotal(files, size, estimated=False)

    def read_mark(self) -> str | None:
        """Return what is in the object of the mark."""
        content = self._bucket.read_few(MARK_NAME, MARK_BYTES)
        return None if content is None else content.decode("ascii", "replace").strip() or None

    def write_mark(self, mark: str) -> None:
        """Write the object of the mark."""
        self._bucket.put(MARK_NAME, f"{mark}\n".encode())

    def _put(self, file: IncomingFile) -> None:
        name = recording_name(file.digest, file.suffix)
        there = self._bucket.facts(name)
        if there is not None and self.fault(file.digest, file.suffix, file.size_bytes) is None:
            return
        with passing_faults(file.path):
            tags = _tags_of(file.path)
        self._bucket.put(name, file.path)
        self._read_back(name, file, tags)

    def _read_back(self, name: str, file: IncomingFile, tags: frozenset[str]) -> None:
        """Raise PassingFaultError unless the object is what was sent: by its ETag, or else by its content."""
        stored = self._bucket.facts(name)
        if stored is not None and stored.size_bytes == file.size_bytes and stored.e_tag.lower() in tags:
            return
        fault = self.fault(file.digest, file.suffix, file.size_bytes)
        if fault is not None:  # it stays: another process may have put the same recording meanwhile
            raise PassingFaultError(f"was sent, and {fault.reason}", file=fault.file)

    def _missing(self, digest: str, suffix: str) -> LostRecordingError:
        """Return that an object is missing; raise PassingFaultError where it is the bucket that is."""
        self._bucket.read_few(recording_name(digest, suffix), 1)
        return LostRecordingError(MISSING, file=self.place(digest, suffix))

    def _checked(self, digest: str, suffix: str, size_bytes: int | None) -> Iterator[bytes]:
        """Yield the pieces of an object; raise LostRecordingError behind the last where they are something else."""
        name, place = recording_name(digest, suffix), self.place(digest, suffix)
        facts = self._bucket.facts(name)
        if facts is None:
            raise self._missing(digest, suffix)
        check_size(facts.size_bytes, size_bytes, place)
        sha256 = hashlib.sha256()
        try:
            for piece in self._bucket.pieces(name, facts):
                sha256.update(piece)
                yield piece
        except FileNotFoundError:
            raise LostRecordingError(MISSING, file=place) from None
        if sha256.hexdigest() != digest:
            raise LostRecordingError(DAMAGED, file=place)


def _digest_in(name: str) -> str | None:
    form = _NAME.fullmatch(name)
    return None if form is None or form[1] != form[2][:2] else form[2]


def _tags_of(path: Path) -> frozenset[str]:
    """Return the ETags that stores give to this content where they encrypt nothing: by MD5, of all or of the parts."""
    whole = hashlib.md5(usedforsecurity=False)
    parts: list[bytes] = []
    with path.open("rb") as stream:
        while piece := stream.read(PART_BYTES):
            whole.update(piece)
            parts.append(hashlib.md5(piece, usedforsecurity=False).digest())
    of_parts = hashlib.md5(b"".join(parts), usedforsecurity=False).hexdigest()
    return frozenset({whole.hexdigest(), f"{of_parts}-{len(parts)}"})

"""Reading every raw file again and comparing it with its digest: at a bounded rate, and from where it was left."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from estimation.errors import PassingFaultError
from estimation.values.runs import SubjectKind, after_failure, resolved
from fleet_db.raw import RawStore
from fleet_db.raw_files import check_raw_store
from fleet_db.receipts import ChunkState
from fleet_db.storage import SqlStorage
from fleet_db.stores.chunks import RawFile, RawScrub

STAGE = "scrub"
"""Under which damaged and missing files are in quarantine; a later reading that finds one whole ends that."""
BATCH = 50  # files between two commits of how far it has come


@dataclass(frozen=True, slots=True)
class ScrubPlan:
    """How a scrub goes: bytes a second at most (None: as fast as the disk), and whether an unfinished one goes on."""

    bytes_per_s: float | None = None
    resume: bool = True


@dataclass(frozen=True, slots=True)
class ScrubFault:
    """A raw file that is damaged or missing."""

    file: RawFile
    fault: str


def scrub(
    storage: SqlStorage,
    raw: RawStore,
    plan: ScrubPlan,
    now_ns: Callable[[], int],
    found: Callable[[ScrubFault], None],
    progress: Callable[[int, int], None],
    sleep: Callable[[float], None] = time.sleep,
) -> RawScrub:
    """Read every raw file, mark what is damaged or missing in quarantine, and return how it ended; services may run.

    Args:
        progress: Called with (done, total) files; it may raise to end the work, and the next scrub goes on from there.
        sleep: Waits, s.

    Raises:
        PassingFaultError: The folder of raw recordings is not mounted: nothing is marked.
        StorageError: The database cannot be reached.
    """
    check_raw_store(storage, raw, now_ns())
    with storage.write() as unit:
        last = unit.raw_scrubs.last()
        going = last is not None and last.finished_ns is None and plan.resume
        now = last if last is not None and going else unit.raw_scrubs.begin(now_ns())
        left = unit.raw_scrubs.count_after(now.after_digest)
    total, began_s, read = now.files + left, time.monotonic(), 0
    while True:
        with storage.read() as unit:
            files = unit.raw_scrubs.files_after(now.after_digest, BATCH)
        for file in files:
            fault = raw.fault(file.digest, file.suffix)
            marked = _mark(storage, file, fault, now_ns())
            if marked is not None:
                found(marked)
            read += file.size_bytes
            now = replace(
                now,
                after_digest=file.digest,
                files=now.files + 1,
                file_bytes=now.file_bytes + file.size_bytes,
                faults=now.faults + (marked is not None),
            )
            if plan.bytes_per_s is not None:
                sleep(max(0.0, read / plan.bytes_per_s - (time.monotonic() - began_s)))
            progress(now.files, max(total, now.files))
        ended = len(files) < BATCH
        now = replace(now, finished_ns=now_ns() if ended else None)
        with storage.write() as unit:
            unit.raw_scrubs.put(now)
        if ended:
            return now


def _mark(storage: SqlStorage, file: RawFile, fault: PassingFaultError | None, now_ns: int) -> ScrubFault | None:
    """Keep in quarantine that a file is damaged, or that it no longer is; return the fault unless it is none by now."""
    subject = (SubjectKind.RECORDING, file.digest, STAGE)
    with storage.read() as unit:
        before = unit.quarantine.get(*subject)
    if fault is None:
        if before is not None and before != resolved(before):
            with storage.write() as unit:
                unit.quarantine.put(resolved(before))
        return None
    with storage.write() as unit:
        record = unit.chunks.get(file.digest)
        if record is None or record.purged_ns is not None or record.state is ChunkState.DELETED:
            return None  # its file was deleted meanwhile, as it was to be
        unit.quarantine.put(after_failure(before, subject, file.vehicle, fault, now_ns))
    return ScrubFault(file, fault.reason)

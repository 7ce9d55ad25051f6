"""Recordings as they are stored, read again, and merged: which of them belong together."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from estimation.errors import LogFileError, PassingFaultError, StorageError
from fleet_db.atomic_files import passing_faults
from fleet_db.raw import RawStore
from fleet_db.records import ChunkRecord
from fleet_db.storage import SqlUnitOfWork
from ingest.align.clock import TIME_REACH_NS, AlignedFrames, align_to_clock, check_sync_rate, frames_near
from ingest.catalogue import Catalogue
from ingest.exchange.run import SUFFIX as EXCHANGE_SUFFIX
from ingest.exchange.run import aligned_run, exchange_catalogue, read_bundle
from ingest.frames import FrameBatch, between, empty_batch, merge
from ingest.logs.formats import read_content
from ingest.own_bus.bus import OwnBus
from ingest.own_bus.decoding import align_own

Span = tuple[int, int]

RECORDER_FIRST, RECORDER_LAST = "recorder_first_ns", "recorder_last_ns"
"""Keys among the counts of a receipt: the recorder's own stamps, by which neighbours of a recording are found."""

ALWAYS = (-(1 << 62), 1 << 62)
OFFSET_STEP_NS = 500_000_000
"""Recordings whose recorders disagree by more are not merged frame by frame, only sample by sample."""

IDENTIFIERS = 0x800

CACHED_FRAMES = 3_000_000


@dataclass(frozen=True, slots=True)
class Recording:
    """The frames of a chunk in merged order, and their place on the vehicle's clock when taken alone."""

    digest: str
    batch: FrameBatch  # empty for an exchange
    alone: AlignedFrames
    catalogue: Catalogue
    rows: int = 0  # of an exchange
    read_counts: Mapping[str, int] = field(default_factory=dict)  # of its log file: lines lost, and the like

    @property
    def frames(self) -> int:
        """Number of frames, or of rows of an exchange."""
        return self.rows or len(self.batch)

    @property
    def recorder_ns(self) -> tuple[int, int]:
        """First and last stamp of the recorder; of an exchange the vehicle's; (0, 0) without frames."""
        if self.rows:
            return int(self.alone.times.t_ns[0]), int(self.alone.times.t_ns[-1])
        if len(self.batch) == 0:
            return 0, 0
        return int(self.batch.t_ns[0]), int(self.batch.t_ns[-1])

    @property
    def vehicle_ns(self) -> tuple[int, int] | None:
        """First and last vehicle time; None without a TIME frame."""
        return self.alone.times.vehicle_range(*self.recorder_ns)


@dataclass
class Recordings:
    """Reads recordings from the raw store; keeps the last few, because neighbours come one after the other."""

    raw: RawStore
    catalogue_of: Callable[[str], Catalogue]  # of the bus of a vehicle
    _kept: OrderedDict[str, Recording] = field(default_factory=OrderedDict)

    def read(self, path: Path, digest: str, vehicle: str) -> Recording:
        """Read a recording of a vehicle from a file that has this digest."""
        with passing_faults(path), path.open("rb"):
            pass
        if path.suffix == EXCHANGE_SUFFIX:
            file, run, facts = read_bundle(path)
            frames = aligned_run(run, facts, file.run.position_quality)
            return Recording(digest, empty_batch(), frames, exchange_catalogue(), rows=len(run.tick))
        catalogue = self.catalogue_of(vehicle)
        content = read_content(path)
        batch = merge([content.batch])
        if not isinstance(catalogue, OwnBus):
            check_sync_rate(batch, catalogue.sample_interval_ns)
        return Recording(digest, batch, align_frames(catalogue, batch), catalogue, read_counts=content.counts)

    def load(self, record: ChunkRecord) -> Recording:
        """Return the recording of a receipt; PassingFaultError where its file is away, or is another."""
        kept = self._kept.get(record.digest)
        if kept is None or not (kept.rows or kept.catalogue is self.catalogue_of(record.vehicle)):
            with self.raw.whole(record.digest, record.suffix, record.size_bytes) as path:
                self.keep(self.read(path, record.digest, record.vehicle))
        self._kept.move_to_end(record.digest)
        return self._kept[record.digest]

    def load_neighbour(self, record: ChunkRecord) -> Recording:
        """Return a recording that could be read before."""
        try:
            return self.load(record)
        except (LogFileError, PassingFaultError) as error:
            raise StorageError(f"raw recording {record.digest} is lost or damaged: {error}") from error

    def keep(self, recording: Recording) -> None:
        """Remember a recording that was just read."""
        self._kept[recording.digest] = recording
        while len(self._kept) > 1 and sum(kept.frames for kept in self._kept.values()) > CACHED_FRAMES:
            self._kept.popitem(last=False)


def align_frames(catalogue: Catalogue, batch: FrameBatch) -> AlignedFrames:
    """Decode a batch and put its frames on the vehicle's clock."""
    return align_own(catalogue, batch) if isinstance(catalogue, OwnBus) else align_to_clock(catalogue, batch)


def waiting_beside(unit: SqlUnitOfWork, vehicle: str, recording: Recording) -> Sequence[ChunkRecord]:
    """Return the receipts of recordings without TIME whose recorder stamps touch a recording."""
    if recording.rows:
        return []
    own = recording.digest, recording.recorder_ns
    return [other for other in unit.chunks.waiting_for_time(vehicle) if is_beside(other, *own)]


def decoded_beside(unit: SqlUnitOfWork, vehicle: str, digest: str, recorder_ns: Span) -> Sequence[ChunkRecord]:
    """Return the receipts of decoded recordings whose recorder stamps touch those of a recording."""
    first, last = recorder_ns
    decoded = unit.chunks.overlapping_by_recorder(vehicle, first - TIME_REACH_NS, last + TIME_REACH_NS + 1)
    return [r for r in decoded if r.purged_ns is None and is_beside(r, digest, recorder_ns)]


def is_beside(record: ChunkRecord, digest: str, recorder_ns: Span) -> bool:
    """Whether the recorder stamps of a decoded or waiting recording touch those of another one."""
    first, last = recorder_ns
    if record.digest == digest or RECORDER_FIRST not in record.counts:
        return False
    return (
        record.counts[RECORDER_FIRST] <= last + TIME_REACH_NS and record.counts[RECORDER_LAST] >= first - TIME_REACH_NS
    )


def align_recordings(recordings: Iterable[Recording], span: Span | None = None) -> list[AlignedFrames]:
    """Merge recordings whose recorder stamps touch and whose recorders agree, and align what was merged.

    The answer depends on the set of recordings, not on their order. What cannot matter to windows in a span of the
    vehicle's clock may be left out; None is all.
    """
    groups: list[list[Recording]] = []
    for recording in sorted(recordings, key=lambda r: (r.recorder_ns, r.digest)):
        if recording.rows:  # the samples of an exchange belong to no frames
            groups.append([recording])
            continue
        joined = [recording]
        apart = []
        for group in groups:
            if any(_touch(recording, other) for other in group):
                joined = group + joined
            else:
                apart.append(group)
        groups = [*apart, joined]
    aligned = []
    for group in groups:
        batches, catalogue = [recording.batch for recording in group], group[0].catalogue
        if len(group) > 1 and span is not None and not isinstance(catalogue, OwnBus):
            batches = list(frames_near(batches, [recording.alone for recording in group], span))
        aligned.append(group[0].alone if len(group) == 1 else align_frames(catalogue, merge(batches)))
    return aligned


def _touch(first: Recording, second: Recording) -> bool:
    """Whether two recordings are of one run of one recorder's clock.

    Next to each other they are, even when the vehicle's clock jumped between them: ``align_to_clock`` finds that.
    On top of each other they are when the recorders agree on the vehicle's time, or recorded the same frames; else the
    recorder's clock was set back between them.
    """
    (a, b), (c, d) = first.recorder_ns, second.recorder_ns
    if first.rows or second.rows or a > d + TIME_REACH_NS or c > b + TIME_REACH_NS:
        return False
    offsets, others = first.alone.times.offsets(), second.alone.times.offsets()
    if offsets is None or others is None or max(a, c) >= min(b, d):
        return True
    agree = offsets[0] <= others[1] + OFFSET_STEP_NS and others[0] <= offsets[1] + OFFSET_STEP_NS
    if agree:
        return True
    parts = (between(recording.batch, max(a, c), min(b, d) + 1) for recording in (first, second))
    # wraps around: a fingerprint of each frame
    ours, theirs = (part.t_ns * IDENTIFIERS + part.arbitration_id.astype(np.int64) for part in parts)
    return 2 * len(np.intersect1d(ours, theirs)) >= min(len(ours), len(theirs)) > 0

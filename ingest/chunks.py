"""Recordings on their way to windows: what is known of each, and which belong together."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from estimation.errors import LogFileError, StorageError
from estimation.values.reasons import Reason, ReasonCode, code_of
from fleet_db.raw import RawStore
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlUnitOfWork
from ingest.align.clock import CONTEXT_NS, TIME_REACH_NS, AlignedFrames, align_to_clock, check_sync_rate
from ingest.catalogue import Catalogue
from ingest.frames import FrameBatch, between, merge
from ingest.logs import read_log

WAITING = Reason(ReasonCode.WAITS_FOR_TIME, "no TIME frame in it or beside it: it waits for the recording next to it")

RECORDER_FIRST, RECORDER_LAST = "recorder_first_ns", "recorder_last_ns"
"""Keys among the counts of a receipt: the recorder's own stamps, by which neighbours of a recording are found."""

ALWAYS = (-(1 << 62), 1 << 62)
OFFSET_STEP_NS = 500_000_000
"""Recordings whose recorders disagree by more are not merged frame by frame, only sample by sample."""

IDENTIFIERS = 0x800

CACHED_FRAMES = 3_000_000


@dataclass(frozen=True, slots=True)
class Recording:
    """The frames of a chunk in merged order, and where they lie on the vehicle's clock when taken alone."""

    digest: str
    batch: FrameBatch
    alone: AlignedFrames

    @property
    def recorder_ns(self) -> tuple[int, int]:
        """First and last stamp of the recorder; (0, 0) for a recording without frames."""
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
    catalogue: Catalogue
    _kept: OrderedDict[str, Recording] = field(default_factory=OrderedDict)

    def read(self, path: Path, digest: str) -> Recording:
        """Read a recording from a file that has this digest.

        Raises
        ------
        LogFileError
            The file is no log that can be read, or its SYNC comes at another rate than the catalogue says.
        """
        batch = merge([read_log(path)])
        check_sync_rate(batch, self.catalogue.sample_interval_ns)
        return Recording(digest, batch, align_to_clock(self.catalogue, batch))

    def load(self, record: ChunkRecord) -> Recording:
        """Return the recording of a receipt.

        Raises
        ------
        LogFileError
            Its file is missing or no log that can be read.
        """
        if record.digest not in self._kept:
            self.keep(self.read(self.raw.path(record.digest, record.suffix), record.digest))
        self._kept.move_to_end(record.digest)
        return self._kept[record.digest]

    def load_neighbour(self, record: ChunkRecord) -> Recording:
        """Return a recording that could be read before.

        Raises
        ------
        StorageError
            It cannot any more: the raw store has lost or damaged it.
        """
        try:
            return self.load(record)
        except LogFileError as error:
            raise StorageError(f"a raw recording is lost or damaged: {error}") from error

    def keep(self, recording: Recording) -> None:
        """Remember a recording that was just read."""
        self._kept[recording.digest] = recording
        while len(self._kept) > 1 and sum(len(kept.batch) for kept in self._kept.values()) > CACHED_FRAMES:
            self._kept.popitem(last=False)


def waiting_beside(unit: SqlUnitOfWork, vehicle: str, recording: Recording) -> Sequence[ChunkRecord]:
    """Return the receipts of a vehicle's recordings without TIME whose recorder stamps touch this recording."""
    stored = unit.chunks.with_state(ChunkState.STORED, limit=10_000)
    return [
        r
        for r in stored
        if r.vehicle == vehicle and code_of(r.reason) is ReasonCode.WAITS_FOR_TIME and _beside(r, recording)
    ]


def decoded_beside(unit: SqlUnitOfWork, vehicle: str, recording: Recording) -> Sequence[ChunkRecord]:
    """Return the receipts of a vehicle's decoded recordings whose recorder stamps touch this recording."""
    return [r for r in unit.chunks.overlapping(vehicle, *ALWAYS) if _beside(r, recording)]


def _beside(record: ChunkRecord, recording: Recording) -> bool:
    first, last = recording.recorder_ns
    if record.digest == recording.digest or RECORDER_FIRST not in record.counts:
        return False
    return (
        record.counts[RECORDER_FIRST] <= last + TIME_REACH_NS and record.counts[RECORDER_LAST] >= first - TIME_REACH_NS
    )


def needed_range(first_ns: int, last_ns: int, length_ns: int) -> tuple[int, int, int, int]:
    """Return ``(first, last, from, to)`` for frames of ``[first_ns, last_ns]``.

    ``first`` and ``last`` bound the windows that these frames can change; recordings in ``[from, to)`` are needed to
    assemble those windows.
    """
    first, last = first_ns - CONTEXT_NS, last_ns + CONTEXT_NS
    from_ns = first // length_ns * length_ns - CONTEXT_NS
    to_ns = (last // length_ns + 1) * length_ns + CONTEXT_NS
    return first, last, from_ns, to_ns


def stretches(recordings: Iterable[Recording], catalogue: Catalogue) -> list[AlignedFrames]:
    """Merge recordings whose recorder stamps touch and whose recorders agree, and place each such stretch.

    The answer depends on the set of recordings, not on their order.
    """
    groups: list[list[Recording]] = []
    for recording in sorted(recordings, key=lambda r: (r.recorder_ns, r.digest)):
        joined = [recording]
        apart = []
        for group in groups:
            if any(_touch(recording, other) for other in group):
                joined = group + joined
            else:
                apart.append(group)
        groups = [*apart, joined]
    return [
        group[0].alone
        if len(group) == 1
        else align_to_clock(catalogue, merge([recording.batch for recording in group]))
        for group in groups
    ]


def _touch(first: Recording, second: Recording) -> bool:
    """Whether two recordings are of one stretch of one recorder's clock.

    Next to each other they are, even when the vehicle's clock jumped between them: that is for the clock to find out.
    On top of each other they are when the recorders agree on the vehicle's time, or recorded the same frames; else the
    recorder's clock was set back between them.
    """
    (a, b), (c, d) = first.recorder_ns, second.recorder_ns
    if a > d + TIME_REACH_NS or c > b + TIME_REACH_NS:
        return False
    offsets, others = first.alone.times.offsets(), second.alone.times.offsets()
    if offsets is None or others is None or max(a, c) >= min(b, d):
        return True
    agree = offsets[0] <= others[1] + OFFSET_STEP_NS and others[0] <= offsets[1] + OFFSET_STEP_NS
    return agree or _share_frames(first.batch, second.batch, max(a, c), min(b, d))


def _share_frames(first: FrameBatch, second: FrameBatch, from_ns: int, to_ns: int) -> bool:
    """Whether most frames that both have in ``[from_ns, to_ns]`` are the same ones."""
    one, other = (
        part.t_ns * IDENTIFIERS + part.arbitration_id.astype(np.int64)  # wraps around: a fingerprint
        for part in (between(first, from_ns, to_ns + 1), between(second, from_ns, to_ns + 1))
    )
    return 2 * len(np.intersect1d(one, other)) >= min(len(one), len(other)) > 0

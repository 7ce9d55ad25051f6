"""From recordings to windows: which recordings belong together, and the windows that they touch."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from estimation.errors import LogFileError, StorageError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord
from fleet_db.raw import RawStore
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlUnitOfWork
from ingest.align.clock import (
    CONTEXT_NS,
    TIME_REACH_NS,
    AlignedFrames,
    align_to_clock,
    check_sync_rate,
    merge_aligned,
)
from ingest.align.windows import (
    MountedWindow,
    RegistryLookup,
    VehicleSamples,
    WindowCounts,
    add_counts,
    vehicle_samples,
    window_starts,
    windows_of,
)
from ingest.catalogue import Catalogue
from ingest.frames import FrameBatch, between, merge
from ingest.logs import read_log

Span = tuple[int, int]

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
    """The frames of a chunk in merged order, and their place on the vehicle's clock when taken alone."""

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
            The file is no log that can be read, or its SYNC comes at another rate than in the catalogue.
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
    """Return the receipts of recordings without TIME whose recorder stamps touch a recording.

    Parameters
    ----------
    unit
        An open transaction.
    vehicle
        Code of the vehicle.
    recording
        The recording.
    """
    return [other for other in unit.chunks.waiting_for_time(vehicle) if _beside(other, recording)]


def decoded_beside(unit: SqlUnitOfWork, vehicle: str, recording: Recording) -> Sequence[ChunkRecord]:
    """Return the receipts of decoded recordings whose recorder stamps touch a recording.

    Parameters
    ----------
    unit
        An open transaction.
    vehicle
        Code of the vehicle.
    recording
        The recording.
    """
    return [r for r in unit.chunks.overlapping(vehicle, *ALWAYS) if _beside(r, recording)]


def _beside(record: ChunkRecord, recording: Recording) -> bool:
    first, last = recording.recorder_ns
    if record.digest == recording.digest or RECORDER_FIRST not in record.counts:
        return False
    return (
        record.counts[RECORDER_FIRST] <= last + TIME_REACH_NS and record.counts[RECORDER_LAST] >= first - TIME_REACH_NS
    )


def needed_range(first_ns: int, last_ns: int, length_ns: int) -> tuple[int, int, int, int]:
    """Return ``(first, last, from, to)`` on the vehicle's clock, ns.

    ``first`` and ``last`` bound the windows that these frames can change; recordings in ``[from, to)`` are needed to
    assemble those windows.

    Parameters
    ----------
    first_ns, last_ns
        First and last frame.
    length_ns
        Length of a window.
    """
    first, last = first_ns - CONTEXT_NS, last_ns + CONTEXT_NS
    from_ns = first // length_ns * length_ns - CONTEXT_NS
    to_ns = (last // length_ns + 1) * length_ns + CONTEXT_NS
    return first, last, from_ns, to_ns


def align_recordings(recordings: Iterable[Recording], catalogue: Catalogue) -> list[AlignedFrames]:
    """Merge recordings whose recorder stamps touch and whose recorders agree, and align what was merged.

    The answer depends on the set of recordings, not on their order.

    Parameters
    ----------
    recordings
        Recordings of one vehicle.
    catalogue
        The messages of its bus.
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
    """Whether two recordings are of one run of one recorder's clock.

    Next to each other they are, even when the vehicle's clock jumped between them: ``align_to_clock`` finds that.
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
    ours, theirs = (
        part.t_ns * IDENTIFIERS + part.arbitration_id.astype(np.int64)  # wraps around: a fingerprint
        for part in (between(first, from_ns, to_ns + 1), between(second, from_ns, to_ns + 1))
    )
    return 2 * len(np.intersect1d(ours, theirs)) >= min(len(ours), len(theirs)) > 0


@dataclass(frozen=True, slots=True)
class Assembly:
    """Windows of a recording and everything that went into them."""

    sources: frozenset[str]  # digests
    receipts: tuple[ChunkRecord, ...]  # that change with it: its own first, then those that had waited for it
    windows: tuple[MountedWindow, ...]


@dataclass(frozen=True, slots=True)
class Assembler:
    """Assembles the windows that a recording touches from every recording that touches those windows."""

    catalogue: Catalogue
    recordings: Recordings
    length_ns: int

    def sources(self, unit: SqlUnitOfWork, record: ChunkRecord, recording: Recording) -> Sequence[ChunkRecord]:
        """Return the receipts of all recordings that the windows of this one depend on, its own first."""
        beside = list(waiting_beside(unit, record.vehicle, recording))
        span = recording.vehicle_ns
        if span is None:
            beside += decoded_beside(unit, record.vehicle, recording)
            joined = [recording, *(self.recordings.load_neighbour(other) for other in beside)]
            span = _span(recording, align_recordings(joined, self.catalogue))
        if span is None:
            return [record]
        _, _, from_ns, to_ns = needed_range(*span, self.length_ns)
        overlapping = unit.chunks.overlapping(record.vehicle, from_ns, to_ns)
        found = {other.digest: other for other in (*beside, *overlapping) if other.digest != record.digest}
        return [record, *found.values()]

    def assemble(self, unit: SqlUnitOfWork, record: ChunkRecord, recording: Recording) -> Assembly:
        """Assemble the windows that a stored recording touches.

        Raises
        ------
        NotFoundError
            The registry does not know the vehicle.
        StorageError
            A recording that is needed cannot be read any more.
        """
        vehicle = unit.registry.vehicle(record.vehicle)
        sources = self.sources(unit, record, recording)
        loaded = {source.digest: self.recordings.load_neighbour(source) for source in sources[1:]}
        loaded[record.digest] = recording
        aligned = align_recordings(loaded.values(), self.catalogue)
        coming = [(source, loaded[source.digest]) for source in sources if source.state is not ChunkState.DECODED]
        spans = [_span(each, aligned) for _, each in coming]
        receipts = [_receipt_after(*each, span) for each, span in zip(coming, spans, strict=True)]
        known = [span for span in spans if span is not None]
        if not known:
            return Assembly(frozenset(loaded), tuple(receipts), ())
        samples, counts = vehicle_samples(vehicle.code, self.catalogue, merge_aligned(aligned))
        windows, made = self._windows(unit, vehicle, samples, known)
        receipts[0] = _with_counts(receipts[0], {**_nonzero(asdict(counts)), **asdict(made)})
        return Assembly(frozenset(loaded), tuple(receipts), windows)

    def _windows(
        self, unit: SqlUnitOfWork, vehicle: VehicleRecord, samples: VehicleSamples, spans: Sequence[Span]
    ) -> tuple[tuple[MountedWindow, ...], WindowCounts]:
        first, last, _, _ = needed_range(min(s[0] for s in spans), max(s[1] for s in spans), self.length_ns)
        starts = window_starts(first, last, self.length_ns)
        windows, counts = [], WindowCounts()
        lookup = _lookup(unit, vehicle, starts.start, starts.stop + self.length_ns)
        for outcome in windows_of(samples, starts, self.length_ns, lookup):
            if isinstance(outcome, MountedWindow):
                windows.append(outcome)
            else:
                counts = add_counts(counts, outcome)
        return tuple(windows), replace(counts, windows=len(windows))


def _span(recording: Recording, aligned: Iterable[AlignedFrames]) -> Span | None:
    """Return the span of a recording on the vehicle's clock: by its own TIME frames, else by those beside it."""
    if len(recording.batch) == 0:
        return None
    beside = (part.times.at(*recording.recorder_ns) for part in aligned)
    return recording.vehicle_ns or next((span for span in beside if span is not None), None)


def _lookup(unit: SqlUnitOfWork, vehicle: VehicleRecord, from_ns: int, to_ns: int) -> RegistryLookup:
    return RegistryLookup(
        vehicle,
        tuple(unit.registry.mountings_on(vehicle.code, from_ns, to_ns)),
        {section.number: section.code for section in unit.tracks.sections()},
    )


def _receipt_after(record: ChunkRecord, recording: Recording, span: Span | None) -> ChunkRecord:
    """Return the receipt of a recording that was just placed at ``span`` on the vehicle's clock, or not at all."""
    first, last = recording.recorder_ns
    counts = {
        "frames": 0,
        **_nonzero(asdict(recording.alone.frame_counts)),
        **_nonzero(asdict(recording.alone.align_counts)),
        RECORDER_FIRST: first,
        RECORDER_LAST: last,
    }
    record = replace(record, frames=len(recording.batch), counts=counts)
    if span is None and len(recording.batch):
        return replace(record, reason=WAITING)
    first_ns, last_ns = span or (None, None)
    return replace(record, state=ChunkState.DECODED, reason=None, first_ns=first_ns, last_ns=last_ns)


def _with_counts(record: ChunkRecord, more: Mapping[str, int]) -> ChunkRecord:
    return replace(record, counts={**record.counts, **more})


def _nonzero(counts: Mapping[str, int]) -> dict[str, int]:
    return {name: count for name, count in counts.items() if count}

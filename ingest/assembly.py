"""From recordings to windows: which recordings belong together, and the windows that they touch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from estimation.errors import ConflictError, LogFileError, StorageError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlUnitOfWork
from ingest.align.clock import CONTEXT_NS, AlignedFrames, merge_aligned, values_near
from ingest.align.windows import (
    MountedWindow,
    RegistryLookup,
    WindowCounts,
    vehicle_samples,
    windows_of,
)
from ingest.exchange.intake import check_alone
from ingest.exchange.run import SUFFIX as EXCHANGE_SUFFIX
from ingest.frames import count_dropped
from ingest.own_bus.bus import OwnBus
from ingest.own_bus.decoding import own_samples
from ingest.plausibility import clock_verdict
from ingest.recordings import (
    RECORDER_FIRST,
    RECORDER_LAST,
    Recording,
    Recordings,
    Span,
    align_recordings,
    decoded_beside,
    waiting_beside,
)


@dataclass(frozen=True, slots=True)
class SpanAssembly:
    """The windows of a vehicle that overlap a span of its clock, and everything that went into them."""

    vehicle: str
    from_ns: int
    to_ns: int
    sources: frozenset[str]
    lookup: RegistryLookup
    windows: tuple[MountedWindow, ...]  # all that recordings and registry give in the span, but for those of ``kept``
    kept: tuple[Span, ...]  # spans in which a recording cannot be read any more: what is stored of them stays
    lost: tuple[ChunkRecord, ...]  # receipts of those whose raw file is lost or damaged, and was not purged
    again: tuple[
        ChunkRecord, ...
    ]  # receipts of those that the vehicle's bus, now another, places elsewhere or cannot read
    counts: Mapping[str, int]

    def keeps(self, start_ns: int, length_ns: int) -> bool:
        """Whether what is stored of a window stays, because a recording of it cannot be read."""
        return any(first < start_ns + length_ns and last >= start_ns for first, last in self.kept)


def registry_lookup(unit: SqlUnitOfWork, vehicle: VehicleRecord, from_ns: int, to_ns: int) -> RegistryLookup:
    """Return what the registry contains of a vehicle over a span of its clock."""
    sections = unit.tracks.sections()
    return RegistryLookup(
        vehicle,
        tuple(unit.registry.mountings_on(vehicle.code, from_ns, to_ns)),
        {section.number: section.code for section in sections},
        {section.code: section.line for section in sections if section.line is not None},
    )


OWN_TIME = "own_time"  # key among the counts of a receipt: 1 where the recording has a TIME frame of its own, else 0
WAITING = Reason(ReasonCode.WAITS_FOR_TIME, "no TIME frame in it or beside it: it waits for the recording next to it")


def needed_range(first_ns: int, last_ns: int, length_ns: int) -> tuple[int, int, int, int]:
    """Return ``(first, last, from, to)`` on the vehicle's clock, ns.

    ``first`` and ``last`` bound the windows that these frames can change; recordings in ``[from, to)`` are needed to
    assemble those windows.
    """
    first, last = first_ns - CONTEXT_NS, last_ns + CONTEXT_NS
    from_ns = first // length_ns * length_ns - CONTEXT_NS
    to_ns = (last // length_ns + 1) * length_ns + CONTEXT_NS
    return first, last, from_ns, to_ns


@dataclass(frozen=True, slots=True)
class Assembler:
    """Assembles the windows of a vehicle from every decoded recording that touches them."""

    recordings: Recordings
    length_ns: int

    def placed(self, unit: SqlUnitOfWork, record: ChunkRecord, recording: Recording) -> tuple[ChunkRecord, ...]:
        """Return the receipt of a stored recording with its place on the vehicle's clock, if it has one.

        It comes first; those that had waited for its TIME frames follow.
        """
        waiting = list(waiting_beside(unit, record.vehicle, recording))
        beside = list(waiting)
        if recording.vehicle_ns is None:
            beside += decoded_beside(unit, record.vehicle, recording.digest, recording.recorder_ns)
        loaded = {other.digest: self.recordings.load_neighbour(other) for other in beside}
        aligned = align_recordings([recording, *loaded.values()])
        coming = [(record, recording), *((other, loaded[other.digest]) for other in waiting)]
        return tuple(_receipt_after(*each, _span(each[1], aligned)) for each in coming)

    def check_no_logs(self, unit: SqlUnitOfWork, vehicle: str, span: Span) -> None:
        """Raise where logs are in the windows that an exchange of this span of the vehicle's clock touches."""
        _, _, from_ns, to_ns = needed_range(*span, self.length_ns)
        _check_one_kind(vehicle, EXCHANGE_SUFFIX, unit.chunks.overlapping(vehicle, from_ns, to_ns))

    def check_one_kind(self, unit: SqlUnitOfWork, record: ChunkRecord) -> None:
        """Raise where logs of a bus and exchanges would share a window with a recording that was just placed.

        Two exchanges may share a window, but no instant.
        """
        if record.first_ns is not None and record.last_ns is not None:
            _, _, from_ns, to_ns = needed_range(record.first_ns, record.last_ns, self.length_ns)
            beside = unit.chunks.overlapping(record.vehicle, from_ns, to_ns)
            _check_one_kind(record.vehicle, record.suffix, beside)
            if record.suffix == EXCHANGE_SUFFIX:
                check_alone(unit, record.vehicle, record.first_ns, record.last_ns, record.digest)

    def touched(self, receipts: Iterable[ChunkRecord]) -> Span | None:
        """Return the span of the vehicle's clock whose windows recordings can change; None where there is none."""
        ends = [(r.first_ns, r.last_ns) for r in receipts if r.first_ns is not None and r.last_ns is not None]
        if not ends:
            return None
        first, last, _, _ = needed_range(min(end[0] for end in ends), max(end[1] for end in ends), self.length_ns)
        return first, last + 1

    def sources(
        self, unit: SqlUnitOfWork, vehicle: str, span: Span, coming: Sequence[ChunkRecord] = ()
    ) -> list[ChunkRecord]:
        """Return the receipts of all recordings that the windows of a vehicle in a span depend on."""
        decoded = unit.chunks.overlapping(vehicle, span[0] - CONTEXT_NS, span[1] + CONTEXT_NS)
        by_digest = {other.digest: other for other in (*decoded, *coming)}
        for source in list(by_digest.values()):
            if not source.counts[OWN_TIME]:  # its place is known by those beside it
                recorder_ns = source.counts[RECORDER_FIRST], source.counts[RECORDER_LAST]
                beside = decoded_beside(unit, vehicle, source.digest, recorder_ns)
                by_digest |= {other.digest: other for other in beside}
        return [by_digest[digest] for digest in sorted(by_digest)]

    def assemble(
        self,
        unit: SqlUnitOfWork,
        vehicle: str,
        span: Span,
        coming: Sequence[ChunkRecord] = (),
        *,
        keep_unreadable: bool = False,
    ) -> SpanAssembly:
        """Assemble all windows of a vehicle that overlap a span of its clock.

        With ``keep_unreadable`` what is stored of a recording that cannot be read any more stays, and the others go on.
        """
        on_file = unit.registry.vehicle(vehicle)
        first = span[0] // self.length_ns * self.length_ns
        end = -(-span[1] // self.length_ns) * self.length_ns
        sources = self.sources(unit, vehicle, (first, end), coming)
        lookup = registry_lookup(unit, on_file, first, end)
        loaded, unreadable, again = self._loaded(sources, keep_unreadable=keep_unreadable)
        kept = tuple(span for source in unreadable for span in extent(source))
        lost = tuple(source for source in unreadable if source.purged_ns is None)
        windows: list[MountedWindow] = []
        counts: Counter[str] = Counter()
        for exchanges in (False, True):  # they never share a window
            readable = [source for source in sources if source.digest in loaded]
            of_kind = [loaded[s.digest] for s in readable if (s.suffix == EXCHANGE_SUFFIX) == exchanges]
            if of_kind:
                made, left_out = self._windows(of_kind, lookup, (first, end))
                windows += made
                counts.update(left_out)
        spared = SpanAssembly(
            vehicle, first, end, frozenset(r.digest for r in sources), lookup, (), kept, lost, again, counts
        )
        return replace(spared, windows=tuple(w for w in windows if not spared.keeps(w.window.start_ns, self.length_ns)))

    def _loaded(
        self, sources: Sequence[ChunkRecord], *, keep_unreadable: bool
    ) -> tuple[dict[str, Recording], tuple[ChunkRecord, ...], tuple[ChunkRecord, ...]]:
        """Return the recordings by digest, and the receipts of the unreadable and of those to be decoded again."""
        loaded: dict[str, Recording] = {}
        unreadable: list[ChunkRecord] = []
        again: list[ChunkRecord] = []
        for source in sources:
            if source.purged_ns is not None:
                unreadable.append(source)
                continue
            try:
                recording = self.recordings.load_neighbour(source)
            except StorageError as error:
                if not keep_unreadable:
                    raise
                if isinstance(error.__cause__, LogFileError):
                    again.append(source)
                elif not self.recordings.raw.lost(source.digest, source.suffix):
                    raise  # memory, processes, an extra or the store as a whole are missing: it can be read later
                else:
                    unreadable.append(source)
            else:
                moved = recording.vehicle_ns not in {None, (source.first_ns, source.last_ns)}
                if moved:
                    again.append(source)
                else:
                    loaded[source.digest] = recording
        return loaded, tuple(unreadable), tuple(again)

    def _windows(
        self, recordings: Sequence[Recording], lookup: RegistryLookup, span: Span
    ) -> tuple[list[MountedWindow], dict[str, int]]:
        messages, catalogue = merge_aligned(align_recordings(recordings, span)), recordings[0].catalogue
        near, vehicle = values_near(messages, span, catalogue.sample_interval_ns), lookup.vehicle.code
        if isinstance(catalogue, OwnBus):
            samples, counts = own_samples(vehicle, catalogue, near)
        else:
            samples, counts = vehicle_samples(vehicle, catalogue, near)
        starts: set[int] = set()  # of the windows that any wheelset has samples in
        for node in samples.nodes.values():
            low, high = np.searchsorted(node.t_ns, span)
            numbers = node.t_ns[low:high] // self.length_ns
            starts.update((numbers[np.diff(numbers, prepend=-1) != 0] * self.length_ns).tolist())
        windows, made = [], WindowCounts()
        for outcome in windows_of(samples, sorted(starts), self.length_ns, lookup):
            if isinstance(outcome, MountedWindow):
                windows.append(outcome)
            else:
                made += outcome
        made = replace(made, windows=len(windows))
        return windows, {**_nonzero(asdict(counts)), **asdict(made)}


def _check_one_kind(vehicle: str, suffix: str, sources: Iterable[ChunkRecord]) -> None:
    """Raise where logs and exchanges meet in a window: they have different filters and clocks."""
    of_exchange = suffix == EXCHANGE_SUFFIX
    other = next((source for source in sources if (source.suffix == EXCHANGE_SUFFIX) != of_exchange), None)
    if other is not None:
        kinds = ("an exchange", "a log") if of_exchange else ("a log", "an exchange")
        reason = f"{kinds[0]} of vehicle {vehicle} would share windows with {kinds[1]} that is stored"
        raise ConflictError(f"{reason}: {other.digest[:12]}", kind="chunk", key=other.digest)


def extent(source: ChunkRecord) -> list[Span]:
    """Return the span in which a recording changes windows; nothing where it has no place."""
    if source.first_ns is None or source.last_ns is None:
        return []
    return [(source.first_ns - CONTEXT_NS, source.last_ns + CONTEXT_NS)]


def add_stale(unit: SqlUnitOfWork, record: ChunkRecord, cause: str) -> None:
    """Let the windows that a recording changes be made again."""
    for from_ns, to_ns in extent(record):
        unit.stale_spans.add(record.vehicle, from_ns, to_ns + 1, cause)


def _span(recording: Recording, aligned: Iterable[AlignedFrames]) -> Span | None:
    """Return the span of a recording on the vehicle's clock: by its own TIME frames, else by those beside it."""
    if recording.frames == 0:
        return None
    beside = (part.times.at(*recording.recorder_ns) for part in aligned)
    return recording.vehicle_ns or next((span for span in beside if span is not None), None)


def _receipt_after(record: ChunkRecord, recording: Recording, span: Span | None) -> ChunkRecord:
    first, last = recording.recorder_ns
    counts = {
        "frames": 0,
        **recording.read_counts,
        **_nonzero({"frames_dropped": count_dropped(recording.batch)}),
        **_nonzero(asdict(recording.alone.frame_counts)),
        **_nonzero(asdict(recording.alone.align_counts)),
        RECORDER_FIRST: first,
        RECORDER_LAST: last,
        OWN_TIME: int(recording.vehicle_ns is not None),
    }
    record = replace(record, frames=recording.frames, counts=counts)
    if span is None and recording.frames:
        return replace(record, reason=WAITING)
    first_ns, last_ns = span or (None, None)
    our_ns = record.received_ns if record.clock_checked_ns is None else record.clock_checked_ns
    verdict = None if span is None else clock_verdict(*span, our_ns)
    if verdict is not None:
        return replace(record, state=ChunkState.REJECTED, reason=verdict)
    return replace(record, state=ChunkState.DECODED, reason=None, first_ns=first_ns, last_ns=last_ns)


def _nonzero(counts: Mapping[str, int]) -> dict[str, int]:
    return {name: count for name, count in counts.items() if count}

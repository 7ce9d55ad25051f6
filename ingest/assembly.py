"""From recordings to windows: which recordings belong together, and the windows that they touch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from estimation.errors import ConflictError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlUnitOfWork
from ingest.align.clock import (
    CONTEXT_NS,
    AlignCounts,
    AlignedFrames,
    TickedValues,
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
from ingest.exchange.bundle import SUFFIX as EXCHANGE_SUFFIX
from ingest.own_bus.bus import OwnBus
from ingest.own_bus.samples import own_samples
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

WAITING = Reason(ReasonCode.WAITS_FOR_TIME, "no TIME frame in it or beside it: it waits for the recording next to it")


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


@dataclass(frozen=True, slots=True)
class Assembly:
    """Windows of a recording and everything that went into them."""

    sources: frozenset[str]  # digests
    receipts: tuple[ChunkRecord, ...]  # that change with it: its own first, then those that had waited for it
    windows: tuple[MountedWindow, ...]


@dataclass(frozen=True, slots=True)
class Assembler:
    """Assembles the windows that a recording touches from every recording that touches those windows."""

    recordings: Recordings
    length_ns: int

    def sources(self, unit: SqlUnitOfWork, record: ChunkRecord, recording: Recording) -> Sequence[ChunkRecord]:
        """Return the receipts of all recordings that the windows of this one depend on, its own first."""
        beside = list(waiting_beside(unit, record.vehicle, recording))
        span = recording.vehicle_ns
        if span is None:
            beside += decoded_beside(unit, record.vehicle, recording)
            joined = [recording, *(self.recordings.load_neighbour(other) for other in beside)]
            span = _span(recording, align_recordings(joined))
        if span is None:
            return [record]
        _, _, from_ns, to_ns = needed_range(*span, self.length_ns)
        overlapping = unit.chunks.overlapping(record.vehicle, from_ns, to_ns)
        found = {other.digest: other for other in (*beside, *overlapping) if other.digest != record.digest}
        return [record, *found.values()]

    def check_no_logs(self, unit: SqlUnitOfWork, vehicle: str, span: Span) -> None:
        """Raise where logs are in the windows that an exchange of this span of the vehicle's clock touches.

        Raises
        ------
        ConflictError
            There are.
        """
        _, _, from_ns, to_ns = needed_range(*span, self.length_ns)
        _check_one_kind(vehicle, EXCHANGE_SUFFIX, unit.chunks.overlapping(vehicle, from_ns, to_ns))

    def assemble(self, unit: SqlUnitOfWork, record: ChunkRecord, recording: Recording) -> Assembly:
        """Assemble the windows that a stored recording touches.

        Raises
        ------
        NotFoundError
            The registry does not know the vehicle.
        ConflictError
            Logs of its bus and exchanges would share a window.
        StorageError
            A recording that is needed cannot be read any more.
        """
        vehicle = unit.registry.vehicle(record.vehicle)
        sources = self.sources(unit, record, recording)
        _check_one_kind(record.vehicle, record.suffix, sources)
        loaded = {source.digest: self.recordings.load_neighbour(source) for source in sources[1:]}
        loaded[record.digest] = recording
        aligned = align_recordings(loaded.values())
        coming = [(source, loaded[source.digest]) for source in sources if source.state is not ChunkState.DECODED]
        spans = [_span(each, aligned) for _, each in coming]
        receipts = [_receipt_after(*each, span) for each, span in zip(coming, spans, strict=True)]
        known = [span for span in spans if span is not None]
        if not known:
            return Assembly(frozenset(loaded), tuple(receipts), ())
        samples, counts = _samples(vehicle.code, recording.catalogue, merge_aligned(aligned))
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


def _samples(
    vehicle: str, catalogue: Catalogue, messages: Mapping[int, TickedValues]
) -> tuple[VehicleSamples, AlignCounts]:
    if isinstance(catalogue, OwnBus):
        return own_samples(vehicle, catalogue, messages)
    return vehicle_samples(vehicle, catalogue, messages)


def _check_one_kind(vehicle: str, suffix: str, sources: Iterable[ChunkRecord]) -> None:
    """Raise where logs and exchanges meet in a window: they have different filters and clocks."""
    of_exchange = suffix == EXCHANGE_SUFFIX
    other = next((source for source in sources if (source.suffix == EXCHANGE_SUFFIX) != of_exchange), None)
    if other is not None:
        kinds = ("an exchange", "a log") if of_exchange else ("a log", "an exchange")
        reason = f"{kinds[0]} of vehicle {vehicle} would share windows with {kinds[1]} that is stored"
        raise ConflictError(f"{reason}: {other.digest[:12]}", kind="chunk", key=other.digest)


def _span(recording: Recording, aligned: Iterable[AlignedFrames]) -> Span | None:
    """Return the span of a recording on the vehicle's clock: by its own TIME frames, else by those beside it."""
    if recording.frames == 0:
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
    record = replace(record, frames=recording.frames, counts=counts)
    if span is None and recording.frames:
        return replace(record, reason=WAITING)
    first_ns, last_ns = span or (None, None)
    return replace(record, state=ChunkState.DECODED, reason=None, first_ns=first_ns, last_ns=last_ns)


def _with_counts(record: ChunkRecord, more: Mapping[str, int]) -> ChunkRecord:
    return replace(record, counts={**record.counts, **more})


def _nonzero(counts: Mapping[str, int]) -> dict[str, int]:
    return {name: count for name, count in counts.items() if count}

"""Reassembly: windows are made again where recordings, the registry, or their own files are no longer what they were.

Whoever changes what windows are made from leaves a stale span in the same transaction. :class:`Reassembler` works them
off: piece by piece, each piece committed with the part of the spans that it covers, so that a kill costs one piece.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from estimation.errors import NotFoundError, StoppedError, StorageError, TreadwatchError
from estimation.jobs.isolation import fails_alone
from estimation.storage import Clock
from estimation.values.runs import first_line
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.decoded_again import decode_again
from fleet_db.stores.stale_spans import StaleSpan
from ingest.align.clock import CONTEXT_NS
from ingest.assembly import Assembler, SpanAssembly, extent
from ingest.held import HeldVehicles, LostRecordings
from ingest.recordings import Span
from ingest.span_commit import NO_CHANGES, SpanChanges, commit, still_so

MOST_FRAMES = 1_000_000
"""Frames of the recordings of one piece, unless one recording has more."""

MOST_RECORDINGS = 500
"""Recordings of one piece."""

ATTEMPTS_BESIDE_OTHERS = 3
ASKED = "asked for"
OTHER_BUS = "was decoded with another bus than its vehicle has now"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Reassembler:
    """Makes the windows of stale spans again."""

    storage: SqlStorage
    assembler: Assembler
    clock: Clock

    @property
    def lost(self) -> LostRecordings:
        """Recordings that were missing when windows were to be made of them again."""
        return LostRecordings(self.storage, self.assembler.recordings.raw, self.clock)

    def reassemble(self, vehicle: str, from_ns: int | None, to_ns: int | None) -> SpanChanges:
        """Make the windows of a vehicle in ``[from_ns, to_ns)`` again, and all that is stale of it; None is open.

        Raises:
            NotFoundError: The registry does not know the vehicle.
            StorageError: The raw recordings or the database cannot be reached; what is left stays stale.
        """
        with self.storage.write() as unit:
            unit.registry.vehicle(vehicle)
            unit.stale_spans.add(vehicle, from_ns, to_ns, ASKED)
        return self.work_off(vehicle)

    def work_off(self, vehicle: str | None = None, checkpoint: Callable[[int, int], None] | None = None) -> SpanChanges:
        """Work off the stale spans of one vehicle or of all; one that fails does not keep the others waiting.

        A vehicle that fails goes to quarantine. Among all it is left out until it is due again, or more is stale of it.

        Args:
            vehicle: Code of the only one, due or not.
            checkpoint: Called after each piece with the number of spans that are done and of all.

        Raises:
            TreadwatchError: The one vehicle failed; or raw recordings or database cannot be reached, after all others
                are done. What is left stays stale.
        """
        self.lost.look(vehicle)
        with self.storage.read() as unit:
            spans = unit.stale_spans.all(vehicle)
        changes, done = NO_CHANGES, 0
        failed: list[TreadwatchError] = []
        held = HeldVehicles(self.storage, self.clock)
        for code in dict.fromkeys(span.vehicle for span in spans):
            own = [span for span in spans if span.vehicle == code]
            if vehicle is None and held.waits(code, own):
                changes += SpanChanges(quarantined=1)
                continue
            pieces = self._pieces(code, own)
            while (made := _next(pieces)) is not None:
                if isinstance(made, Exception):
                    held.hold(code, own, made)
                    changes += SpanChanges(quarantined=1)
                    failed += _raised(made, alone=vehicle is not None)
                    break
                changes += made
                if checkpoint is not None:
                    checkpoint(done, len(spans))
            else:
                held.release(code)
            done += len(own)
        if failed:
            raise failed[0]
        return changes

    def _pieces(self, vehicle: str, spans: Sequence[StaleSpan]) -> Iterator[SpanChanges]:
        for part in joined(spans):
            yield from self._work_off(vehicle, part)

    def _work_off(self, vehicle: str, spans: Sequence[StaleSpan]) -> Iterator[SpanChanges]:
        """Work off spans of a vehicle that touch each other, piece by piece."""
        from_ns, to_ns = spans[0].from_ns, max(span.to_ns for span in spans)
        while True:
            with self.storage.read() as unit:
                piece = self._next_piece(unit, vehicle, (from_ns, to_ns)) if _on_file(unit, vehicle) else None
            if piece is None:
                with self.storage.write() as unit:
                    unit.stale_spans.remove(spans)
                return
            yield self._assemble(vehicle, piece, spans)
            from_ns = piece[1]

    def _assemble(self, vehicle: str, piece: Span, spans: Sequence[StaleSpan]) -> SpanChanges:
        for _ in range(ATTEMPTS_BESIDE_OTHERS):
            with self.storage.read() as unit:
                assembly = self.assembler.assemble(unit, vehicle, piece, keep_unreadable=True)
            with self.storage.write() as unit:
                unit.assemble_alone(vehicle)
                if still_so(unit, self.assembler, assembly):
                    return self._commit(unit, assembly, spans)
        with self.storage.write() as unit:
            unit.assemble_alone(vehicle)
            return self._commit(unit, self.assembler.assemble(unit, vehicle, piece, keep_unreadable=True), spans)

    def _commit(self, unit: SqlUnitOfWork, assembly: SpanAssembly, spans: Sequence[StaleSpan]) -> SpanChanges:
        unit.stale_spans.advance(spans, assembly.to_ns)
        if assembly.lost:
            _log.warning("vehicle %s: %d recordings cannot be read any more", assembly.vehicle, len(assembly.lost))
            self.lost.note(unit, assembly.lost)
        for record in assembly.again:
            cause = f"recording {record.digest[:12]}: {OTHER_BUS}"
            for first_ns, last_ns in extent(record):
                unit.stale_spans.add(record.vehicle, first_ns, last_ns + 1, cause)
            decode_again(unit.chunks, record, OTHER_BUS, self.clock.now_ns())
        return commit(unit, assembly, self.clock.now_ns(), verify=True)

    def _next_piece(self, unit: SqlUnitOfWork, vehicle: str, span: Span) -> Span | None:
        """Return the first part of a span that holds recordings or windows, at the edges of windows."""
        from_ns, to_ns = span
        if from_ns >= to_ns:
            return None
        length = self.assembler.length_ns
        extents = unit.assembled.extents(vehicle, from_ns - length, to_ns + length, MOST_RECORDINGS)
        stored = unit.assembled.first_start(vehicle, from_ns - length, to_ns)
        begins = [first - CONTEXT_NS for first, _, _ in extents[:1]] + ([] if stored is None else [stored])
        if not begins:
            return None
        begin = max(from_ns, min(begins)) // length * length
        end, frames = to_ns, 0
        for place, (first, _, count) in enumerate(extents):
            frames += count
            if place and (frames > MOST_FRAMES or place == MOST_RECORDINGS - 1):
                end = min(to_ns, max(begin + length, (first - CONTEXT_NS) // length * length))
                break
        return None if begin >= end else (begin, end)


def joined(spans: Sequence[StaleSpan]) -> list[list[StaleSpan]]:
    """Return stale spans of one vehicle in groups that touch each other, by their begin.

    Args:
        spans: In any order.
    """
    groups: list[list[StaleSpan]] = []
    end = 0
    for span in sorted(spans, key=lambda one: (one.from_ns, one.id)):
        if groups and span.from_ns <= end:
            groups[-1].append(span)
            end = max(end, span.to_ns)
        else:
            groups.append([span])
            end = span.to_ns
    return groups


def _on_file(unit: SqlUnitOfWork, vehicle: str) -> bool:
    """Whether the registry knows a vehicle; of one that it does not there is no window."""
    try:
        unit.registry.vehicle(vehicle)
    except NotFoundError:
        return False
    return True


def _next(pieces: Iterator[SpanChanges]) -> SpanChanges | Exception | None:
    """Return what the next piece changed, or why it could not be assembled; None behind the last."""
    try:
        return next(pieces, None)
    except StoppedError:
        raise
    except Exception as error:  # noqa: BLE001 - it is kept with the vehicle
        return error


def _raised(error: Exception, *, alone: bool) -> list[TreadwatchError]:
    """Return what is raised of a failure at a vehicle: the one that was asked for, or where no other can succeed."""
    if not alone and fails_alone(error):
        return []
    return [error if isinstance(error, TreadwatchError) else StorageError(first_line(error))]

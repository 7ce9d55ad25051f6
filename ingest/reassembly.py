"""Stage: windows are made again where recordings, the registry, or their own files are no longer what they were.

Whoever changes what windows are made from leaves a stale span in the same transaction: it names which part of a vehicle
is due. It is worked off piece by piece, each committed with the part of the spans that it covers, so that a kill costs
one piece.

Beside it the quarantine of recordings: those at which decoding failed, tried again ever more rarely, and those whose
raw file was lost or damaged when windows were made again, made again once it is there.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

from estimation.errors import PassingFaultError, StorageError, TreadwatchError
from estimation.jobs.job import JobContext
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.jobs.stage import Counted, Outcome, Stage
from estimation.jobs.work import Isolation, fails_alone
from estimation.storage import Clock
from estimation.values.reasons import Reason
from estimation.values.runs import Quarantined, SubjectKind, after_failure, first_line, resolved
from fleet_db.raw import RawStore
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.assembled import EARLIEST_NS, StaleSpan
from fleet_db.stores.estimated_again import STAGE, decode_again
from ingest.align.clock import CONTEXT_NS
from ingest.assembly import Assembler, SpanAssembly, add_stale, extent
from ingest.recordings import Span
from ingest.span_commit import SpanChanges, commit, still_so

ASSEMBLY = "assemble_windows"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class HeldRecordings:
    """The quarantine of recordings."""

    storage: SqlStorage
    clock: Clock

    def hold(self, record: ChunkRecord, error: Exception) -> ChunkRecord:
        """Keep a failure at a stored recording; return its receipt, with the reason."""
        unexpected = None if isinstance(error, TreadwatchError) else error
        _log.warning("recording %s of %s is held: %s", record.digest, record.vehicle, error, exc_info=unexpected)
        with self.storage.write() as unit:
            now = unit.chunks.get(record.digest)
            if now is None or now.state is not ChunkState.STORED:  # somebody has decided on it meanwhile
                return now or record
            subject = (SubjectKind.RECORDING, record.digest, STAGE)
            item = after_failure(unit.quarantine.get(*subject), subject, record.vehicle, error, self.clock.now_ns())
            unit.quarantine.put(item)
            held = replace(now, reason=Reason(item.code, item.error))
            unit.chunks.update(held)
            return held

    def waiting(self) -> frozenset[str]:
        """Return the digests of recordings for which it is too early for another attempt.

        Of one that was moved to another vehicle it never is.
        """
        with self.storage.read() as unit:
            return frozenset(record.digest for record, early in self._held(unit) if early)

    def due(self, unit: SqlUnitOfWork) -> list[ChunkRecord]:
        """Return the stored recordings in quarantine for which another attempt is due."""
        return [record for record, early in self._held(unit) if not early and record.state is ChunkState.STORED]

    def _held(self, unit: SqlUnitOfWork) -> list[tuple[ChunkRecord, bool]]:
        now_ns = self.clock.now_ns()
        held = [(unit.chunks.get(item.key), item) for item in unit.quarantine.held(STAGE)]
        return [(record, item.waits(record.vehicle, now_ns)) for record, item in held if record is not None]

    def release(self, digest: str) -> None:
        """End the quarantine of a recording, if it was in one."""
        release(self.storage, (SubjectKind.RECORDING, digest, STAGE))


Subject = tuple[SubjectKind, str, str]  # kind, key and stage of what is in quarantine


def release(storage: SqlStorage, subject: Subject) -> None:
    """End the quarantine of a subject, if it was in one."""
    with storage.read() as unit:
        item = unit.quarantine.get(*subject)
    if item is not None and item != resolved(item):
        with storage.write() as unit:
            unit.quarantine.put(resolved(item))


CAUSE = "its raw file is there again"


@dataclass(frozen=True, slots=True)
class LostRecordings:
    """The quarantine of recordings that windows could not be made of again."""

    storage: SqlStorage
    raw: RawStore
    clock: Clock

    def note(self, unit: SqlUnitOfWork, lost: Iterable[ChunkRecord]) -> None:
        """Keep that recordings were missing, in the transaction that stores what could be made without them."""
        for record in lost:
            fault: PassingFaultError
            came = PassingFaultError("could not be read when windows were made again")
            try:
                fault = self.raw.fault(record.digest, record.suffix) or came
            except PassingFaultError as away:  # of the store: the recording was missing all the same
                fault = away
            _hold(unit, record, fault, self.clock.now_ns())

    def waits(self, record: ChunkRecord) -> bool:
        """Whether a recording was missing when windows were made again, and they wait for it."""
        with self.storage.read() as unit:
            item = unit.quarantine.get(SubjectKind.RECORDING, record.digest, ASSEMBLY)
        return item is not None and item != resolved(item)

    def look(self, vehicle: str | None = None) -> None:
        """Look for missing recordings that are due, and let the windows of those that are there again be made again.

        With a vehicle, for those of it alone, due or not.
        """
        now_ns = self.clock.now_ns()
        with self.storage.read() as unit:
            held = [(item, unit.chunks.get(item.key)) for item in missing(unit)]
        for item, record in held:
            if record is None or record.state is not ChunkState.DECODED or record.purged_ns is not None:
                self._resolve(item)  # it counts for no window, or will be decoded as a whole
            elif record.vehicle == vehicle or (vehicle is None and not item.waits(record.vehicle, now_ns)):
                try:
                    fault = self.raw.fault(record.digest, record.suffix)
                except PassingFaultError:
                    return  # of the store: nothing is known of what is in it
                if fault is None:
                    self._resolve(item, record)
                else:
                    with self.storage.write() as unit:
                        _hold(unit, record, fault, now_ns)

    def _resolve(self, item: Quarantined, *chunks: ChunkRecord) -> None:
        with self.storage.write() as unit:
            for record in chunks:
                add_stale(unit, record, f"recording {record.digest[:12]}: {CAUSE}")
            unit.quarantine.put(resolved(item))


def missing(unit: SqlUnitOfWork) -> list[Quarantined]:
    """Return what is in quarantine of recordings whose windows wait for their raw file."""
    return [item for item in unit.quarantine.held(ASSEMBLY) if item.kind is SubjectKind.RECORDING]


def _hold(unit: SqlUnitOfWork, record: ChunkRecord, fault: PassingFaultError, now_ns: int) -> None:
    subject = (SubjectKind.RECORDING, record.digest, ASSEMBLY)
    unit.quarantine.put(after_failure(unit.quarantine.get(*subject), subject, record.vehicle, fault, now_ns))


MOST_FRAMES = 1_000_000  # frames of the recordings of one piece, unless one recording has more
MOST_RECORDINGS = 500  # recordings of one piece
ASKED = "asked for"
OTHER_BUS = "was decoded with another bus than its vehicle has now"


@dataclass(frozen=True, slots=True)
class Piece:
    """The next piece of what is stale of a vehicle."""

    spans: Sequence[StaleSpan]  # that touch each other; it is at their begin
    assembly: SpanAssembly | None = field(metadata={"made_from": False})  # None: nothing there, or no such vehicle


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

    @property
    def stage(self) -> Stage[Piece, None]:
        """What is done of each vehicle."""
        return Stage(
            name=ASSEMBLY,
            job=ASSEMBLY,
            kind=SubjectKind.VEHICLE,
            facets=(),
            settings=lambda _: None,
            load=self._load,
            compute=lambda piece: Outcome(more=piece.assembly is not None),
            counted=Counted(looked="vehicles", changed="results", more=("new", "changed", "removed", "healed")),
            store=self._store,
            at_once=1,
        )

    def reassemble(self, vehicle: str, from_ns: int | None, to_ns: int | None) -> SpanChanges:
        """Make the windows of a vehicle in ``[from_ns, to_ns)`` again, and all that is stale of it; None is open.

        Raises StorageError where raw recordings or database cannot be reached; what is left stays stale.
        """
        with self.storage.write() as unit:
            unit.registry.vehicle(vehicle)
            unit.stale_spans.add(vehicle, from_ns, to_ns, ASKED)
        return self.work_off(vehicle)

    def work_off(self, vehicle: str | None = None) -> SpanChanges:
        """Work off the stale spans of all vehicles, each alone, or of one whatever quarantine says of it.

        Raises where that one failed, or raw recordings or database cannot be reached. What is left stays stale.
        """
        self.lost.look(vehicle)
        context = JobContext(self.storage, self.clock, "", JobSettings())
        counts = run(self.stage, context) if vehicle is None else self._now(vehicle, context)
        return SpanChanges(**{each.name: counts.get(each.name, 0) for each in fields(SpanChanges)})

    def _now(self, vehicle: str, context: JobContext) -> Counter[str]:
        counts: Counter[str] = Counter()
        isolation = Isolation(context, ASSEMBLY)
        more = True
        try:
            while more:
                with self.storage.read() as unit:
                    loaded = self._load(unit, [vehicle], context)
                made = {code: (piece, self.stage.compute(piece)) for code, piece in loaded.items()}
                with self.storage.write() as unit:
                    counts.update(self._store(unit, context, made))
                more = any(outcome.more for _, outcome in made.values())
        except Exception as error:
            if fails_alone(error):
                isolation.keep(SubjectKind.VEHICLE, vehicle, "", error)
            raise error if isinstance(error, TreadwatchError) else StorageError(first_line(error)) from error
        isolation.release(SubjectKind.VEHICLE, vehicle)
        return counts

    def _load(self, unit: SqlUnitOfWork, vehicles: Sequence[str], _: JobContext) -> Mapping[str, Piece]:
        """Return the next piece of each vehicle of which something is stale."""
        pieces = {}
        for vehicle in vehicles:
            spans = first_group(unit.stale_spans.all(vehicle))
            if spans:
                within = (spans[0].from_ns, max(span.to_ns for span in spans))
                part = self._next_piece(unit, vehicle, within) if unit.registry.vehicles_of([vehicle]) else None
                pieces[vehicle] = Piece(spans, None if part is None else self._assembled(unit, vehicle, part))
        return pieces

    def _assembled(self, unit: SqlUnitOfWork, vehicle: str, part: Span) -> SpanAssembly:
        return self.assembler.assemble(unit, vehicle, part, keep_unreadable=True)

    def _store(
        self, unit: SqlUnitOfWork, _: JobContext, made: Mapping[str, tuple[Piece, Outcome[None]]]
    ) -> Mapping[str, int]:
        """Store pieces; one is assembled again where recordings or the registry have changed meanwhile."""
        counts: Counter[str] = Counter()
        for vehicle, (piece, _outcome) in made.items():
            unit.assemble_alone(vehicle)
            assembly = piece.assembly
            if assembly is None:
                unit.stale_spans.remove(piece.spans)
                continue
            if not still_so(unit, self.assembler, assembly):
                assembly = self._assembled(unit, vehicle, (assembly.from_ns, assembly.to_ns))
            changes = self._commit(unit, assembly, piece.spans)
            counts.update({name: getattr(changes, name) for name in self.stage.counted.more})
        return counts

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


def first_group(spans: Sequence[StaleSpan]) -> list[StaleSpan]:
    """Return those of the stale spans of a vehicle, in any order, that touch the first one or each other behind it."""
    group: list[StaleSpan] = []
    end_ns = EARLIEST_NS
    for span in sorted(spans, key=lambda span: (span.from_ns, span.id)):
        if group and span.from_ns > end_ns:
            break
        group.append(span)
        end_ns = max(end_ns, span.to_ns)
    return group

"""The receiver: a recording comes in, its bytes are stored, and the windows that it touches are assembled again.

Order of events: bytes durable in the raw store, receipt committed, only then is it reported as stored. Windows and
the receipt's new state are committed together. Whatever happens in between, :meth:`Receiver.decode_stored` goes on
from the receipts.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from opentelemetry import trace

from estimation.errors import ConflictError, LogFileError, NotFoundError, TreadwatchError
from estimation.storage import Clock
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import SECOND_NS
from fleet_db.raw import RawStore, check_raw_store
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.assembly import Assembler
from ingest.catalogue import Catalogue
from ingest.exchange.intake import check_alone, checked_exchange
from ingest.exchange.run import SUFFIX as EXCHANGE_SUFFIX
from ingest.exchange.run import write_bundle
from ingest.logs.formats import format_of
from ingest.reassembly import HeldRecordings, Reassembler
from ingest.receipts import (
    UNDECODABLE,
    Announce,
    Chunk,
    Decoded,
    DeletedRecordings,
    ReceivedFile,
    enter_receipt,
    of_another_vehicle,
    to_nobody,
)
from ingest.recordings import Recording, Recordings
from ingest.span_commit import NO_CHANGES, commit, still_so
from ingest.stored_settings import BusChoice

READ_AHEAD = 3
ATTEMPTS_BESIDE_OTHERS = 3
"""How often a recording is assembled while others are stored, before the others have to wait for it."""


@dataclass(frozen=True, slots=True)
class ChunkReceipt:
    """What the sender of a recording gets back."""

    record: ChunkRecord
    known: bool  # the same bytes had been received before
    windows_changed: int  # windows that are new or have other content now


class Receiver:
    """Takes recordings in.

    Recordings that were deleted are refused, or taken in again where somebody (``deleted_taken_by``) wants that.
    """

    def __init__(
        self,
        storage: SqlStorage,
        raw: RawStore,
        catalogue: Catalogue | BusChoice,
        clock: Clock,
        window_length_s: float = 60.0,
        deleted_taken_by: str | None = None,
        announce: Announce = to_nobody,
    ) -> None:
        self._storage = storage
        self._raw = raw
        self._buses = catalogue if isinstance(catalogue, BusChoice) else BusChoice(catalogue, {})
        self._clock = clock
        self._announce = announce
        self._recordings = Recordings(raw, lambda vehicle: self._buses.of_vehicle(self._class_of, vehicle))
        self._held = HeldRecordings(storage, clock)
        self._deleted = DeletedRecordings(storage, deleted_taken_by)
        self._mark: str | None = None
        self._assembler = Assembler(self._recordings, round(window_length_s * SECOND_NS))
        self.reassembler = Reassembler(storage, self._assembler, clock)

    def receive_file(self, path: Path, vehicle: str) -> ChunkReceipt:
        """Take in one recording of a vehicle.

        Where decoding fails for a passing fault or by a failure of the program the recording is stored all the same,
        with its reason, and tried again by :meth:`decode_stored`. Raises LogFileError where it is damaged (its bytes
        are kept with a receipt that says so, unless it is no log by its suffix), NotFoundError where the registry does
        not know the vehicle (it is kept until it does), ConflictError where it is of another vehicle, or deleted.
        """
        return self.accept(self._store_and_read(path, vehicle))

    def receive_exchange(self, description: Path) -> ChunkReceipt:
        """Take in one exchange of runs; nothing of it is stored unless all of it is good.

        Raises ConflictError where the windows have logs of the vehicle's bus, or its time another exchange.
        """
        with self._storage.read() as unit:
            exchange = checked_exchange(description, unit)
            self._assembler.check_no_logs(unit, exchange.vehicle, (exchange.first_ns, exchange.last_ns))
        with TemporaryDirectory(prefix="treadwatch-exchange-") as folder:
            bundle = Path(folder) / f"{description.stem}{EXCHANGE_SUFFIX}"
            write_bundle(bundle, description, exchange.table, exchange.facts)
            with bundle.open("rb") as file, self._storage.read() as unit:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
                check_alone(unit, exchange.vehicle, exchange.first_ns, exchange.last_ns, digest)
            return self.receive_file(bundle, exchange.vehicle)

    def receive_files(self, files: Iterable[tuple[Path, str]]) -> Iterator[tuple[Path, ChunkReceipt | Exception]]:
        """Take in many recordings ``(path, vehicle)``; the next are read while one is stored.

        Yields the receipt of each, or the error that :meth:`receive_file` would have raised: one bad file does not
        stop the others.
        """
        with ThreadPoolExecutor(1, thread_name_prefix="read-ahead") as reader:
            coming: list[tuple[Path, Future[ReceivedFile]]] = []
            remaining = iter(files)
            while True:
                while len(coming) < READ_AHEAD and (following := next(remaining, None)) is not None:
                    coming.append((following[0], reader.submit(self._store_and_read, *following)))
                if not coming:
                    return
                path, received = coming.pop(0)
                try:
                    yield path, self.accept(received.result())
                except Exception as error:  # noqa: BLE001 - whatever fails at one file, the others go on
                    yield path, error

    def accept(self, received: ReceivedFile) -> ChunkReceipt:
        """Commit the receipt of a received file, then decode it; raises as :meth:`receive_file`."""
        record, known = self._receipt(received.path, received.vehicle, received.digest)
        if record.state is ChunkState.REJECTED:
            raise LogFileError(str(record.reason), file=received.path)
        if record.state is ChunkState.DECODED:
            return ChunkReceipt(record, known=True, windows_changed=self._healed(record))
        if record.state is not ChunkState.STORED:
            return ChunkReceipt(record, known=True, windows_changed=0)
        if not isinstance(received.recording, Exception):
            self._recordings.keep(received.recording)
        return self._decoded(record, received.recording, known=known, path=received.path)

    def keep(self, content: bytes, suffix: str, vehicle: str, name: str) -> tuple[ChunkRecord, bool]:
        """Store a recording and commit its receipt; nothing of it is decoded.

        Return the receipt, and whether it had been there before.
        """
        self._check_raw()
        deleted = self._deleted.receipt(hashlib.sha256(content).hexdigest())
        if deleted is not None:  # its receipt had been there, and somebody decided on it
            return deleted, True
        return self._receipt(Path(name).with_suffix(suffix), vehicle, self._raw.put_bytes(content, suffix))

    def decode_one(self, record: ChunkRecord) -> ChunkReceipt:
        """Decode a recording that has its receipt; raises as :meth:`receive_file`."""
        if record.state is ChunkState.REJECTED:
            raise LogFileError(str(record.reason))
        if record.state is not ChunkState.STORED:
            return ChunkReceipt(record, known=True, windows_changed=0)
        recording: Recording | Exception
        try:
            recording = self._recordings.load(record)
        except Exception as error:  # noqa: BLE001 - it is kept with the recording
            recording = error
        return self._decoded(record, recording, known=False)

    def decode_stored(
        self, digest: str | None = None, vehicle: str | None = None
    ) -> Iterator[ChunkReceipt | Exception]:
        """Decode every recording that is stored and not decoded yet: after a crash, or a new entry of the registry.

        One that failed before is left out until it is due again, unless it is the only one, named by its digest.
        Yields the new receipt of each, or why it still cannot be decoded.
        """
        try:
            self._check_raw()
        except TreadwatchError as error:
            yield error
            return
        with self._storage.read() as unit:
            stored = unit.chunks.with_state(ChunkState.STORED, limit=1_000_000)
        early = self._held.waiting() if digest is None else frozenset()
        yield from self.decode(
            r for r in stored if r.digest not in early and digest in {None, r.digest} and vehicle in {None, r.vehicle}
        )

    def decode(self, stored: Iterable[ChunkRecord]) -> Iterator[ChunkReceipt | Exception]:
        """Decode recordings that are stored; yield as :meth:`decode_stored`."""
        for record in stored:
            try:
                yield self.decode_one(record)
            except Exception as error:  # noqa: BLE001 - whatever fails at one recording, the others go on
                yield error

    def _decoded(
        self, record: ChunkRecord, recording: Recording | Exception, *, known: bool, path: Path | None = None
    ) -> ChunkReceipt:
        """Decode a stored recording that was read, or keep why it could not be; raises as :meth:`receive_file`."""
        changed = 0
        try:
            with trace.get_tracer("treadwatch").start_as_current_span("recording") as span:
                record, changed = self._decode(record, recording)
                span.set_attributes({"treadwatch.frames": record.frames, "treadwatch.windows_changed": changed})
        except LogFileError as error:
            text = error.reason if error.line is None else f"line {error.line}: {error.reason}"
            rejected = replace(record, state=ChunkState.REJECTED, reason=Reason(ReasonCode.LOG_DAMAGED, text))
            with self._storage.write() as unit:
                unit.chunks.update(rejected)
            self._held.release(record.digest)
            raise LogFileError(error.reason, file=path or error.file, line=error.line) from error
        except NotFoundError:
            raise  # its receipt says so
        except ConflictError as error:
            self._held.hold(record, error)
            raise
        except Exception as error:  # noqa: BLE001 - the recording is stored, and stays so until it can be decoded
            return ChunkReceipt(self._held.hold(record, error), known=known, windows_changed=0)
        self._held.release(record.digest)
        if record.state is ChunkState.REJECTED and record.reason is not None:  # its clock cannot be believed
            raise LogFileError(record.reason.text, file=path)
        return ChunkReceipt(record, known=known, windows_changed=changed)

    def _check_raw(self) -> None:
        """Refuse a store of raw recordings that is not that of the database; raises PassingFaultError."""
        if self._mark is None or self._raw.read_mark() != self._mark:
            self._mark = check_raw_store(self._storage, self._raw, self._clock.now_ns())

    def _healed(self, record: ChunkRecord) -> int:
        """Make the windows of a decoded recording again where a file of theirs, or its own, was lost.

        Return how many changed.
        """
        if record.first_ns is None or record.last_ns is None:
            return 0
        from_ns, to_ns = record.first_ns - self._assembler.length_ns, record.last_ns + 1
        with self._storage.read() as unit:
            windows = unit.assembled.of_vehicle(record.vehicle, from_ns, to_ns)
            intact = all(unit.assembled.intact(window, verify=False) for window in windows)
        if intact and not self.reassembler.lost.waits(record):
            return 0
        return self.reassembler.reassemble(record.vehicle, record.first_ns, to_ns).windows

    def _class_of(self, vehicle: str) -> str | None:
        try:
            with self._storage.read() as unit:
                return unit.registry.vehicle(vehicle).vehicle_class
        except NotFoundError:
            return None

    def _store_and_read(self, path: Path, vehicle: str) -> ReceivedFile:
        _suffix_of(path)  # of no log: nothing of it is stored
        self._check_raw()
        recording: Recording | Exception
        with self._raw.taken_in(path, self._deleted.admit) as (digest, file):
            try:
                recording = self._recordings.read(file, digest, vehicle)
            except Exception as error:  # noqa: BLE001 - the bytes are stored: what it is about shows with the receipt
                recording = error
        return ReceivedFile(path, vehicle, digest, recording)

    def _receipt(self, path: Path, vehicle: str, digest: str) -> tuple[ChunkRecord, bool]:
        suffix = _suffix_of(path)
        chunk = Chunk(vehicle, suffix, str(path), sender=None)
        record = replace(chunk.receipt(digest, self._raw.size(digest, suffix), self._clock.now_ns()), reason=None)
        with self._storage.write() as unit:
            stored, known = enter_receipt(unit, record, self._deleted)
        if stored.vehicle != vehicle:
            raise of_another_vehicle(stored, vehicle, str(path))
        self._announce(stored)
        return stored, known

    def _decode(self, record: ChunkRecord, recording: Recording | Exception) -> tuple[ChunkRecord, int]:
        if isinstance(recording, Exception):
            raise recording
        try:
            for _ in range(ATTEMPTS_BESIDE_OTHERS):
                with self._storage.read() as unit:
                    made = self._assembled(unit, record, recording)
                with self._storage.write() as unit:
                    unit.assemble_alone(record.vehicle)
                    if self._still_so(unit, record, recording, made):
                        return self._commit(unit, made)
                # another recording of the vehicle, or the registry, was committed meanwhile
            with self._storage.write() as unit:
                unit.assemble_alone(record.vehicle)
                return self._commit(unit, self._assembled(unit, record, recording))
        except NotFoundError as error:
            with self._storage.write() as unit:
                unit.chunks.update(replace(record, reason=Reason(ReasonCode.VEHICLE_UNKNOWN, str(error))))
            raise

    def _still_so(self, unit: SqlUnitOfWork, record: ChunkRecord, recording: Recording, made: Decoded) -> bool:
        if made.assembly is not None and not still_so(unit, self._assembler, made.assembly, made.receipts):
            return False
        return self._assembler.placed(unit, record, recording) == made.receipts

    def _commit(self, unit: SqlUnitOfWork, made: Decoded) -> tuple[ChunkRecord, int]:
        for receipt in made.receipts:
            now = unit.chunks.get(receipt.digest)
            if now is None or now.vehicle != receipt.vehicle or now.state in UNDECODABLE:
                raise ConflictError(
                    f"recording {receipt.digest[:12]} changed meanwhile", kind="chunk", key=receipt.digest
                )
        changes, counts = NO_CHANGES, made.receipts[0].counts
        if made.assembly is not None:
            changes = commit(unit, made.assembly, self._clock.now_ns())
            counts = {**counts, **made.assembly.counts}
        decoded = replace(made.receipts[0], counts=counts)
        for receipt in (decoded, *made.receipts[1:]):
            unit.chunks.update(receipt)
        return decoded, changes.windows

    def _assembled(self, unit: SqlUnitOfWork, record: ChunkRecord, recording: Recording) -> Decoded:
        unit.registry.vehicle(record.vehicle)
        receipts = self._assembler.placed(unit, record, recording)
        self._assembler.check_one_kind(unit, receipts[0])
        span = self._assembler.touched(receipts)
        if span is None:
            return Decoded(receipts, None)
        coming = [receipt for receipt in receipts if receipt.state is ChunkState.DECODED]
        return Decoded(receipts, self._assembler.assemble(unit, record.vehicle, span, coming))


def _suffix_of(path: Path) -> str:
    return EXCHANGE_SUFFIX if path.suffix == EXCHANGE_SUFFIX else format_of(path).suffix

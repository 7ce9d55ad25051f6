"""The thread that stores: pieces of the spool become recordings with a receipt, then they are decoded.

A piece is removed when its receipt is committed, and for no other reason. Faults that pass (no database, no space, no
mount) are waited out; a piece that cannot be stored for another reason is set aside, so that it harms itself only.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.errors import (
    ConflictError,
    LogFileError,
    MigrationError,
    PassingFaultError,
    StorageError,
    TreadwatchError,
)
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.runs import first_line
from fleet_db.records import ChunkRecord, ChunkState
from ingest.frames import DEFAULT_CHANNEL, concatenate, dropped_marker, from_owned_arrays, sort_by_time
from ingest.live.spool import FRAME, Piece, Spool, decode
from ingest.live.status import Backoff, LiveStatus, Reports
from ingest.logs.blf_layout import blf_bytes
from ingest.receiver import ChunkReceipt, Receiver

RECORDING_SUFFIX = ".blf"


@dataclass(frozen=True, slots=True)
class PieceRecording:
    """What a piece becomes."""

    content: bytes  # of a BLF file
    frames: int
    dropped: int
    first_ns: int


def read_piece(path: Path) -> PieceRecording | None:
    """Return the recording of a piece; None when no frame of it is whole."""
    records = decode(path.read_bytes()).records
    packed = np.frombuffer(b"".join(record.frames for record in records), FRAME)
    if len(packed) == 0:
        return None
    dropped = sum(record.dropped for record in records)
    parts = [
        from_owned_arrays(
            DEFAULT_CHANNEL,
            packed["t_ns"].astype(np.int64),
            packed["arbitration_id"].astype(np.uint32),
            packed["dlc"].astype(np.uint8),
            np.ascontiguousarray(packed["data"]),
        )
    ]
    if dropped:
        before_gap = next(record for record in records if record.dropped)
        last_ns = int(np.frombuffer(before_gap.frames, FRAME)["t_ns"][-1])
        parts.append(dropped_marker(last_ns, dropped, DEFAULT_CHANNEL))
    batch = sort_by_time(concatenate(parts))
    return PieceRecording(blf_bytes(batch), len(packed), dropped, int(batch.t_ns[0]))


PASSING = (StorageError, PassingFaultError, OSError, MemoryError)
FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 15.0
DECODE_FIRST_DELAY_S, DECODE_LONGEST_DELAY_S = 1.0, 300.0

ATTEMPTS = 3  # with a piece that fails for a reason of its own
LOOK_EVERY_S = 0.5
CHECK_EVERY_S = 15.0  # the database is asked whether it answers when nothing was stored for so long


@dataclass(frozen=True, slots=True)
class Stores:
    """Where pieces go."""

    connect: Callable[[], Receiver]  # raises StorageError while they are away, else another error
    check: Callable[[], None]  # raises where the database does not answer


class Storing:
    """Stores pieces until asked to end, then those that can be stored in the time that is left.

    An error of :attr:`Stores.connect` that does not pass is kept as ``refused``.
    """

    def __init__(self, spool: Spool, vehicle: str, stores: Stores, status: LiveStatus, reports: Reports) -> None:
        self._spool = spool
        self._vehicle = vehicle
        self._stores = stores
        self._status = status
        self._reports = reports
        self._ending = threading.Event()
        self._delays = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S)
        self._decode_delays = Backoff(DECODE_FIRST_DELAY_S, DECODE_LONGEST_DELAY_S)
        self._decode_at: float | None = 0.0  # what is stored and not decoded; at the start whatever there is
        self._checked_at = 0.0
        self._attempts = 0
        self._delayed = False
        self.refused: TreadwatchError | None = None

    def end(self) -> None:
        """Make :meth:`run` store what waits, and return at the first fault that passes."""
        self._ending.set()

    def run(self) -> None:
        """Store."""
        receiver = self._connected()
        while receiver is not None:
            piece = self._spool.oldest()
            if piece is not None:
                if not self._store(receiver, piece) and self._pause():
                    return
            elif self._ending.is_set():
                return
            else:
                self._idle(receiver)

    def _connected(self) -> Receiver | None:
        while True:
            try:
                receiver = self._stores.connect()
            except MigrationError as error:
                self.refused = error
                return None
            except PASSING as error:
                self._wait_out(error)
                if self._pause():
                    return None
            except TreadwatchError as error:
                self.refused = error
                return None
            else:
                self._answered()
                return receiver

    def _store(self, receiver: Receiver, piece: Piece) -> bool:
        try:
            recording = read_piece(piece.path)
            if recording is not None:
                name = f"{self._vehicle}__{recording.first_ns}"
                record, _ = receiver.keep(recording.content, RECORDING_SUFFIX, self._vehicle, name)
            self._spool.remove(piece)
        except PASSING as error:
            self._wait_out(error)
            return False
        except Exception as error:  # noqa: BLE001 - one piece must not keep the others from their receipts
            return self._failed(piece, error)
        self._attempts = 0
        self._answered()
        if recording is not None:
            self._status.pieces_stored += 1
            self._status.last_receipt_s = time.time()
            name += RECORDING_SUFFIX
            frames, dropped = recording.frames, recording.dropped
            self._reports.say(f"{name}: {frames:,} frames stored, {dropped:,} dropped", bad=dropped > 0)
            self._decode(receiver, record, name, frames)
        return True

    def _failed(self, piece: Piece, error: Exception) -> bool:
        """Try a piece that has a fault of its own again, in the end set it aside; return whether that is done."""
        self._attempts += 1
        if self._attempts < ATTEMPTS and not isinstance(error, ConflictError):
            return False
        self._attempts = 0
        try:
            self._spool.set_aside(piece)
        except OSError as fault:
            self._wait_out(fault)
            return False
        self._reports.say(f"set aside {piece.path.name}, it cannot be stored: {first_line(error)}", bad=True)
        return True

    def _decode(self, receiver: Receiver, record: ChunkRecord, name: str, frames: int) -> None:
        outcome: ChunkReceipt | Exception
        try:
            outcome = receiver.decode_one(record)
        except Exception as error:  # noqa: BLE001 - one recording must not keep the others from being decoded
            outcome = error
        if self._report(name, outcome, frames):
            return
        reason = outcome.record.reason if isinstance(outcome, ChunkReceipt) else first_line(outcome)
        self._reports.say(f"stored, not decoded yet: {name}: {reason}", bad=True)

    def _report(self, name: str, outcome: ChunkReceipt | Exception, frames: int = 0) -> bool:
        if isinstance(outcome, LogFileError):
            self._status.pieces_rejected += 1
            self._status.frames_rejected += frames
            self._status.rejected_in_a_row += 1
            self._status.last_rejection = outcome.reason
            counted = f", {self._status.rejected_in_a_row} in a row" if self._status.rejected_in_a_row > 1 else ""
            self._reports.say(f"rejected {name}{counted}: {outcome.reason}", bad=True)
        elif isinstance(outcome, Exception) or (
            outcome.record.state is ChunkState.STORED
            # one that waits for the recording beside it is decoded with that
            and code_of(outcome.record.reason) is not ReasonCode.WAITS_FOR_TIME
        ):
            if self._decode_at is None:
                self._decode_at = time.monotonic() + self._decode_delays.failed()
            return False
        else:
            self._decode_delays.succeeded()
            if outcome.record.state is ChunkState.DECODED:
                self._status.rejected_in_a_row, self._status.decoded = 0, True
        self._reports.received(name, outcome)
        return True

    def _idle(self, receiver: Receiver) -> None:
        now = time.monotonic()
        if self._decode_at is not None and now >= self._decode_at:
            self._decode_at = None
            try:
                for outcome in receiver.decode_stored(vehicle=self._vehicle):
                    self._report(outcome.record.digest if isinstance(outcome, ChunkReceipt) else "a recording", outcome)
                    if self._ending.is_set():
                        return
            except Exception as error:  # noqa: BLE001 - it is tried again
                self._report("", error)
        elif now - self._checked_at >= CHECK_EVERY_S:
            try:
                self._stores.check()
            except Exception as error:  # noqa: BLE001 - whatever it is, it is reported and asked again
                self._checked_at = now
                self._status.database_fault = first_line(error)
            else:
                self._answered()
        else:
            self._ending.wait(LOOK_EVERY_S)

    def _answered(self) -> None:
        if self._delayed:
            self._reports.say("receipts are committed again")
        self._delayed = False
        self._status.database_fault = self._status.raw_fault = None
        self._checked_at = time.monotonic()
        self._delays.succeeded()

    def _wait_out(self, error: Exception) -> None:
        fault = first_line(error)
        self._checked_at = time.monotonic()
        if not self._delayed:
            self._reports.say(f"pieces wait in the spool, they cannot be stored now: {fault}", bad=True)
        self._delayed = True
        if isinstance(error, StorageError):
            self._status.database_fault = fault
        else:
            self._status.raw_fault = fault

    def _pause(self) -> bool:
        return self._ending.wait(self._delays.failed())

"""Receipts of several senders in one transaction: each waits for its own, and one commit serves all that wait."""

from __future__ import annotations

import queue
import threading
from concurrent.futures import Future
from dataclasses import dataclass

from estimation.errors import BusyError
from ingest.intake.store import Arrival, ChunkStorage, Stored

AT_ONCE = 64
"""Receipts of one transaction at most."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    arrival: Arrival
    stored: Future[Stored]


class ReceiptGroup:
    """One thread that commits receipts; it starts with the first, and its queue is bounded.

    Args:
        most_waiting: Arrivals that may wait; more are refused.
    """

    def __init__(self, storage: ChunkStorage, most_waiting: int) -> None:
        self._storage = storage
        self._queue: queue.Queue[_Waiting | None] = queue.Queue(maxsize=most_waiting)
        self._starting = threading.Lock()
        self._thread: threading.Thread | None = None

    def put(self, arrival: Arrival) -> Future[Stored]:
        """Hand an arrival over; what is returned ends with its committed receipt, or with why there is none.

        Args:
            arrival: Its file must stay where it is until then.

        Raises:
            BusyError: Too many wait already.
        """
        with self._starting:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="receipts", daemon=True)
                self._thread.start()
        waiting = _Waiting(arrival, Future())
        try:
            self._queue.put_nowait(waiting)
        except queue.Full:
            raise BusyError(f"{self._queue.maxsize} chunks wait for their receipts already") from None
        return waiting.stored

    def close(self) -> None:
        """Commit what waits, and end."""
        with self._starting:
            thread, self._thread = self._thread, None
        if thread is not None:
            self._queue.put(None)
            thread.join()

    def _run(self) -> None:
        going_on = True
        while going_on:
            batch, going_on = self._gather()
            if batch:
                self._store(batch)

    def _gather(self) -> tuple[list[_Waiting], bool]:
        """Return the first that comes, with what waits behind it, and whether more may come."""
        first = self._queue.get()
        batch: list[_Waiting] = []
        while first is not None:
            if first.stored.set_running_or_notify_cancel():
                batch.append(first)
            if len(batch) == AT_ONCE:
                return batch, True
            try:
                first = self._queue.get_nowait()
            except queue.Empty:
                return batch, True
        return batch, False

    def _store(self, batch: list[_Waiting]) -> None:
        try:
            answers = self._storage.store([waiting.arrival for waiting in batch])
        except Exception as error:  # noqa: BLE001 - whatever it is, each sender gets it, and the next batch is tried
            for waiting in batch:
                waiting.stored.set_exception(error)
            return
        for waiting, answer in zip(batch, answers, strict=True):
            if isinstance(answer, Stored):
                waiting.stored.set_result(answer)
            else:
                waiting.stored.set_exception(answer)

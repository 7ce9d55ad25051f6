"""What is written of access: changes, refusals, and when keys were used last; in a thread, beside the requests."""

from __future__ import annotations

import asyncio
import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from http import HTTPStatus

from starlette.types import Scope

from api.access.caller import known_caller
from api.access.gate import READING, Rate, address_of
from api.uploads import is_upload
from estimation.errors import TreadwatchError
from fleet_db.records import AuditEntry
from fleet_db.storage import SqlStorage

GATHER_S = 1.0  # refusals and uses are gathered for so long, so that they cost one transaction
WAITING = 10_000  # entries that wait to be written; beyond, they are lost, and the log says so
USED_EVERY_NS = 60_000_000_000  # when a key was used last is written at most this often, in nanoseconds
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Use:
    prefix: str
    at_ns: int


@dataclass(frozen=True, slots=True)
class _Change:
    entry: AuditEntry
    written: Future[None]


@dataclass(slots=True)
class AccessBook:
    """Writes in one thread, which starts with the first thing to write."""

    storage: Callable[[], SqlStorage]
    _queue: queue.Queue[AuditEntry | _Change | _Use | None] = field(
        default_factory=lambda: queue.Queue(maxsize=WAITING)
    )
    _used: dict[str, int] = field(default_factory=dict)
    _thread: threading.Thread | None = None

    def used(self, prefix: str, at_ns: int) -> None:
        """Note that a key was used; written at most once a minute."""
        if at_ns - self._used.get(prefix, 0) >= USED_EVERY_NS:
            self._used[prefix] = at_ns
            self._put(_Use(prefix, at_ns))

    def refused(self, entry: AuditEntry) -> None:
        """Note a refusal; written within a second."""
        self._put(entry)

    def changed(self, entry: AuditEntry) -> Future[None]:
        """Note a change; return what ends when it is written."""
        written: Future[None] = Future()
        if not self._put(_Change(entry, written)):
            written.set_result(None)
        return written

    def close(self) -> None:
        """Write what waits, and end."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None

    def _put(self, item: AuditEntry | _Change | _Use) -> bool:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="access-book", daemon=True)
            self._thread.start()
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            _log.error("the audit log cannot keep up; an entry is lost: %s", item)
            return False
        return True

    def _run(self) -> None:
        going_on = True
        while going_on:
            batch, going_on = self._gather()
            if batch:
                self._write(batch)

    def _gather(self) -> tuple[list[AuditEntry | _Change | _Use], bool]:
        """Return what is to be written together, as soon as somebody waits for it, and whether more may come."""
        batch: list[AuditEntry | _Change | _Use] = []
        until_s: float | None = None
        while len(batch) < WAITING:
            try:
                item = self._queue.get(timeout=None if until_s is None else max(0.0, until_s - time.monotonic()))
            except queue.Empty:
                return batch, True
            if item is None:
                return batch, False
            batch.append(item)
            if until_s is None:
                until_s = time.monotonic() + GATHER_S
            if isinstance(item, _Change):
                until_s = time.monotonic()  # with what else is there already
        return batch, True

    def _write(self, batch: list[AuditEntry | _Change | _Use]) -> None:
        entries = [item.entry if isinstance(item, _Change) else item for item in batch if not isinstance(item, _Use)]
        used = {item.prefix: item.at_ns for item in batch if isinstance(item, _Use)}
        try:
            with self.storage().write() as unit:
                unit.audit.add(entries)
                unit.api_keys.used(used)
        except TreadwatchError as error:
            _log.error("entries of the audit log could not be written: %s: %s", error, entries)
        finally:
            for item in batch:
                if isinstance(item, _Change):
                    item.written.set_result(None)


REFUSALS = frozenset({HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN})
_OF_ADDRESS = 60.0  # refusals of one address that are recorded in a minute: a stranger must not fill the disk


@dataclass(frozen=True, slots=True)
class Recorder:
    """Decides what is recorded, and has it written."""

    book: AccessBook
    refusals: Rate
    now_ns: Callable[[], int] = time.time_ns

    async def answered(self, scope: Scope, status: int, headers: Mapping[str, str], request_id: str) -> None:
        """Record how a request was answered, before its answer is sent: no change is answered that is not recorded.

        An upload is recorded in its receipt, with its sender: an entry beside each would be more rows than all else.
        """
        changed = scope["method"] not in READING and status < HTTPStatus.MULTIPLE_CHOICES and not is_upload(scope)
        if changed and "idempotency-replayed" not in headers:
            entry = self._entry(scope, status, headers, request_id)
            await asyncio.wrap_future(self.book.changed(entry))
        elif status in REFUSALS and self.refusals.take(address_of(scope) or "", time.monotonic()) is None:
            self.book.refused(self._entry(scope, status, headers, request_id))

    def _entry(self, scope: Scope, status: int, headers: Mapping[str, str], request_id: str) -> AuditEntry:
        caller = known_caller(scope)
        return AuditEntry(
            at_ns=self.now_ns(),
            owner=None if caller is None else caller.name,
            key_prefix=None if caller is None else caller.key_prefix,
            method=str(scope["method"])[:16],
            path=_written(scope["path"]),
            status=status,
            object=_written(headers.get("location", scope["path"])),
            address=address_of(scope),
            request_id=request_id,
        )


def recorder_of(book: AccessBook) -> Recorder:
    """Return the recorder of one app."""
    return Recorder(book, Rate(_OF_ADDRESS / 60.0, _OF_ADDRESS))


def _written(path: str) -> str:
    """Return a path as it may be stored: bounded, without the query, and with control characters escaped."""
    shown = "".join(sign if sign.isprintable() else f"%{ord(sign):02X}" for sign in path.partition("?")[0])
    return shown[:500]

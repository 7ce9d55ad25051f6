"""What of a request goes into the audit log: every change, and every refusal for want of a right."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus

from starlette.types import Scope

from api.access.book import AccessBook
from api.access.caller import known_caller
from api.access.gate import READING, address_of
from api.access.rates import Rate
from api.uploads.path import is_upload
from fleet_db.access_records import AuditEntry

REFUSALS = frozenset({HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN})
_OF_ADDRESS = 60.0
"""Refusals of one address that are recorded in a minute: a stranger must not fill the disk."""


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

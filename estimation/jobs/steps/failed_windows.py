"""Windows at which the estimation failed: refused, kept in quarantine, and let wait again when they are due."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from estimation.errors import NotFoundError
from estimation.failures import code_of_error, first_line
from estimation.jobs.isolation import Isolation, fails_alone
from estimation.jobs.job import JobContext
from estimation.values.reasons import Reason, code_of
from estimation.values.runs import SubjectKind
from estimation.values.windows import WindowRecord, WindowState, key_of_text, text_of_key

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class FailedWindow:
    """A window and what was raised at it."""

    record: WindowRecord
    error: Exception


def attempted(compute: Callable[[WindowRecord], T], record: WindowRecord) -> T | FailedWindow:
    """Return what a calculation makes of a window, or that it failed.

    Raises:
        StorageError: The database, or all of the files, cannot be used.
    """
    try:
        return compute(record)
    except Exception as error:
        if not fails_alone(error):
            raise
        return FailedWindow(record, error)


def refuse_failed(context: JobContext, isolation: Isolation, failed: Sequence[FailedWindow]) -> None:
    """Refuse windows at which something failed, with its reason, and keep them in quarantine."""
    for one in failed:
        record = one.record
        isolation.keep(SubjectKind.WINDOW, key_of(record), _inputs(context, record), one.error)
        reason = Reason(code_of_error(one.error), first_line(one.error))
        with suppress(NotFoundError), context.storage.write() as unit:  # it may be gone by now
            unit.windows.mark(record.wheelset, record.start_ns, WindowState.REFUSED, reason)


def release_others(isolation: Isolation, records: Sequence[WindowRecord], failed: Sequence[FailedWindow]) -> None:
    """End the quarantine of windows that were estimated or refused for a reason of their own."""
    again = {key_of(one.record) for one in failed}
    for record in records:
        if key_of(record) not in again:
            isolation.release(SubjectKind.WINDOW, key_of(record))


def let_due_wait_again(context: JobContext, isolation: Isolation) -> None:
    """Let windows that failed before wait for the estimation again where they are due; where they were, too."""
    for item in isolation.held(SubjectKind.WINDOW):
        with context.storage.read() as unit:
            record = unit.windows.get(*key_of_text(item.key))
        if record is None or code_of(record.reason) is not item.code:  # gone, or replaced since
            isolation.release(SubjectKind.WINDOW, item.key)
        elif not isolation.waits(SubjectKind.WINDOW, item.key, partial(_inputs, context, record)):
            with context.storage.write() as unit:
                unit.windows.requeue_axle(record.vehicle, record.axle, record.start_ns)


def key_of(record: WindowRecord) -> str:
    """Return the key of a window in quarantine."""
    return text_of_key(*record.key)


def _inputs(context: JobContext, record: WindowRecord) -> str:
    return f"{record.content_digest} {context.code_version}"

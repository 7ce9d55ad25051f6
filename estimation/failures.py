"""From what was raised to what is kept of it in quarantine."""

from __future__ import annotations

from estimation.errors import (
    ConflictError,
    DamagedError,
    PassingFaultError,
    StorageError,
    TreadwatchError,
    WorkersEndedError,
)
from estimation.values.reasons import ReasonCode
from estimation.values.runs import SECOND_NS, Quarantined, QuarantineState, SubjectKind, delay_s

ERROR_LENGTH = 500


def after_failure(
    before: Quarantined | None, subject: tuple[SubjectKind, str, str], inputs: str, error: Exception, now_ns: int
) -> Quarantined:
    """Return what is kept of a failure.

    Args:
        before: What is kept of the last failure at this; None for none.
    """
    again = before is not None and before.state is QuarantineState.HELD and before.inputs == inputs
    attempts = before.attempts + 1 if before is not None and again else 1
    code = code_of_error(error)
    return Quarantined(
        kind=subject[0],
        key=subject[1],
        stage=subject[2],
        code=code,
        error=first_line(error),
        inputs=inputs,
        first_ns=before.first_ns if before is not None and before.state is QuarantineState.HELD else now_ns,
        last_ns=now_ns,
        due_ns=now_ns + round(delay_s(code, attempts) * SECOND_NS),
        attempts=attempts,
    )


def code_of_error(error: Exception) -> ReasonCode:
    """Return the code that stands for what was raised."""
    if isinstance(error, PassingFaultError):
        return ReasonCode(error.code)
    if isinstance(error, WorkersEndedError):
        return ReasonCode.WORKERS_ENDED
    if isinstance(error, MemoryError):
        return ReasonCode.WAITS_FOR_MEMORY
    if isinstance(error, DamagedError):
        return ReasonCode.FILE_DAMAGED
    if isinstance(error, OSError | StorageError):
        return ReasonCode.WAITS_FOR_STORAGE
    return ReasonCode.CONFLICT if isinstance(error, ConflictError) else ReasonCode.PROCESSING_FAILED


def first_line(error: Exception) -> str:
    """Return the first line of an error, with its type where it was not raised on purpose."""
    text = str(error) if isinstance(error, TreadwatchError) else f"{type(error).__name__}: {error}"
    line = (text.splitlines() or [type(error).__name__])[0][:ERROR_LENGTH]
    return line.replace("\0", "\\0").encode(errors="backslashreplace").decode()

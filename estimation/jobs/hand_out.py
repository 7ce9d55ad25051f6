"""Units of work are handed out to whoever does them, at most so many at a time that no worker waits for the next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass

from estimation.errors import WorkFailedError
from estimation.jobs.claimed_work import claimed_work
from estimation.jobs.job import JobContext, Work

AHEAD = 2
"""Units in hand per unit that is worked on, so that no worker waits for the next."""
MOST_TRIES = 3
"""Workers that a unit is given to, one after the other, before the run fails."""
LOOK_S = 1.0
"""How often a stop is looked for while units are worked on, s."""
UNITS_EACH = 4
"""Units per worker into which little work is divided at least, so that all end at about the same time."""

Unit = tuple[str, ...]
_Handed = dict[Future[Mapping[str, int]], tuple[Unit, int]]


@dataclass(frozen=True, slots=True)
class InThisProcess:
    """Does a unit at once, in the thread that asks for it."""

    @property
    def width(self) -> int:
        """One."""
        return 1

    def submit(self, context: JobContext, stage: Work, keys: Sequence[str]) -> Future[Mapping[str, int]]:
        """Do a unit.

        Args:
            context: Of the job that hands the unit out; its storage is used.
            stage, keys: The unit.
        """
        done: Future[Mapping[str, int]] = Future()
        try:
            done.set_result(claimed_work(context, stage, keys))
        except Exception as error:  # noqa: BLE001 - it is raised where the result is looked at
            done.set_exception(error)
        return done


def hand_out(context: JobContext, stage: Work, units: Iterable[Unit], done: Callable[[int], None]) -> Counter[str]:
    """Let units be worked on and return what was counted, summed.

    Args:
        done: Called with the number of keys whenever a unit is done, and with 0 now and then; may raise to stop.

    Raises:
        StoppedError: From ``done``; units that were handed out may still be done.
        StorageError: The database, or all of the files, cannot be used.
        WorkFailedError: A unit failed in several workers.
    """
    executor = InThisProcess() if context.executor is None else context.executor
    most = 1 if context.executor is None else AHEAD * executor.width
    counts: Counter[str] = Counter()
    handed: _Handed = {}
    try:
        for unit in units:
            handed[executor.submit(context, stage, unit)] = unit, 1
            while len(handed) >= most:
                _collect(context, stage, handed, counts, done)
        while handed:
            _collect(context, stage, handed, counts, done)
    except BaseException:
        for future in handed:
            future.cancel()
        raise
    return counts


def unit_size(context: JobContext, total: int, most: int) -> int:
    """Return how many keys a unit has, so that there are enough units for all workers.

    Args:
        total: Number of keys, as far as it is known.
        most: Largest number of a unit.
    """
    width = 1 if context.executor is None else context.executor.width
    return most if width == 1 else max(1, min(most, -(-total // (UNITS_EACH * width))))


def _collect(
    context: JobContext, stage: Work, handed: _Handed, counts: Counter[str], done: Callable[[int], None]
) -> None:
    """Wait until units are done; hand those out again that failed."""
    ended, _ = wait(handed, LOOK_S, FIRST_COMPLETED)
    for future in ended:
        unit, tries = handed.pop(future)
        error = CancelledError() if future.cancelled() else future.exception()
        if error is None:
            counts.update(future.result())
            done(len(unit))
        elif context.executor is None or not isinstance(error, WorkFailedError) or tries >= MOST_TRIES:
            raise _as_ours(error)
        else:
            handed[context.executor.submit(context, stage, unit)] = unit, tries + 1
    if not ended:
        done(0)


def _as_ours(error: BaseException) -> BaseException:
    return (
        WorkFailedError("the workers are gone, and what they worked on waits")
        if isinstance(error, CancelledError)
        else error
    )

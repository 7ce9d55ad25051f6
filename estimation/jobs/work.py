"""Units of work are handed out to whoever does them, at most so many at a time that no worker waits for the next.

Whoever does a unit claims its keys: what is free is done together, what workers have ended at is done one by one.
What fails alone goes to quarantine, the others go on; it is tried ever more rarely.
"""

from __future__ import annotations

import logging
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from estimation.errors import (
    DamagedError,
    LeaseLostError,
    StoppedError,
    StorageError,
    TreadwatchError,
    WorkersEndedError,
    WorkFailedError,
)
from estimation.jobs.job import JobContext, Work, WorkUnit
from estimation.jobs.parameters import WORK
from estimation.storage import Storage, UnitOfWork
from estimation.values.runs import MOST_ENDED, Quarantined, SubjectKind, after_failure, resolved

ELSEWHERE, LOST, SET_ASIDE = "worked_on_elsewhere", "leases_lost", "set_aside"


def claimed_work(context: JobContext, stage: Work, unit: WorkUnit) -> Counter[str]:
    """Do the keys of a unit that nobody else works on; return what was counted.

    Raises:
        StorageError: The database, or all of the files, cannot be used; what was committed stays.
    """
    counts, ended = _leased(context, stage, unit)
    for key, times in ended:
        counts += _leased(context, stage, replace(unit, keys=(key,)), ended=times)[0]
    return counts


def _leased(
    context: JobContext, stage: Work, unit: WorkUnit, ended: int = 0
) -> tuple[Counter[str], Sequence[tuple[str, int]]]:
    """Return what was counted, and the keys that are to be done alone with how many workers have ended at each."""
    counts: Counter[str] = Counter()
    terms = (unit.stage, unit.keys, context.holder, context.lease_s)
    with context.storage.leased(*terms, alone=ended > 0, unit=unit.number, owner=unit.owner) as (leased, claimed):
        if claimed.elsewhere:
            counts[ELSEWHERE] += claimed.elsewhere
        if claimed.keys:
            counts.update(_done(replace(context, storage=leased), leased, stage, claimed.keys, ended))
    return counts, claimed.ended


def _done(context: JobContext, leased: Storage, stage: Work, keys: Sequence[str], ended: int) -> Mapping[str, int]:
    try:
        if ended < MOST_ENDED:
            return stage.work(context, keys)
        stage.set_aside(context, keys[0], WorkersEndedError(ended))
    except LeaseLostError:
        return {LOST: 1}
    except StorageError:
        if leased.lease_lost():  # the server has ended a transaction that stood still
            return {LOST: 1}
        raise
    return {SET_ASIDE: 1, "quarantined": 1}


Unit = tuple[str, ...]


@dataclass(slots=True)
class _Handed:
    """A unit that is worked on; how often that has failed, and how many workers have ended at it."""

    unit: WorkUnit
    failed: int = 0
    ended: int = 0


def hand_out(context: JobContext, stage: Work, units: Iterable[Unit], done: Callable[[int], None]) -> Counter[str]:
    """Let units be worked on and return what was counted, summed.

    Args:
        done: Called with the number of keys whenever a unit is done, and with 0 now and then; may raise to stop.

    Raises:
        StoppedError: From ``done``; units that were handed out may still be done.
        StorageError: The database, or all of the files, cannot be used.
        WorkFailedError: A unit failed in several workers.
    """
    handing = _Handing(context, stage, done)
    try:
        for keys in units:
            handing.begin(_Handed(WorkUnit(stage.name, keys, uuid.uuid4().hex, context.storage.owner)))
            while len(handing.handed) >= handing.most:
                handing.collect()
        while handing.handed:
            handing.collect()
    except BaseException:
        for future in handing.handed:
            future.cancel()
        raise
    return handing.counts


def unit_size(context: JobContext, total: int, most: int) -> int:
    """Return how many keys of ``total`` a unit has, at most ``most``, so that there are enough for all workers."""
    width = 1 if context.executor is None else context.executor.width
    return most if width == 1 else max(1, min(most, -(-total // (WORK.units_per_worker * width))))


@dataclass(slots=True)
class _Handing:
    """What is handed out, by the future of its counts."""

    context: JobContext
    stage: Work
    done: Callable[[int], None]
    counts: Counter[str] = field(default_factory=Counter)
    handed: dict[Future[Mapping[str, int]], _Handed] = field(default_factory=dict)

    @property
    def most(self) -> int:
        """How many units are handed out at once."""
        return 1 if self.context.executor is None else WORK.units_ahead * self.context.executor.width

    def begin(self, handed: _Handed) -> None:
        """Let a unit be done, here or by a worker."""
        executor = self.context.executor
        if executor is not None:
            self.handed[executor.submit(executor.work, handed.unit)] = handed
            return
        self.counts.update(claimed_work(self.context, self.stage, handed.unit))
        self.done(len(handed.unit.keys))

    def collect(self) -> None:
        """Wait until units are done; hand those out again that failed."""
        ended, _ = wait(self.handed, WORK.stop_check_s, FIRST_COMPLETED)
        if not ended and self.context.executor is not None:
            self.context.executor.look()
        for future in ended:
            handed = self.handed.pop(future)
            error = CancelledError() if future.cancelled() else future.exception()
            if error is None:
                self.counts.update(future.result())
                self.done(len(handed.unit.keys))
            else:
                self._again(handed, error)
        if not ended:
            self.done(0)

    def _again(self, handed: _Handed, error: BaseException) -> None:
        if isinstance(error, WorkFailedError):
            handed.failed += 1
        else:
            handed.ended += 1
        # each key is set aside once it has ended so many workers; a unit is claimed again each time
        if handed.failed >= WORK.most_tries or handed.ended > MOST_ENDED * len(handed.unit.keys):
            gone = WorkFailedError(f"workers are gone: {type(error).__name__} {error}")
            raise error if isinstance(error, WorkFailedError) else gone
        self.begin(handed)


Inputs = Callable[[], str]
"""Returns what stands for that of which a thing is made; called only where it has failed."""

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Isolation:
    """The quarantine of one stage during one run."""

    context: JobContext
    stage: str
    _read: dict[tuple[SubjectKind, str], Quarantined] | None = None
    _kept_out: set[tuple[SubjectKind, str]] = field(init=False, default_factory=set)

    def of_claims(self, context: JobContext) -> Isolation:
        """Return the quarantine for work under claims, which counts by itself; what is held is known already."""
        return Isolation(context, self.stage, self._read)

    def read(self, unit: UnitOfWork) -> None:
        """Read what is held, where that was not done yet; else it is read when it is asked for."""
        if self._read is None:
            self._read = {(item.kind, item.key): item for item in unit.quarantine.held(self.stage)}

    def nothing_held(self) -> None:
        """Go on without reading: nothing is held."""
        if self._read is None:
            self._read = {}

    @property
    def _held(self) -> dict[tuple[SubjectKind, str], Quarantined]:
        if self._read is None:
            with self.context.storage.read() as unit:
                self.read(unit)
        assert self._read is not None
        return self._read

    @property
    def quarantined(self) -> int:
        """How many failed in this run or were left out because they are not due yet."""
        return len(self._kept_out)

    def waits(self, kind: SubjectKind, key: str, inputs: Inputs) -> bool:
        """Whether a thing failed before and is not due yet; it counts as quarantined then."""
        held = self._held.get((kind, key))
        if held is None or not held.waits(inputs(), self.context.clock.now_ns()):
            return False
        self._kept_out.add((kind, key))
        return True

    def held(self, kind: SubjectKind) -> list[Quarantined]:
        """Return what failed and has not succeeded since, of one kind."""
        return [item for (of, _), item in self._held.items() if of is kind]

    @contextmanager
    def alone(self, kind: SubjectKind, key: str) -> Iterator[None]:
        """Do the work at one thing: an exception is kept in quarantine and not raised.

        Raises:
            StoppedError: The process is stopping.
            StorageError: The database, or all of the files, cannot be used: nothing else would succeed.
        """
        try:
            yield
        except Exception as error:
            if not fails_alone(error):
                raise
            self.keep(kind, key, "", error)
        else:
            self.release(kind, key)

    def keep(self, kind: SubjectKind, key: str, inputs: str, error: Exception) -> None:
        """Keep a failure.

        Raises:
            StorageError: The database cannot be used.
        """
        unexpected = None if isinstance(error, TreadwatchError) else error
        _log.warning("%s: %s %s goes to quarantine: %s", self.stage, kind, key, error, exc_info=unexpected)
        item = after_failure(
            self._held.get((kind, key)), (kind, key, self.stage), inputs, error, self.context.clock.now_ns()
        )
        with self.context.storage.write() as unit:
            unit.quarantine.put(item)
        self._held[kind, key] = item
        self._kept_out.add((kind, key))

    def release(self, kind: SubjectKind, key: str) -> None:
        """End the quarantine of a thing, if it was in one."""
        item = self._held.pop((kind, key), None)
        if item is not None:
            with self.context.storage.write() as unit:
                unit.quarantine.put(resolved(item))


def fails_alone(error: Exception) -> bool:
    """Whether an exception at one thing leaves work at others: the database, or all files, are there."""
    whole = isinstance(error, StorageError) and not isinstance(error, DamagedError)
    return not (whole or isinstance(error, StoppedError))

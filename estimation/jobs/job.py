"""What a job is, what it gets, in which units it hands out its work, and how one run of it is recorded.

A job is some twenty lines: load, compute with pure functions, store. It commits its work in batches, each batch in
one ``storage.write()`` and keyed, so that a kill leaves nothing half-written and a rerun repeats nothing. Between
batches it calls :meth:`JobContext.checkpoint`, which reports the progress and ends the run when a stop was asked for.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from estimation.errors import ConflictError, LeaseLostError, StoppedError, TreadwatchError
from estimation.jobs.parameters import WORK
from estimation.jobs.settings import JobSettings
from estimation.storage import Clock, Storage
from estimation.values.runs import JobOutcome, JobRun, JobTrigger

UNFIT = "unfit_workers"
Result = TypeVar("Result")

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class JobContext:
    """What a job may touch."""

    storage: Storage
    clock: Clock
    code_version: str  # goes into the provenance of what is stored
    settings: JobSettings
    progress: Callable[[int, int], None] | None = None  # called with (done, total) between batches
    stopping: Callable[[], bool] | None = None  # returns whether a stop of the process was requested
    executor: WorkExecutor | None = None  # None does units of work here, one after the other
    holder: str = "worker"  # name of this process in the claims that it makes
    lease_s: float = WORK.lease_s  # of a claim, once its process is gone or stands still
    quiet_s: float = 0.0  # what had data within so many seconds, and is about to change again, is left to a later run

    def checkpoint(self, done: int, total: int) -> None:
        """Report the progress; to be called between two batches, with everything before it committed.

        Raises:
            StoppedError: The process is stopping; what was committed stays, a later run does the rest.
        """
        if self.progress is not None:
            self.progress(done, total)
        if self.stopping is not None and self.stopping():
            raise StoppedError(done, total)


@dataclass(frozen=True, slots=True)
class Work:
    """Work of a job that is done in units: some keys each, such as the serials of wheelsets.

    Whoever does a unit claims its keys in the database and stores what comes of them; what is handed back are counts.
    So an executor may lose a unit or do it twice: the claims decide who works on what, and what was lost is found
    again by the next run.
    """

    name: str
    # does the work for some keys, which are claimed; stores what comes of it and returns what it counted
    work: Callable[[JobContext, Sequence[str]], Mapping[str, int]]
    # keeps one key in quarantine, at which workers have ended
    set_aside: Callable[[JobContext, str, TreadwatchError], None]


@dataclass(frozen=True, slots=True)
class WorkUnit:
    """A unit as it is sent to a worker."""

    stage: str
    keys: tuple[str, ...]
    # of the unit, the same when it is handed out again: whoever begins it ends the lease under which it was begun
    # before, so that what a worker had claimed that is gone is free at once
    number: str
    # lease of the process that runs the job, with which claims end; None where the worker goes on without it
    owner: int | None = None


class WorkExecutor(Executor):
    """Does units of work in other processes: ``submit`` calls ``work(context, *arguments)`` with a context of theirs.

    What was raised there comes back as ``WorkFailedError``. Any other exception says that the worker is gone.

    Attributes:
        work: What is submitted with a unit; any process can import it.
        width: How many units are done at once.
        unfit: Of the workers that get no work: who they are and why.
    """

    @staticmethod
    @abstractmethod
    def work(context: JobContext, unit: WorkUnit) -> Mapping[str, int]: ...  # noqa: D102 - of an interface

    @property
    @abstractmethod
    def width(self) -> int: ...  # noqa: D102 - an attribute

    @abstractmethod
    def submit(self, work: Callable[..., Result], /, *arguments: Any, **named: Any) -> Future[Result]: ...  # noqa: ANN401, D102 - of any work

    @property
    def unfit(self) -> Sequence[str]:  # noqa: D102 - the same
        return ()

    def look(self) -> None:
        """Called now and then while units are waited for.

        Raises:
            WorkFailedError: There are no workers any more.
        """


@dataclass(frozen=True, slots=True)
class Job:
    """Something that is run again and again; ``run`` returns named counts of what it did."""

    name: str
    description: str
    every_s: float  # default interval of the schedule
    run: Callable[[JobContext], Mapping[str, int]]


def run_job(
    job: Job, context: JobContext, trigger: JobTrigger, *, started: Callable[[JobRun], None] | None = None
) -> JobRun:
    """Run a job once and record it: start, finish, outcome, counts and, where it failed, the message.

    The record is written in transactions of its own, before and after the work, so that a killed run stays
    visible; it is ``abandoned`` once its process is gone.

    Args:
        context: What it may touch.
        started: Gets the record as soon as it is committed, before the work begins.

    Returns:
        JobRun: The finished record. A failure is in it (outcome ``failed``; the message, without a trace), and where a
            stop was asked for the outcome is ``abandoned``; neither is raised. ``counts`` of such a run hold ``done``
            and ``total`` of the last checkpoint.
    """
    with context.storage.write(fenced=False) as unit:
        now_ns = context.clock.now_ns()
        begun, is_behind = unit.jobs.start(job.name, trigger, now_ns)
        corrected = unit.recorded_times.correct(now_ns) if is_behind else 0
    if corrected:
        _log.warning("our clock has gone back: %d results carried a later time and count as recorded now", corrected)
    if started is not None:
        started(begun)
    reached: list[tuple[int, int]] = []
    outcome, counts, error = _attempt(job, replace(context, progress=_remember(context.progress, reached)))
    if error is not None and reached:
        counts = {"done": reached[-1][0], "total": reached[-1][1]}
    try:
        with context.storage.write(fenced=False) as unit:
            return unit.jobs.finish(begun.run_id, outcome, counts, context.clock.now_ns(), error)
    except (ConflictError, LeaseLostError) as conflict:  # a scheduler that started meanwhile has given this run up
        _log.warning("job %s: %s", job.name, conflict)
        with context.storage.read() as unit:
            return unit.jobs.get(begun.run_id)


def _remember(
    progress: Callable[[int, int], None] | None, reached: list[tuple[int, int]]
) -> Callable[[int, int], None]:
    def report(done: int, total: int) -> None:
        reached[:] = [(done, total)]
        if progress is not None:
            progress(done, total)

    return report


def _attempt(job: Job, context: JobContext) -> tuple[JobOutcome, Mapping[str, int], str | None]:
    try:
        counts = dict(job.run(context))
        if context.executor is not None and context.executor.unfit:
            counts[UNFIT] = len(context.executor.unfit)
    except (StoppedError, LeaseLostError) as error:
        return JobOutcome.ABANDONED, {}, str(error)
    except TreadwatchError as error:
        _log.warning("job %s failed: %s", job.name, error)
        return JobOutcome.FAILED, {}, str(error)
    except Exception as error:  # noqa: BLE001 - whatever fails in a job is a fact of its run, never the end of the scheduler
        _log.exception("job %s failed", job.name)
        return JobOutcome.FAILED, {}, f"{type(error).__name__}: {error}".splitlines()[0]
    return JobOutcome.SUCCEEDED, counts, None

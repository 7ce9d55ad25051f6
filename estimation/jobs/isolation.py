"""What fails in a run of a job fails alone: it goes to quarantine, the others go on; it is tried ever more rarely."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from estimation.errors import DamagedError, StoppedError, StorageError, TreadwatchError
from estimation.jobs.job import JobContext
from estimation.storage import UnitOfWork
from estimation.values.runs import Quarantined, SubjectKind, after_failure, resolved

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

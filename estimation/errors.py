"""One tree for everything that is raised on purpose.

Bad *data* is never an exception: it is a value marked invalid with its reason. What is raised is either a mistake of
ours or bad input from the outside world, and carries its facts as fields.
"""

from __future__ import annotations

from pathlib import Path


class TreadwatchError(Exception):
    """Root of the tree; ``str(error)`` is a message fit for a person."""


class InputError(TreadwatchError):
    """What somebody handed us is wrong: the reason in one sentence, and where it is, as far as known."""

    def __init__(
        self, reason: str, *, file: Path | str | None = None, line: int | None = None, field: str | None = None
    ) -> None:
        self.reason = reason
        self.file = str(file) if file is not None else None
        self.line = line
        self.field = field
        super().__init__(self._message())

    def _message(self) -> str:
        place = [] if self.line is None else [f"line {self.line}"]
        if self.file is not None:
            place = [self.file if self.line is None else f"{self.file}:{self.line}"]
        if self.field is not None:
            place.append(f"field {self.field!r}")
        return f"{', '.join(place)}: {self.reason}" if place else self.reason


class ProfileError(InputError):
    """A wheel or rail profile that cannot be read or used."""


class ContactError(InputError):
    """Profiles that never touch, or a contact table that cannot be built from them."""


class ScenarioError(InputError):
    """A scenario file of the simulator with a missing, unknown or impossible entry."""


class CatalogueError(InputError):
    """A signal catalogue (DBC) that lacks what the codec needs."""


class LogFileError(InputError):
    """A recording of a bus that is truncated, corrupt, or no recording at all."""


class ExchangeError(LogFileError):
    """An exchange of runs whose description or table cannot be used, or whose axes the data contradict."""


class ParameterError(InputError):
    """A parameter outside its range."""


class NotFoundError(TreadwatchError):
    """No such thing: ``kind`` and ``key`` name it."""

    def __init__(self, kind: str, key: str) -> None:
        self.kind = kind
        self.key = key
        super().__init__(f"no {kind} {key!r}")


class ConflictError(TreadwatchError):
    """The thing is not in the state that the request assumes."""

    def __init__(self, reason: str, *, kind: str = "", key: str = "") -> None:
        self.reason = reason
        self.kind = kind
        self.key = key
        super().__init__(reason)


class PassingFaultError(TreadwatchError):
    """The machine cannot do it now, and nothing is wrong with the input.

    No space, no mount, no permission, no memory or process to be had, a missing extra: the same again succeeds once
    the fault is mended. ``code`` says what is waited for: one of ``estimation.values.runs.PASSING``.
    """

    def __init__(self, reason: str, *, file: Path | str | None = None, code: str = "waits_for_storage") -> None:
        self.reason = reason
        self.code = code
        self.file = str(file) if file is not None else None
        super().__init__(reason if self.file is None else f"{self.file}: {reason}")


class StoppedError(TreadwatchError):
    """A job ended between two batches because the process is stopping; a later run does the rest."""

    def __init__(self, done: int, total: int) -> None:
        super().__init__(f"stopped on request after {done} of {total}")


class NotFiniteError(TreadwatchError):
    """A computation has an estimated number that is not finite."""


class WorkersEndedError(TreadwatchError):
    """So many worker processes ended while they worked at one thing that it is set aside."""

    def __init__(self, ended: int) -> None:
        super().__init__(f"{ended} worker processes ended while they worked at it")


class WorkFailedError(TreadwatchError):
    """A unit of work failed in its worker process, or the workers cannot be reached; a later run does the rest."""


class StorageError(TreadwatchError):
    """The database or the window files cannot do what was asked."""


class DamagedError(StorageError):
    """One thing that was stored is missing or damaged; names it. What is stored beside it can be used."""


class PurgedError(DamagedError):
    """Something has been kept long enough and was purged; names it."""


class MigrationError(StorageError):
    """The database is at another migration than this code needs; ``remedy`` is what its operator does."""

    def __init__(self, found: str | None, expected: str, remedy: str = "run: treadwatch db upgrade") -> None:
        self.found = found
        self.expected = expected
        super().__init__(f"the database is at migration {found or 'none'}, this version needs {expected}; {remedy}")


class BusyError(StorageError):
    """Another writer did not end in time; nothing was changed, and the same may succeed a moment later."""


class AlreadyRunningError(StorageError):
    """Another scheduler has the place of the one of this database."""

    def __init__(self, holder: str) -> None:
        self.holder = holder
        super().__init__(f"another scheduler is already running on this database ({holder})")


class LeaseLostError(StorageError):
    """The lease under which this process works has ended, and others may go on; nothing was committed."""

    def __init__(self, holder: str) -> None:
        super().__init__(f"{holder} has lost its lease, for it or its database stood still: its work is left to others")

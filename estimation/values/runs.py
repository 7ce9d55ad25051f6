"""Jobs: their runs, what a worker has claimed, and what failed by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated, Any, Generic, TypeVar

from estimation.errors import (
    ConflictError,
    DamagedError,
    PassingFaultError,
    StorageError,
    TreadwatchError,
    WorkersEndedError,
)
from estimation.values.fields import JsonValue, Served
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import DAY_S, HOUR_S, SECOND_NS


class JobTrigger(StrEnum):
    """Who asked for a run."""

    SCHEDULE = "schedule"
    API = "api"
    CLI = "cli"


class JobOutcome(StrEnum):
    """How a run stands or ended."""

    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    ABANDONED = "abandoned"  # a stop was asked for, or the process ended


@dataclass(frozen=True, slots=True)
class JobRun:
    """One run of one job; ``finished_ns`` None until its end is recorded. ``counts`` are what it did."""

    run_id: Annotated[int, Served("", "id", example=42)]
    job: Annotated[str, Served("Name of the job.", example="estimate_windows")]
    trigger: Annotated[JobTrigger, Served("What started it.")]
    started_ns: Annotated[int, Served("When it began.")]
    finished_ns: Annotated[int | None, Served("When it ended; null while it runs.")]
    outcome: Annotated[JobOutcome, Served("How it ended.")]
    counts: Mapping[str, int]
    error: Annotated[str | None, Served("First line of the error; null where it succeeded.")] = None


MOST_ENDED = 3  # workers that end at one thing before it is set aside


@dataclass(frozen=True, slots=True)
class Claimed:
    """What came of asking for some things."""

    keys: tuple[str, ...]  # of those that may be worked on under the lease
    ended: tuple[tuple[str, int], ...] = ()  # how many workers ended at which key; it is free, to be asked for alone
    elsewhere: int = 0  # how many are worked on under other leases
    begun_ns: Mapping[str, int] = field(default_factory=dict)  # of ``keys``, by the clock of the claims


@dataclass(frozen=True, slots=True)
class RetryDelays:
    """How long a subject that failed is left alone: longer each time."""

    factor: float
    longest_s: float
    first_s: float = 60.0
    most_doublings: int = 20


PASSING_DELAYS = RetryDelays(2.0, HOUR_S)
FAILED_DELAYS = RetryDelays(4.0, DAY_S)


class SubjectKind(StrEnum):
    """What can fail alone."""

    RECORDING = "recording"
    WINDOW = "window"
    WHEELSET = "wheelset"
    SECTION = "section"
    VEHICLE = "vehicle"
    FLEET = "fleet"


class QuarantineState(StrEnum):
    """Whether the last attempt failed."""

    HELD = "held"
    RESOLVED = "resolved"


PASSING = (ReasonCode.WAITS_FOR_STORAGE, ReasonCode.WAITS_FOR_EXTRA, ReasonCode.WAITS_FOR_MEMORY)
"""Codes of faults that have nothing to do with the input."""

TRIED_AGAIN = (*PASSING, ReasonCode.CONFLICT, ReasonCode.PROCESSING_FAILED, ReasonCode.WORKERS_ENDED)
"""Codes of what is tried again after a while, though nothing has changed."""

FAILED = (*TRIED_AGAIN, ReasonCode.FILE_DAMAGED)
"""Codes of windows that were refused because the estimation failed at them; such a window is due still."""

AT_ONCE = (ReasonCode.WAITS_FOR_STORAGE, ReasonCode.WAITS_FOR_EXTRA, ReasonCode.CONFLICT)
"""Codes of which the first retry is the next run: it costs little, and the fault has often gone by then."""


@dataclass(frozen=True, slots=True)
class Quarantined:
    """One thing at which one stage of the work failed."""

    kind: SubjectKind
    key: Annotated[str, Served("Digest, serial or code; of a window `serial@start in ns`.", example="WS-0001")]
    stage: Annotated[str, Served("The job, or `ingest` for recordings.", example="refresh_geometry")]
    code: Annotated[ReasonCode, Served("", "reason_code")]
    error: str
    inputs: str  # digest or counter of what it was made from; with another one it is tried at once
    first_ns: Annotated[int, Served("When it failed first.", "first_failed_at")]
    last_ns: Annotated[int, Served("When it failed last.", "last_failed_at")]
    due_ns: int
    attempts: Annotated[int, Served("Failures in a row.")]
    state: QuarantineState = QuarantineState.HELD  # held, or resolved by a later success

    def waits(self, inputs: str, now_ns: int) -> bool:
        """Whether it is too early for another attempt; never once the clock is behind the last failure."""
        return self.state is QuarantineState.HELD and inputs == self.inputs and self.last_ns <= now_ns < self.due_ns


def resolved(item: Quarantined) -> Quarantined:
    """Return ``item`` after a success."""
    return replace(item, state=QuarantineState.RESOLVED)


def delay_s(code: ReasonCode, attempts: int) -> float:
    """Return how long to wait after so many failures, s: longer each time, up to an hour or a day."""
    if code in AT_ONCE:
        attempts -= 1
    if attempts < 1:
        return 0.0
    passing = code in PASSING or code is ReasonCode.CONFLICT
    delays = PASSING_DELAYS if passing else FAILED_DELAYS
    return min(delays.first_s * delays.factor ** min(attempts - 1, delays.most_doublings), delays.longest_s)


ERROR_LENGTH = 500


def after_failure(
    before: Quarantined | None, subject: tuple[SubjectKind, str, str], inputs: str, error: Exception, now_ns: int
) -> Quarantined:
    """Return what is kept of a failure, after what is kept ``before`` it of the last one."""
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


V = TypeVar("V")


class History(StrEnum):
    """Whether a result that is followed by another stays, so that it can be asked for as of an earlier time."""

    APPENDED = "appended"
    NEWEST = "newest"


@dataclass(frozen=True, slots=True)
class ResultKind(Generic[V]):
    """Results of one stage."""

    stage: str  # and name of the facet that its results are of their subjects
    subject: SubjectKind
    value: type[V]  # its fields are what is stored
    history: History = History.APPENDED
    one_in_force: bool = False  # of all parts the one put last, as of baselines; else each part, as intervals, has one

    @property
    def head_facet(self) -> str:
        """Facet of the heads of its results: raised only where one of them is another."""
        return f"{self.stage}.head"


@dataclass(frozen=True, slots=True)
class Result(Generic[V]):
    """A result of a subject, or of a part of it."""

    subject: str
    made_from: str  # digest of everything, settings included
    numerics: str  # version
    recorded_ns: int
    value: V | None  # None where there is a reason only
    part: str = ""
    status: Status = Status.ESTIMATED
    reason: Reason | None = None
    head: JsonValue = None  # what is read of many results, without their values
    parameters: Mapping[str, JsonValue] = field(default_factory=dict)  # that shaped it, as they are shown
    number: int = field(default=0, compare=False)  # larger than that of every result put before; 0 until it is stored


AnyResult = Result[Any]
EVERYTHING = "all"
"""The one subject of a stage that looks at all subjects of its kind together."""


class Facet(StrEnum):
    """Base facts of a wheelset, vehicle or section; results of a stage are a facet of the stage's own name."""

    REGISTRY = "registry"  # what is on file, also of the vehicle or class behind it
    WINDOWS = "windows"  # states, qualities and mileages; of a section what its epochs do not hold as it is now
    TABLES = "tables"  # bin tables, and the verdicts on windows that its geometry rests on
    ALERTS = "alerts"
    RESTARTS = "restarts"  # alerts from which its geometry and trend begin again
    LAYOUTS = "layouts"  # sections and their layouts, on which all signatures rest
    BESIDE = "beside"  # what is known of the vehicle that a wheelset runs in, and of the wheelsets beside it
    HUNTING = "hunting"  # windows of a vehicle in which it hunts
    RECORDINGS = "recordings"  # of a vehicle, that are rejected
    STIFFNESS = "stiffness"  # ratios that epochs show of a vehicle
    PLACES = "places"  # windows of a section with their states, bin tables and positions, and its epochs
    ALIGNMENT = "alignment"  # versions of the alignment of a section


@dataclass(frozen=True, slots=True)
class StageInputs:
    """What a stage declares that it is made from.

    Without facets it goes by the windows that are due (``fleet_db.due``), and removes what it has seen itself.
    """

    stage: str
    kind: SubjectKind
    facets: tuple[str, ...]  # of its subjects
    common: str  # digest of what is the same for all subjects: settings and numerics
    together: bool = False  # it looks at all subjects together, of whatever kind a facet is
    inline: bool = False  # due by other settings only: what is raised is followed by the transaction that raises it


@dataclass(frozen=True, slots=True)
class Due:
    """A subject that a stage has not seen as it is now."""

    seen: int  # sum of the versions of its facets, in the transaction that reads its inputs
    made_from: str | None = None  # digest of the inputs seen last; None where it is to compute whatever they are
    marked: bool = False  # it has seen the subject before
    again_ns: int | None = None  # our time from which the inputs that it has seen may say something else
    registry: str | None = field(default=None, compare=False)  # version of the registry then


@dataclass(frozen=True, slots=True)
class Look:
    """What is to be done of some stages of a job, by their names."""

    # subjects in their order of those of which something is due, or whose settings are others; none of a stage that
    # works window by window
    due: Mapping[str, Mapping[str, Due]]
    seen: Mapping[str, int]  # how many subjects stages have seen
    listed: frozenset[str]  # those that work window by window and have listed all with these settings
    held: bool  # whether anything of the job is in quarantine


@dataclass(frozen=True, slots=True)
class Mark:
    """What a stage has seen of a subject."""

    seen: int
    made_from: str
    again_ns: int | None = None  # our time from which the same inputs may say something else; None for never
    rests: bool = True  # what the stage itself has raised of its own inputs is seen, too

"""Results of stages: what they are made from, by facets of their subjects, and how they are kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Generic, TypeVar

from estimation.values.fields import JsonValue
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.runs import SubjectKind

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

    Without facets it goes by the windows that are due (``fleet_db.due``), and settles what it has seen itself.
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

    seen: int  # sum of the versions of its facets, in the transaction that reads its inputs or before
    made_from: str | None = None  # digest of the inputs seen last; None where it is to compute whatever they are
    marked: bool = False  # it has seen the subject before
    again_ns: int | None = None  # our time from which the inputs that it has seen may say something else
    registry: str | None = field(default=None, compare=False)  # version of the registry then


@dataclass(frozen=True, slots=True)
class Look:
    """What is to be done of some stages of a job, by their names.

    Attributes:
        due: Those of which something is due, or whose settings are others.
        seen: How many subjects stages have seen.
        listed: Those that work window by window and have listed all with these settings.
        held: Whether anything of the job is in quarantine.
    """

    due: frozenset[str]
    seen: Mapping[str, int]
    listed: frozenset[str]
    held: bool


@dataclass(frozen=True, slots=True)
class Mark:
    """What a stage has seen of a subject."""

    seen: int
    made_from: str
    again_ns: int | None = None  # our time from which the same inputs may say something else; None for never
    rests: bool = True  # what the stage itself has raised of its own inputs is seen, too

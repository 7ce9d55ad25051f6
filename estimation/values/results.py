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
    """Results of one stage.

    Attributes:
        stage: Name of the stage, and of the facet that its results are of their subjects.
        value: The class of the value: its fields are what is stored.
        one_in_force: Whether of all parts of a subject the one that was put last is in force, as of baselines; else
            each part has its own, as mileage intervals have.
    """

    stage: str
    subject: SubjectKind
    value: type[V]
    history: History = History.APPENDED
    one_in_force: bool = False

    @property
    def head_facet(self) -> str:
        """Facet of the heads of its results: raised only where one of them is another."""
        return f"{self.stage}.head"


@dataclass(frozen=True, slots=True)
class Result(Generic[V]):
    """A result of a subject, or of a part of it.

    Attributes:
        made_from: Digest of everything that it was made from, settings included.
        numerics: Version of the numerics.
        value: None where there is a reason only.
        head: What is read of many results, without their values.
        parameters: That shaped it, as they are shown.
        number: Larger than that of every result that was put before; 0 until it is stored.
    """

    subject: str
    made_from: str
    numerics: str
    recorded_ns: int
    value: V | None
    part: str = ""
    status: Status = Status.ESTIMATED
    reason: Reason | None = None
    head: JsonValue = None
    parameters: Mapping[str, JsonValue] = field(default_factory=dict)
    number: int = field(default=0, compare=False)


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

    Attributes:
        facets: Of its subjects; none of a stage that goes by the windows that are due (``fleet_db.due``): of such a
            stage of wheelsets those are due that have some, and it settles what it has seen itself.
        common: Digest of what is the same for all subjects: settings and numerics.
        together: Whether it looks at all subjects together, of whatever kind a facet is.
        inline: Whether only other settings make it due: what is raised is followed by the transaction that raises it.
    """

    stage: str
    kind: SubjectKind
    facets: tuple[str, ...]
    common: str
    together: bool = False
    inline: bool = False


@dataclass(frozen=True, slots=True)
class Due:
    """A subject that a stage has not seen as it is now.

    Attributes:
        seen: Sum of the versions of its facets, in the transaction that reads its inputs.
        made_from: Digest of the inputs that the stage has seen last; None where it is to compute whatever they are.
        marked: Whether it has ever seen the subject.
        again_ns: Our time from which the inputs that it has seen may say something else.
    """

    seen: int
    made_from: str | None = None
    marked: bool = False
    again_ns: int | None = None


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
    """What a stage has seen of a subject.

    Attributes:
        again_ns: Our time from which the same inputs may say something else; None for never.
        rests: Whether what the stage itself has raised of its own inputs is seen, too.
    """

    seen: int
    made_from: str
    again_ns: int | None = None
    rests: bool = True

"""Results: what a stage made of a subject, from which inputs, and how results of a kind are kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Generic, TypeVar

from estimation.values.json_value import JsonValue
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

"""What a stage is: its kind of subject, what it is made from, and a pure function from inputs to a value.

A stage file says what is computed and nothing else; when, in which process and what happens where it fails is the
runner's (``estimation.jobs.runner``). ``docs/decisions/engine.md`` explains both, ``docs/extending.md`` adds a stage.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from operator import attrgetter
from typing import Any, Generic, TypeVar, cast

import numpy as np

from estimation.errors import NotFiniteError
from estimation.jobs.job import JobContext
from estimation.jobs.parameters import WORK
from estimation.jobs.settings import JobSettings
from estimation.storage import UnitOfWork
from estimation.values.fields import JsonValue
from estimation.values.geometry import BinStatus, BinValues
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason
from estimation.values.runs import Quarantined, Result, ResultKind, StageInputs, SubjectKind

PLAIN = frozenset({int, float, str, bytes, bool, type(None)})
"""Types whose ``repr`` is read as the same value again: many of them are written at once."""

Add = Callable[[bytes], None]


def made_from(*inputs: object) -> str:
    """Return the digest of frozen values, exact to the last bit of their numbers and arrays.

    A field with ``metadata={"made_from": False}`` is left out: what another field stands for, or is only carried along.
    """
    digest = hashlib.sha256()
    _write_items(inputs, digest.update)
    return digest.hexdigest()


@cache
def _writer(of: type[Any]) -> Callable[[Any, Add], None]:
    if issubclass(of, np.ndarray):
        return _write_array
    if is_dataclass(of):
        return _fields_writer(of)
    if issubclass(of, tuple | list):
        return _write_items
    if issubclass(of, Mapping):
        return lambda value, add: _write_items([(key, value[key]) for key in sorted(value, key=repr)], add)
    if issubclass(of, set | frozenset):
        return lambda value, add: _write_items(sorted(value, key=repr), add)
    return lambda value, add: add(f"{value!r};".encode())


def _write_array(value: np.ndarray[Any, Any], add: Add) -> None:
    add(f"{value.dtype.str}{value.shape}".encode())
    add(np.ascontiguousarray(value).tobytes())


def _fields_writer(of: type[Any]) -> Callable[[Any, Add], None]:
    names = [field.name for field in fields(of) if field.metadata.get("made_from", True)]
    title = of.__name__.encode()
    read = attrgetter(*names) if len(names) > 1 else None

    def write(value: object, add: Add) -> None:
        add(title)
        _write_items([getattr(value, name) for name in names] if read is None else read(value), add)

    return write


def _write_items(items: tuple[object, ...] | list[object], add: Add) -> None:
    if PLAIN.issuperset(map(type, items)):
        add(repr(tuple(items)).encode())
        return
    add(f"[{len(items)}".encode())
    for item in items:
        _writer(cast("Hashable", type(item)))(item, add)


I = TypeVar("I")  # noqa: E741 - inputs
V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Part(Generic[V]):
    """A result to be stored: of the subject itself, or of a part of it."""

    value: V | None  # None where there is a reason only
    part: str = ""
    subject: str | None = None  # of a stage that looks at all together: whose result it is; None is that of the inputs
    made_from: str | None = None  # digest of what this part is made from; None is that of all inputs of the subject
    status: Status = Status.ESTIMATED
    reason: Reason | None = None
    head: JsonValue = None  # what is read of many results, without their values
    parameters: Mapping[str, JsonValue] = field(default_factory=dict)  # that shaped it, as they are shown


def part_of_result(result: Result[V]) -> Part[V]:
    """Return a result as a part of an outcome."""
    return Part(
        value=result.value,
        part=result.part,
        made_from=result.made_from,
        status=result.status,
        reason=result.reason,
        head=result.head,
        parameters=result.parameters,
    )


@dataclass(frozen=True, slots=True)
class Outcome(Generic[V]):
    """What was computed of a subject."""

    parts: Sequence[Part[V]] = ()
    again_ns: int | None = None  # our time from which the same inputs may say something else; None for never
    counted: str | None = None  # name under which the subject is counted; None is by whether a result changed
    # whether the stage has nothing more to say before another of its inputs changes. What it raises of its own inputs
    # makes it look again otherwise
    rests: bool = True
    # whether this was a part of what is to be stored: the subject is due still, and taken up again at once
    more: bool = False
    # of a stage that looks at all together: of what it could not be done, by kind and key
    failed: Mapping[tuple[SubjectKind, str], Exception] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Counted:
    """Names of the counts of a run."""

    looked: str  # subjects that were looked at; with ``same`` those at rest, too
    changed: str  # results that are other ones now
    same: str | None = None  # subjects that are as they were; None where they are not counted
    more: tuple[str, ...] = ()  # names that outcomes and ``store`` count under

    @property
    def names(self) -> tuple[str, ...]:
        """All names."""
        return (self.looked, self.changed, *([self.same] if self.same else []), *self.more)


@dataclass(frozen=True, slots=True)
class Stage(Generic[I, V]):
    """A step from inputs to results, the same for every subject of a kind."""

    name: str  # of the stage; its results are a facet of this name
    job: str  # name of the job that runs it, under which failures are kept
    kind: SubjectKind
    # what of its subjects it is made from: base facts, and names of stages whose results it reads; none of a stage that
    # goes by the windows that are due
    facets: tuple[str, ...]
    # returns what of the settings it is made from; with others all subjects are due
    settings: Callable[[JobSettings], object]
    # reads the inputs of some subjects, few statements for all; a subject that is left out has nothing to compute from.
    # The digest of its inputs and ``numbers`` (``made_from``) decides whether it is computed
    load: Callable[[UnitOfWork, Sequence[str], JobContext], Mapping[str, I]]
    # gets the inputs and nothing else. A part that it does not return keeps its former result
    compute: Callable[[I], Outcome[V]]
    counted: Counted
    numbers: tuple[object, ...] = ()  # parameters that no deployment sets: with others, all subjects are computed again
    results: ResultKind[V] | None = None  # how what it computes is stored; None where ``store`` does all
    # stores what is more than results, of what was loaded, in the same transaction; returns what it counted
    store: Callable[[UnitOfWork, JobContext, Mapping[str, tuple[I, Outcome[V]]]], Mapping[str, int]] | None = None
    # stores what a failure says of a subject, beside the quarantine
    failed: Callable[[UnitOfWork, str, Exception], None] | None = None
    # prepares subjects that failed before and are tried again
    again: Callable[[UnitOfWork, Sequence[Quarantined]], None] | None = None
    # subjects that are loaded and stored in one transaction; None is as many as the settings say
    at_once: int | None = WORK.at_once
    # whether it looks at all subjects together, of whatever kind a facet is; its one subject is ``EVERYTHING``
    together: bool = False
    frozen: tuple[str, ...] = ()  # facets that it reads and that do not make it due
    # whether the transaction that raises a facet makes what the stage is for, at its end; a run makes all of it again
    # where the settings are others
    inline: bool = False
    # whether it is cheaper than handing it out, or its results are brought together: the process that runs the job does
    # it, without a claim. Not one that goes by due windows: only a claim tells a window that was listed again from one
    # that was seen
    here: bool = False

    def batch(self, context: JobContext) -> int:
        """Return how many subjects are loaded and stored in one transaction."""
        return context.settings.estimation.batch if self.at_once is None else self.at_once

    def inputs(self, context: JobContext) -> StageInputs:
        """Return what the stage is made from, with these settings and this version of the numerics."""
        settings = self.settings(context.settings)
        made = (self.facets, settings, self.numbers, context.code_version)
        common = str(settings) if self.inline else made_from(*made)
        return StageInputs(self.name, self.kind, self.facets, common, self.together, self.inline)


AnyStage = Stage[Any, Any]


def check_finite(part: Part[object]) -> None:
    """Refuse a result with an estimated number that is none.

    Raises:
        NotFiniteError: It has one; the result before it stays in force.
    """
    for value, std in _estimated(part.value):
        if not math.isfinite(value + std):
            raise NotFiniteError(f"an estimated number is {value} with a std of {std}")


def _estimated(value: object) -> Iterator[tuple[float, float]]:
    """Yield the numbers of a value that are said to be estimated, each with its std."""
    if isinstance(value, Estimate):
        if value.status is Status.ESTIMATED:
            yield value.value or 0.0, value.std or 0.0
    elif isinstance(value, BinValues):
        bins = zip(value.value, value.std, value.status, strict=True)
        yield from ((number, std) for number, std, status in bins if status is BinStatus.ESTIMATED)
    elif is_dataclass(value):
        for item in fields(value):
            yield from _estimated(getattr(value, item.name))
    elif isinstance(value, tuple):
        for item in value:
            yield from _estimated(item)

"""What each stage has seen of its subjects, which of them are others by now, and at which it failed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    ColumnElement,
    Connection,
    Row,
    Select,
    String,
    and_,
    case,
    cast,
    delete,
    exists,
    false,
    func,
    literal,
    null,
    or_,
    select,
    tuple_,
    union_all,
    update,
)

from estimation.values.reasons import ReasonCode
from estimation.values.runs import EVERYTHING, Due, Look, Mark, Quarantined, QuarantineState, StageInputs, SubjectKind
from fleet_db.due import DUE, WindowDueStore, list_for_settings
from fleet_db.locks import Subject, serialise
from fleet_db.rows import columns_of, equal, given, put_rows, row_of, table_of, upsert, value_of_row
from fleet_db.stores.assembled import SPANS
from fleet_db.subjects import MOUNTINGS, REGISTRY_VERSION, VERSIONS, ReadOnce, Store, Subjects
from fleet_db.tables.operation import StageMarkRow
from fleet_db.tables.recordings import ChunkRow, QuarantineRow
from fleet_db.tables.windows import WindowRow

MARKS, ITEMS = table_of(StageMarkRow), table_of(QuarantineRow)
CHUNKS, WINDOWS = table_of(ChunkRow), table_of(WindowRow)
SUM = cast(func.sum(VERSIONS.c.version), BigInteger)


@dataclass(frozen=True, slots=True)
class StageMarkStore:
    """What each stage has seen of its subjects.

    `due` reads versions in the snapshot in which the inputs are read. `note` is of the transaction that stores what was
    made of them: what was raised meanwhile leaves the subject due.
    """

    connection: Connection
    subjects: Subjects
    windows: WindowDueStore
    once: ReadOnce = field(default_factory=ReadOnce)
    on_file: ReadOnce = field(default_factory=ReadOnce)

    def due(self, inputs: StageInputs, now_ns: int, subjects: Collection[str] | None = None) -> Mapping[str, Due]:
        """Return what a stage has not seen as it is now, by subject, in their order; one statement.

        It is due where versions or settings are others, and where the time that its mark names has come.

        Args:
            subjects: Only of these; None is all.
        """
        self.subjects.flush()
        if inputs.kind is SubjectKind.WINDOW:
            return self._with_registry(self.windows.due(inputs, subjects))

        def read(some: Collection[str] | None) -> Mapping[str, Due]:
            rows = self.connection.execute(_due(inputs, now_ns, some).order_by("subject"))
            return {row.subject: _as_due(row) for row in rows}

        return self._with_registry(
            read(None) if subjects is None else self.once.of(f"mark of {inputs.stage}", subjects, read)
        )

    def alone(self) -> None:
        """Let no other transaction store what is not claimed until this one has ended."""
        serialise(self.connection, Subject.UNCLAIMED)

    def _with_registry(self, due: Mapping[str, Due]) -> Mapping[str, Due]:
        """Return what is due; the version of the registry was read with it, in the same snapshot."""
        self.on_file.renew(next((of_subject.registry for of_subject in due.values()), None))
        return due

    def versions(
        self, subjects: Collection[tuple[SubjectKind, str]], vehicles: Collection[str], facets: Collection[str]
    ) -> tuple[int, int]:
        """Return the sums of the versions of some facets, of subjects and of what was mounted on vehicles.

        One of the two is another where a version is: of the subjects none is ever left out, and so theirs only grows.

        Records of the registry are read as they are now from here on.

        Args:
            vehicles: All wheelsets that have ever been mounted there are among the subjects.
        """
        self.subjects.flush()
        facts = VERSIONS.alias("facts")
        of_subjects = tuple_(facts.c.kind, facts.c.subject).in_(sorted(subjects))
        mounted = select(MOUNTINGS.c.wheelset).where(MOUNTINGS.c.vehicle.in_(vehicles))
        beside = and_(facts.c.kind == SubjectKind.WHEELSET.value, facts.c.subject.in_(mounted))
        summed = select(
            func.sum(case((of_subjects, facts.c.version), else_=0)).label("own"),
            func.sum(case((beside, facts.c.version), else_=0)).label("beside"),
            REGISTRY_VERSION.label("registry"),
        )
        row = self.connection.execute(summed.where(or_(of_subjects, beside), facts.c.facet.in_(facets))).one()
        self.on_file.renew(row.registry)
        return int(row.own or 0), int(row.beside or 0)

    def look(self, stages: Sequence[StageInputs], now_ns: int, counted: Collection[str], job: str) -> Look:
        """Return what is due of stages; one statement for all, which reads the version of the registry, too.

        Args:
            counted: Names of the stages of which is counted what they have seen.
            job: Whose quarantine is looked at.
        """
        of_windows = [inputs for inputs in stages if inputs.kind is SubjectKind.WINDOW]
        held = exists().where(ITEMS.c.stage == job, ITEMS.c.state == QuarantineState.HELD.value)
        looks = [_look_due(inputs, now_ns) for inputs in stages]
        looks += [_look(_LISTED, inputs.stage).where(_with_settings(inputs).exists()) for inputs in of_windows]
        looks += [
            _look(_SEEN, stage, func.count()).where(MARKS.c.stage == stage, MARKS.c.subject != "")
            for stage in sorted(counted)
        ]
        rows = self.connection.execute(union_all(*looks, _look(_HELD, job).where(held))).all()
        self.on_file.renew(next((row.registry for row in rows if row.registry is not None), None))
        listed = frozenset(row.stage for row in rows if row.what == _LISTED)
        due: dict[str, dict[str, Due]] = {inputs.stage: {} for inputs in of_windows if inputs.stage not in listed}
        for row in rows:
            if row.what == _DUE:
                due.setdefault(row.stage, {}).update({row.subject: _as_due(row)} if row.subject is not None else {})
        return Look(
            due={stage: dict(sorted(of_stage.items())) for stage, of_stage in due.items()},
            seen={row.stage: row.seen for row in rows if row.what == _SEEN},
            listed=listed,
            held=any(row.what == _HELD for row in rows),
        )

    def note(self, inputs: StageInputs, marks: Mapping[str, Mark]) -> None:
        """Note what a stage has seen of subjects; what this transaction raises of its inputs is seen where it rests."""
        if inputs.kind is SubjectKind.WINDOW:
            self.windows.note(inputs, marks)
        elif inputs.facets:
            self._put(inputs, marks)

    def list_again(self, inputs: StageInputs) -> None:
        """Let a stage look at the windows that its settings concern."""
        list_for_settings(self.connection, inputs.stage)
        self._put(inputs, {EVERYTHING: Mark(0, "", rests=False)})

    def _put(self, inputs: StageInputs, marks: Mapping[str, Mark]) -> None:
        def of(subject: str) -> tuple[SubjectKind, str] | None:
            return None if inputs.together else (inputs.kind, subject)

        rows = [
            {
                "stage": inputs.stage,
                "subject": subject,
                "seen": mark.seen + (self.subjects.growth(inputs.facets, of(subject)) if mark.rests else 0),
                "common": inputs.common,
                "made_from": mark.made_from,
                "again_ns": mark.again_ns,
            }
            for subject, mark in sorted(marks.items())
        ]
        put_rows(self.connection, MARKS, rows)

    def forget(self, stage: str, subjects: Collection[str]) -> None:
        """Let a stage compute again of these subjects: what it made of them is damaged."""
        self.connection.execute(delete(MARKS).where(MARKS.c.stage == stage, MARKS.c.subject.in_(subjects)))


_DUE, _LISTED, _SEEN, _HELD = "due", "listed", "seen", "held"


def _look(what: str, stage: str, seen: ColumnElement[Any] | None = None) -> Select[Any]:
    columns: list[ColumnElement[Any]] = [literal(what).label("what"), literal(stage).label("stage")]
    number = literal(0) if seen is None else seen
    return select(*columns, number.label("seen"), *(cast(null(), kind).label(name) for name, kind in _DETAILS.items()))


_DETAILS = {"subject": String, "made_from": String, "again_ns": BigInteger, "come": Boolean, "registry": String}
"""What is read of a subject that is due beside what it has seen."""


def _look_due(inputs: StageInputs, now_ns: int) -> Select[Any]:
    """Return what is due of a stage; of one that works window by window a row without a subject where anything is."""
    if inputs.kind is SubjectKind.WINDOW:
        return _look(_DUE, inputs.stage).where(exists().where(DUE.c.stage == inputs.stage))
    due = _due(inputs, now_ns, None).subquery()
    columns = [literal(_DUE).label("what"), literal(inputs.stage).label("stage"), due.c.seen]
    return select(*columns, *(due.c[name] for name in _DETAILS))


def _as_due(row: Row[Any]) -> Due:
    return Due(
        seen=int(row.seen),
        made_from=None if row.come else row.made_from,
        marked=row.made_from is not None,
        again_ns=row.again_ns,
        registry=row.registry,
    )


def _with_settings(inputs: StageInputs) -> Select[Any]:
    """Return the mark of a stage that works window by window, once it has looked at all with these settings."""
    chosen = (MARKS.c.stage == inputs.stage, MARKS.c.subject == EVERYTHING, MARKS.c.common == inputs.common)
    return select(MARKS.c.seen).where(*chosen)


def _due(inputs: StageInputs, now_ns: int, subjects: Collection[str] | None) -> Select[Any]:
    """Return the statement of the subjects that are due of a stage, of some or of all."""
    if not inputs.facets:
        of_vehicle = inputs.kind is SubjectKind.VEHICLE
        subject: ColumnElement[str] = SPANS.c.vehicle if of_vehicle else DUE.c.wheelset
        number: ColumnElement[Any] = func.max(SPANS.c.id) if of_vehicle else func.sum(DUE.c.version)
        nothing: list[ColumnElement[Any]] = [
            cast(null(), _DETAILS[name]).label(name) for name in ("made_from", "again_ns", "come")
        ]
        columns = [subject.label("subject"), number.label("seen"), REGISTRY_VERSION.label("registry"), *nothing]
        statement = select(*columns).where(*given(subjects, subject.in_)).group_by(subject)
        return statement if of_vehicle else statement.where(DUE.c.stage == inputs.stage)
    of_all: ColumnElement[str] = literal(EVERYTHING) if inputs.together else VERSIONS.c.subject
    of_stage = and_(MARKS.c.stage == inputs.stage, MARKS.c.subject == of_all)
    come = and_(MARKS.c.again_ns.is_not(None), MARKS.c.again_ns <= now_ns)
    marked = (MARKS.c.seen, MARKS.c.common, MARKS.c.made_from, MARKS.c.again_ns)
    statement = select(
        of_all.label("subject"),
        SUM.label("seen"),
        MARKS.c.made_from,
        MARKS.c.again_ns,
        func.coalesce(come, false()).label("come"),
        REGISTRY_VERSION.label("registry"),
    ).select_from(VERSIONS.outerjoin(MARKS, of_stage))
    statement = statement.where(VERSIONS.c.facet.in_(inputs.facets))
    changed: ColumnElement[bool] = MARKS.c.common != inputs.common
    if not inputs.inline:
        changed = or_(MARKS.c.seen.is_(None), MARKS.c.seen != SUM, MARKS.c.common != inputs.common, come)
    if inputs.together:
        return statement.group_by(*marked).having(changed)
    statement = statement.where(VERSIONS.c.kind == inputs.kind.value, *given(subjects, VERSIONS.c.subject.in_))
    return statement.group_by(VERSIONS.c.subject, *marked).having(changed)


Place = tuple[str, str, str]
"""Kind, key and stage."""


class QuarantineStore(Store):
    """What failed by itself and is kept apart."""

    def get(self, kind: SubjectKind, key: str, stage: str) -> Quarantined | None:
        """Return what is kept of one thing, held or resolved."""
        row = row_of(self.connection, ITEMS, kind.value, key, stage)
        return None if row is None else value_of_row(Quarantined, row)

    def held(self, stage: str | None = None) -> Sequence[Quarantined]:
        """Return what is held, of one stage or of all, by last failure."""
        return self._items(select(ITEMS).where(*equal(ITEMS, state=QuarantineState.HELD, stage=stage)))

    def due(self, stage: str, now_ns: int, limit: int) -> Sequence[Quarantined]:
        """Return what is held of a stage and due for another attempt, at most ``limit``, by last failure."""
        held = (ITEMS.c.state == QuarantineState.HELD.value, ITEMS.c.stage == stage)
        return self._items(select(ITEMS).where(*held, ITEMS.c.due_ns <= now_ns).limit(limit))

    def all(self, limit: int) -> Sequence[Quarantined]:
        """Return what is or was held, at most ``limit``, by last failure."""
        return self._items(select(ITEMS).limit(limit))

    def page(
        self,
        *,
        kind: SubjectKind | None,
        state: QuarantineState | None,
        code: ReasonCode | None,
        vehicle: str | None,
        after: Place | None,
        limit: int,
    ) -> Sequence[Quarantined]:
        """Return items behind a place, by kind, key and stage; of a vehicle with its recordings and windows."""
        place = (ITEMS.c.kind, ITEMS.c.key, ITEMS.c.stage)
        chosen = [*equal(ITEMS, kind=kind, state=state, code=code), *given(vehicle, _of_vehicle)]
        behind = given(after, lambda place_before: tuple_(*place) > tuple_(*place_before))
        statement = select(ITEMS).where(*chosen, *behind).order_by(*place).limit(limit)
        return [value_of_row(Quarantined, row) for row in self.connection.execute(statement)]

    def counts(self) -> dict[tuple[SubjectKind, ReasonCode], int]:
        """Return how many are held, by kind and code."""
        columns = (ITEMS.c.kind, ITEMS.c.code)
        statement = select(*columns, func.count()).where(ITEMS.c.state == QuarantineState.HELD.value).group_by(*columns)
        return {(SubjectKind(kind), ReasonCode(code)): int(n) for kind, code, n in self.connection.execute(statement)}

    def put(self, item: Quarantined) -> None:
        """Keep a failure, or its end."""
        upsert(self.connection, ITEMS, columns_of(item))

    def retry(self, kind: SubjectKind | None = None, key: str | None = None) -> Sequence[Quarantined]:
        """Let what is held be tried at the next run: all, one kind, or one thing; return what that is."""
        chosen = equal(ITEMS, state=QuarantineState.HELD, kind=kind, key=key)
        items = self._items(select(ITEMS).where(*chosen))
        self.connection.execute(update(ITEMS).where(*chosen).values(due_ns=ITEMS.c.last_ns))
        return items

    def _items(self, statement: Any) -> Sequence[Quarantined]:  # noqa: ANN401 - a select of any shape
        ordered = statement.order_by(ITEMS.c.last_ns, ITEMS.c.kind, ITEMS.c.key, ITEMS.c.stage)
        return [value_of_row(Quarantined, row) for row in self.connection.execute(ordered)]


def _of_vehicle(vehicle: str) -> ColumnElement[bool]:
    recordings = select(CHUNKS.c.digest).where(CHUNKS.c.vehicle == vehicle)
    window_key = WINDOWS.c.wheelset + "@" + cast(WINDOWS.c.start_ns, String)
    windows = select(window_key).where(WINDOWS.c.vehicle == vehicle)
    return or_(
        and_(ITEMS.c.kind == SubjectKind.VEHICLE.value, ITEMS.c.key == vehicle),
        and_(ITEMS.c.kind == SubjectKind.RECORDING.value, ITEMS.c.key.in_(recordings)),
        and_(ITEMS.c.kind == SubjectKind.WINDOW.value, ITEMS.c.key.in_(windows)),
    )

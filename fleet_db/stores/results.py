"""Results of the stages: what is in force, what was in force at a time, and what is put in their place."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar, cast

import orjson
from sqlalchemy import Connection, Row, Select, bindparam, case, delete, false, insert, or_, select, update

from estimation.errors import DamagedError
from estimation.values.fields import JsonValue
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import AnyResult, History, Result, ResultKind
from fleet_db.locks import Subject, serialise
from fleet_db.packed_values import pack_value, unpack_value
from fleet_db.rows import columns_of, stored_reason, table_of
from fleet_db.session import to_json
from fleet_db.subjects import ReadOnce, Subjects
from fleet_db.tables.operation import ResultRow

V = TypeVar("V")
RESULTS = table_of(ResultRow)
OF_HEAD = [column for column in RESULTS.columns if column.name not in {"value", "parameters"}]
OF_MANY = [RESULTS.c[name] for name in ("result_id", "subject", "part", "made_from", "numerics")]
OF_MANY += [RESULTS.c[name] for name in ("status", "reason_code", "reason", "head")]
Parts = tuple[str, str]
NEWEST_FIRST = (RESULTS.c.recorded_ns.desc(), RESULTS.c.result_id.desc())
"""None of a part was recorded before the one that it follows, whatever the clock says."""
SAME_INPUTS = ("part", "made_from", "numerics", "parameters")
SHOWN = ("part", "status", "reason_code", "head", "value")
"""Another one of these is another result for whoever reads it; else only its provenance is."""
SAID = ("reason_code", "head", "value")
"""A first result without any of these is no news."""


class ResultHead(NamedTuple):  # read by the hundred: a tuple is made in C
    """What is read of many results; the reason is that of one without a number."""

    number: int
    subject: str
    part: str
    made_from: str
    numerics: str
    reason: Reason | None
    head: JsonValue


@dataclass(frozen=True, slots=True)
class ResultStore:
    """The only statements on ``results``, in one transaction."""

    connection: Connection
    subjects: Subjects
    once: ReadOnce = field(default_factory=ReadOnce)
    _ahead: dict[tuple[str, str, Parts | None], list[Row[Any]]] = field(default_factory=dict)

    def read_ahead(self, asked: Iterable[tuple[ResultKind[Any], Collection[str], Parts | None]]) -> None:
        """Read with one statement what :meth:`in_force` is asked next.

        Args:
            asked: Kinds, subjects of each, and parts: first and last; None is all. Some hundreds at most, since SQLite
                takes no deeper condition.
        """
        asked, wanted = list(asked), dict[tuple[str, str], list[tuple[Parts | None, list[Row[Any]]]]]()
        for kind, subjects, parts in asked:
            for subject in subjects:
                rows = self._ahead.setdefault((kind.stage, subject, parts), [])
                rows.clear()
                wanted.setdefault((kind.stage, subject), []).append((parts, rows))
        chosen = [_chosen(kind, subjects, None, parts).whereclause for kind, subjects, parts in asked]
        results = select(RESULTS).where(or_(*(condition for condition in chosen if condition is not None)))
        for row in self.connection.execute(results.order_by(RESULTS.c.subject, RESULTS.c.part)):
            for parts, rows in wanted.get((row.stage, row.subject), ()):
                if parts is None or parts[0] <= row.part <= parts[1]:
                    rows.append(row)

    def in_force(
        self,
        kind: ResultKind[V],
        subjects: Collection[str] | None = None,
        as_of_ns: int | None = None,
        parts: Parts | None = None,
    ) -> Sequence[Result[V]]:
        """Return the newest result of each part of some subjects, as it was recorded at ``as_of_ns``.

        By subject and part, in their order; where of all parts one counts, newest first.

        Args:
            subjects: None is all that have one.
            parts: First and last; None is all.
        """
        ahead = [self._ahead.get((kind.stage, subject, parts)) for subject in sorted(subjects or ())]
        if ahead and as_of_ns is None and None not in ahead:
            read = [row for rows in ahead for row in rows or ()]
            if kind.one_in_force:
                read.sort(key=lambda row: (row.recorded_ns, row.result_id), reverse=True)
            return [_result(kind, row) for row in read]
        order = NEWEST_FIRST if kind.one_in_force else (RESULTS.c.subject, RESULTS.c.part)
        statement = _chosen(kind, subjects, as_of_ns, parts).order_by(*order)
        return [_result(kind, row) for row in self.connection.execute(statement)]

    def numbers(self, kind: ResultKind[Any], parts: Mapping[str, Parts]) -> Sequence[tuple[str, str, int]]:
        """Return subject, part and number of what is in force, of parts of each of some subjects."""
        chosen = [_chosen(kind, [subject], None, of_subject).whereclause for subject, of_subject in parts.items()]
        one_of = or_(false(), *(condition for condition in chosen if condition is not None))
        numbers = select(RESULTS.c.subject, RESULTS.c.part, RESULTS.c.result_id).where(one_of)
        return [(row.subject, row.part, row.result_id) for row in self.connection.execute(numbers)]

    def heads(
        self, kind: ResultKind[Any], subjects: Collection[str] | None, parts: Parts | None = None
    ) -> Sequence[ResultHead]:
        """Return what :meth:`in_force` does now, of each result only what is read of hundreds."""
        statement = _chosen(kind, subjects, None, parts).with_only_columns(*OF_MANY)
        rows = self.connection.execute(statement.order_by(RESULTS.c.subject, RESULTS.c.part))
        return [
            ResultHead(
                *(number, subject, part, made_from, numerics),
                None if code is None or status == Status.ESTIMATED.value else Reason(ReasonCode(code), reason),
                _head(head, f"{kind.stage} {number}"),
            )
            for number, subject, part, made_from, numerics, status, code, reason, head in rows.all()
        ]

    def latest(self, kind: ResultKind[V], subject: str, as_of_ns: int | None = None) -> Result[V] | None:
        """Return the result of a subject that was put last, as it was recorded at ``as_of_ns``."""
        statement = _chosen(kind, [subject], as_of_ns, None).order_by(*NEWEST_FIRST).limit(1)
        row = self.connection.execute(statement).first()
        return None if row is None else _result(kind, row)

    def latest_head(self, kind: ResultKind[V], subject: str) -> Result[V] | None:
        """Return what :meth:`latest` does now, without value and parameters."""

        def read(some: Collection[str]) -> Mapping[str, Result[V]]:
            heads = _in_force(kind, some).with_only_columns(*OF_HEAD).order_by(RESULTS.c.result_id)
            return {row.subject: _result(kind, row, whole=False) for row in self.connection.execute(heads)}

        return self.once.of_wheelsets(f"head {kind.stage}", [subject], read).get(subject)

    def version(self, kind: ResultKind[Any], subject: str, parts: Parts | None = None) -> tuple[int | None, int | None]:
        """Return number and recorded time of the result that was put last: others whenever a result is another."""
        newest = _chosen(kind, [subject], None, parts).with_only_columns(RESULTS.c.result_id, RESULTS.c.recorded_ns)
        row = self.connection.execute(newest.order_by(RESULTS.c.result_id.desc()).limit(1)).first()
        return (None, None) if row is None else (row.result_id, row.recorded_ns)

    def having(self, kind: ResultKind[Any], subjects: Collection[str], parts: Parts | None = None) -> frozenset[str]:
        """Return which of some subjects have a result."""
        with_result = _chosen(kind, subjects, None, parts).with_only_columns(RESULTS.c.subject)
        return frozenset(self.connection.scalars(with_result))

    def made_from(self, kind: ResultKind[Any]) -> Mapping[str, tuple[str, str]]:
        """Return by subject what the results in force are made from, and by which version of the numerics."""
        columns = (RESULTS.c.subject, RESULTS.c.made_from, RESULTS.c.numerics)
        statement = select(*columns).where(RESULTS.c.stage == kind.stage, RESULTS.c.superseded_ns.is_(None))
        return {row.subject: (row.made_from, row.numerics) for row in self.connection.execute(statement)}

    def put_all(self, kind: ResultKind[Any], results: Sequence[AnyResult]) -> Sequence[AnyResult]:
        """Put results in force; return those that are not made from what the ones before were made from.

        Whoever reads results of this kind learns only of those that are another now.

        Args:
            results: At most one of each part.
        """
        if not results:
            return ()
        serialise(self.connection, Subject.GEOMETRIES)
        self._ahead.clear()
        before = self._before(kind, results)
        news = []
        for result in results:
            was = before.get((result.subject, "" if kind.one_in_force else result.part))
            values = _values(kind, result)
            if was is None or any(getattr(was, name) != values[name] for name in SAME_INPUTS):
                values["recorded_ns"] = max(result.recorded_ns, 0 if was is None else was.recorded_ns)
                news.append((result, values, was))
        if kind.history is History.APPENDED:
            self._append([(values, was) for _, values, was in news])
        else:
            self._replace([(values, was) for _, values, was in news])
        for result, values, was in news:
            if any(getattr(was, name, None) != values[name] for name in SHOWN if was is not None or name in SAID):
                self.subjects.raised(kind.subject, result.subject, kind.stage)
            if (None if was is None else was.head) != values["head"]:
                self.subjects.raised(kind.subject, result.subject, kind.head_facet)
        return [result for result, _, _ in news]

    def replace_all(self, kind: ResultKind[Any], results: Sequence[AnyResult]) -> None:
        """Put all results that there are of a kind without history; those of other subjects are removed."""
        self.put_all(kind, results)
        self._ahead.clear()
        of_kind = RESULTS.c.stage == kind.stage
        stored = self.connection.scalars(select(RESULTS.c.subject).where(of_kind).distinct())
        gone = set(stored) - {result.subject for result in results}
        if gone:
            self.connection.execute(delete(RESULTS).where(of_kind, RESULTS.c.subject.in_(sorted(gone))))
        for subject in gone:
            self.subjects.raised(kind.subject, subject, kind.stage)

    def _before(self, kind: ResultKind[Any], results: Sequence[AnyResult]) -> Mapping[tuple[str, str], Row[Any]]:
        """Return what stands in the place of each result, by subject and part; of ``one_in_force`` that put last."""
        statement = _in_force(kind, {result.subject for result in results})
        if not kind.one_in_force:
            statement = statement.where(RESULTS.c.part.in_({result.part for result in results}))
        rows = self.connection.execute(statement.order_by(RESULTS.c.recorded_ns, RESULTS.c.result_id))
        return {(row.subject, "" if kind.one_in_force else row.part): row for row in rows}

    def _append(self, news: Sequence[tuple[Mapping[str, Any], Row[Any] | None]]) -> None:
        names = ("stage", "subject", "part", "recorded_ns")
        followed = [{f"of_{name}": values[name] for name in names} for values, was in news if was is not None]
        if followed:
            same = [RESULTS.c[name] == bindparam(f"of_{name}") for name in ("stage", "subject", "part")]
            ended = update(RESULTS).where(*same, RESULTS.c.superseded_ns.is_(None))
            self.connection.execute(ended.values(superseded_ns=bindparam("of_recorded_ns")), followed)
        if news:
            self.connection.execute(insert(RESULTS), [values for values, _ in news])

    def _replace(self, news: Sequence[tuple[Mapping[str, Any], Row[Any] | None]]) -> None:
        new = [values for values, was in news if was is None]
        again = [{**values, "number": was.result_id} for values, was in news if was is not None]
        if new:
            self.connection.execute(insert(RESULTS), new)
        if again:
            changed = update(RESULTS).where(RESULTS.c.result_id == bindparam("number"))
            names = [name for name in again[0] if name != "number"]
            self.connection.execute(changed.values({name: bindparam(name) for name in names}), again)


def _in_force(kind: ResultKind[Any], subjects: Collection[str] | None) -> Select[Any]:
    in_force = select(RESULTS).where(RESULTS.c.stage == kind.stage, RESULTS.c.superseded_ns.is_(None))
    return in_force if subjects is None else in_force.where(RESULTS.c.subject.in_(sorted(subjects)))


def _chosen(
    kind: ResultKind[Any], subjects: Collection[str] | None, as_of_ns: int | None, parts: Parts | None
) -> Select[Any]:
    if as_of_ns is not None:
        return _as_of(kind, subjects, as_of_ns, parts)
    statement = _in_force(kind, subjects)
    return statement if parts is None else statement.where(RESULTS.c.part.between(*parts))


def _as_of(kind: ResultKind[Any], subjects: Collection[str] | None, as_of_ns: int, parts: Parts | None) -> Select[Any]:
    """Return the statement of what was in force: of each part the last that was recorded until then."""
    now, then = RESULTS.alias("now"), RESULTS.alias("then")
    same = (then.c[name] == now.c[name] for name in ("stage", "subject", "part"))
    earlier = select(then.c.result_id).where(*same, then.c.superseded_ns.is_not(None), then.c.recorded_ns <= as_of_ns)
    earlier = earlier.order_by(then.c.recorded_ns.desc(), then.c.result_id.desc()).limit(1).correlate(now)
    number = case((now.c.recorded_ns <= as_of_ns, now.c.result_id), else_=earlier.scalar_subquery())
    chosen = [now.c.stage == kind.stage, now.c.superseded_ns.is_(None)]
    chosen += [] if subjects is None else [now.c.subject.in_(sorted(subjects))]
    chosen += [] if parts is None else [now.c.part.between(*parts)]
    return select(RESULTS).where(RESULTS.c.result_id.in_(select(number).where(*chosen)))


def _values(kind: ResultKind[Any], result: AnyResult) -> dict[str, Any]:
    return columns_of(result, "number", "value", "head", "parameters") | {
        "stage": kind.stage,
        "kind": kind.subject.value,
        "head": None if result.head is None else json.dumps(result.head, separators=(",", ":"), allow_nan=False),
        "value": None if result.value is None else pack_value(result.value),
        "parameters": json.loads(to_json(dict(result.parameters))),
        "superseded_ns": None,
    }


def _result(kind: ResultKind[V], row: Row[Any], *, whole: bool = True) -> Result[V]:
    where, blob = f"{kind.stage} {row.result_id}", row.value if whole else None
    return Result(
        subject=row.subject,
        part=row.part,
        value=None if blob is None else unpack_value(kind.value, blob, where=where),
        made_from=row.made_from,
        numerics=row.numerics,
        recorded_ns=row.recorded_ns,
        status=Status(row.status),
        reason=stored_reason(row),
        head=_head(row.head, where),
        parameters=row.parameters if whole else {},
        number=row.result_id,
    )


def _head(text: str | None, where: str) -> JsonValue:
    try:
        return None if text is None else cast("JsonValue", orjson.loads(text))
    except ValueError as error:
        raise DamagedError(f"head of {where}: damaged ({error})") from error

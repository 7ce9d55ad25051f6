"""Trends, append-only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import Connection, Select, bindparam, insert, select

from estimation.values.trend import TrendRecord
from fleet_db.changes import Changes
from fleet_db.locks import Subject, serialise
from fleet_db.packed_values import pack_trend, unpack_trend
from fleet_db.rows import table_of
from fleet_db.tables import GeometryRow, TrendRow

TRENDS, GEOMETRIES = table_of(TrendRow), table_of(GeometryRow)
NEWEST_FIRST = (TRENDS.c.trend_id.desc(),)  # in the order of commit; clocks go back
LATEST_FIRST = (TRENDS.c.recorded_ns.desc(), *NEWEST_FIRST)
"""The same order: none of a wheelset was recorded before the one that it follows. What was in force at a time is the
first entry of an index from there on."""
EVER_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class TrendStore:
    """Implements ``estimation.storage.Trends``."""

    connection: Connection
    changes: Changes

    def put(self, record: TrendRecord) -> bool:
        """Append a trend; False if the newest of its wheelset is of the same baseline, quantity, inputs and code.

        It is then the newest, whatever the clock says.
        """
        serialise(self.connection, Subject.GEOMETRIES)
        newest = self.connection.execute(
            select(TRENDS.c.baseline, TRENDS.c.quantity, TRENDS.c.input_digest, TRENDS.c.code_version)
            .add_columns(TRENDS.c.recorded_ns)
            .where(TRENDS.c.wheelset == record.wheelset)
            .order_by(*NEWEST_FIRST)
            .limit(1)
        ).first()
        values = _values(record)
        if newest is not None:
            ours = (record.baseline, record.trend.quantity, record.input_digest, record.code_version)
            if (newest.baseline, newest.quantity, newest.input_digest, newest.code_version) == ours:
                return False
            values["recorded_ns"] = max(record.recorded_ns, newest.recorded_ns)
        self.connection.execute(insert(TRENDS).values(**values))
        self.changes.show(record.wheelset)
        return True

    def version(self, wheelset: str) -> tuple[int | None, ...]:
        """Return what changes whenever the newest trend or the current geometry does, at less cost; None for none.

        Number and recorded time of the trend, and those of the current geometry that was appended last.
        """
        return tuple(self.connection.execute(_version(), {"serial": wheelset}).one())

    def latest(self, wheelset: str, as_of_ns: int | None = None) -> TrendRecord | None:
        """Return the newest trend, as it was recorded at ``as_of_ns``: that of the baseline in force then."""
        as_of = {"serial": wheelset, "as_of_ns": EVER_NS if as_of_ns is None else as_of_ns}
        row = self.connection.execute(_latest(), as_of).first()
        if row is None:
            return None
        trend = unpack_trend(row.packed, where=f"trend {row.trend_id}")
        return TrendRecord(
            wheelset=row.wheelset,
            baseline=row.baseline,
            trend=trend,
            input_digest=row.input_digest,
            code_version=row.code_version,
            recorded_ns=row.recorded_ns,
            parameters=row.parameters,
        )


@cache
def _version() -> Select[Any]:
    """Return a statement that is built once, for it is executed whenever a trend is read."""
    trend = (
        select(TRENDS.c[name]).where(TRENDS.c.wheelset == bindparam("serial")).order_by(*NEWEST_FIRST).limit(1)
        for name in ("trend_id", "recorded_ns")
    )
    geometry = (
        select(GEOMETRIES.c[name])
        .where(GEOMETRIES.c.wheelset == bindparam("serial"), GEOMETRIES.c.baseline_interval.is_(None))
        .order_by(GEOMETRIES.c.geometry_id.desc())
        .limit(1)
        for name in ("geometry_id", "recorded_ns")
    )
    return select(*(one.scalar_subquery() for one in (*trend, *geometry)))


@cache
def _latest() -> Select[Any]:
    until = TRENDS.c.recorded_ns <= bindparam("as_of_ns")
    return select(TRENDS).where(TRENDS.c.wheelset == bindparam("serial"), until).order_by(*LATEST_FIRST).limit(1)


def _values(record: TrendRecord) -> dict[str, Any]:
    return {
        "wheelset": record.wheelset,
        "baseline": record.baseline,
        "quantity": record.trend.quantity,
        "input_digest": record.input_digest,
        "code_version": record.code_version,
        "recorded_ns": record.recorded_ns,
        "packed": pack_trend(record.trend),
        "parameters": dict(record.parameters),
    }

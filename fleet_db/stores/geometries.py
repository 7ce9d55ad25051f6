"""Geometry estimates, append-only, and the bins of each current one as plain rows for queries in SQL."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    and_,
    bindparam,
    case,
    delete,
    exists,
    func,
    insert,
    or_,
    select,
    update,
)

from estimation.values.geometry import (
    COMBINATIONS,
    BinValues,
    GeometryRecord,
    IntervalConicities,
    IntervalDigest,
    WheelsetGeometry,
)
from estimation.values.quantities import Status
from estimation.values.runs import SubjectKind
from estimation.values.subjects import Facet
from fleet_db.changes import CHANGES, Changes
from fleet_db.locks import Subject, serialise
from fleet_db.packed_values import pack_geometry, unpack_geometry
from fleet_db.rows import nan_if_null, null_if_nan, reason_columns, stored_reason, table_of
from fleet_db.session import to_json
from fleet_db.stores.interval_conicities import COLUMNS, conicities_of, conicities_text
from fleet_db.stores.newest_geometries import newest_of_baselines, newest_of_intervals
from fleet_db.tables import GeometryRow, WheelsetBinRow, WheelsetRow, WindowBinTableRow

BINS = table_of(WheelsetBinRow)
UNITS = {name: "rad" if name.startswith("contact_angle") else "m" for name in COMBINATIONS}
GEOMETRIES, TABLES, WHEELSETS = table_of(GeometryRow), table_of(WindowBinTableRow), table_of(WheelsetRow)
NEWEST_FIRST = (GEOMETRIES.c.geometry_id.desc(),)  # in the order of commit; clocks go back
EVER_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class GeometryStore:
    """Implements ``estimation.storage.Geometries``."""

    connection: Connection
    changes: Changes

    def put(self, record: GeometryRecord) -> bool:
        """Append an estimate; False if the newest of its key has the same inputs, parameters and code version.

        A current geometry also ends the staleness of its wheelset, whether it was appended or not. The newest is the
        one appended last, whatever the clock says; its recorded time is not before that of the one it follows.
        """
        serialise(self.connection, Subject.GEOMETRIES)
        if record.interval is None:
            self._not_stale(record.wheelset)
        newest = self.connection.execute(
            select(GEOMETRIES).where(_key(record)).order_by(*NEWEST_FIRST).limit(1)
        ).first()
        values = geometry_columns(record)
        if newest is not None:
            if all(getattr(newest, name) == values[name] for name in ("input_digest", "parameters", "code_version")):
                return False
            values["recorded_ns"] = max(record.recorded_ns, newest.recorded_ns)
        self.connection.execute(insert(GEOMETRIES).values(**values))
        self.changes.touch(record.wheelset)
        self.changes.subjects.raised(SubjectKind.WHEELSET, record.wheelset, Facet.GEOMETRY)
        if record.interval is None:
            self._show_bins(record.wheelset)
            self.changes.show(record.wheelset)
        return True

    def current(self, wheelset: str, as_of_ns: int | None = None) -> GeometryRecord | None:
        """Return the current geometry of the newest baseline with windows, as it was recorded at ``as_of_ns``.

        Where no baseline has windows any more it is the empty one of the newest.
        """
        row = self._current(wheelset, as_of_ns)
        return None if row is None else _record(row)

    def version(self, wheelset: str) -> tuple[int, int, str] | None:
        """Return what changes whenever :meth:`current` does, at less cost: None where there is no geometry.

        Number, recorded time and digest of inputs of the current geometry that was appended last, of any baseline.
        """
        row = self.connection.execute(_version(), {"serial": wheelset}).first()
        return None if row is None else (row.geometry_id, row.recorded_ns, row.input_digest)

    def newest_numbers(self) -> Mapping[str, int]:
        """Return by wheelset what changes whenever a geometry of it is appended: the number of the last."""
        last = select(func.max(GEOMETRIES.c.geometry_id)).where(GEOMETRIES.c.wheelset == WHEELSETS.c.serial)
        rows = self.connection.execute(select(WHEELSETS.c.serial, last.scalar_subquery()))
        return {serial: number for serial, number in rows if number is not None}

    def baselines(self, wheelset: str) -> Sequence[GeometryRecord]:
        """Return the current geometry of each baseline that there has been, by its number."""
        statement = select(GEOMETRIES).where(GEOMETRIES.c.geometry_id.in_(newest_of_baselines()))
        as_of = {"serial": wheelset, "as_of_ns": EVER_NS}
        return [_record(row) for row in self.connection.execute(statement.order_by(GEOMETRIES.c.baseline), as_of)]

    def interval_digests(self, wheelset: str) -> Mapping[tuple[int, int], IntervalDigest]:
        """Return by baseline and interval what the newest geometry was made from, and why it holds no number."""
        names = ("baseline", "baseline_interval", "input_digest", "windows", "status", "reason", "reason_code")
        statement = select(*(GEOMETRIES.c[name] for name in names))
        statement = statement.where(GEOMETRIES.c.geometry_id.in_(newest_of_intervals()))
        rows = self.connection.execute(statement, {"serial": wheelset, "as_of_ns": EVER_NS})
        return {
            (row.baseline, row.baseline_interval): IntervalDigest(
                row.input_digest,
                row.windows,
                None if row.status == Status.ESTIMATED.value else stored_reason(row),
            )
            for row in rows
        }

    def interval_numbers(self, wheelset: str, baseline: int) -> Mapping[int, int]:
        """Return by interval the number of its newest geometry."""
        statement = select(GEOMETRIES.c.baseline_interval, GEOMETRIES.c.geometry_id).where(
            GEOMETRIES.c.geometry_id.in_(newest_of_intervals()), GEOMETRIES.c.baseline == baseline
        )
        return {row[0]: row[1] for row in self.connection.execute(statement, {"serial": wheelset, "as_of_ns": EVER_NS})}

    def intervals(
        self,
        wheelset: str,
        baseline: int | None = None,
        as_of_ns: int | None = None,
        *,
        first: int | None = None,
        last: int | None = None,
    ) -> Sequence[GeometryRecord]:
        """Return the newest geometry of each mileage interval, of one baseline or of all, in the order of mileage.

        Args:
            baseline: Its number; None is all.
            as_of_ns: Recorded until then; None is now.
            first, last: Numbers of the first and the last interval; None is all.
        """
        statement = select(GEOMETRIES).where(GEOMETRIES.c.geometry_id.in_(newest_of_intervals()))
        if baseline is not None:
            statement = statement.where(GEOMETRIES.c.baseline == baseline)
        if first is not None:
            statement = statement.where(GEOMETRIES.c.baseline_interval >= first)
        if last is not None:
            statement = statement.where(GEOMETRIES.c.baseline_interval <= last)
        statement = statement.order_by(GEOMETRIES.c.baseline, GEOMETRIES.c.baseline_interval)
        as_of = {"serial": wheelset, "as_of_ns": EVER_NS if as_of_ns is None else as_of_ns}
        return [_record(row) for row in self.connection.execute(statement, as_of)]

    def conicities(self, wheelset: str, baseline: int) -> Sequence[IntervalConicities]:
        """Return the conicities of the newest geometry of each mileage interval of a baseline, in order of mileage."""
        statement = select(*COLUMNS).where(GEOMETRIES.c.geometry_id.in_(newest_of_intervals()))
        statement = statement.where(GEOMETRIES.c.baseline == baseline).order_by(GEOMETRIES.c.baseline_interval)
        rows = self.connection.execute(statement, {"serial": wheelset, "as_of_ns": EVER_NS}).all()
        return [conicities_of(row) for row in rows]

    def stale(self, limit: int) -> Sequence[str]:
        """Return serials whose windows, bin tables, mountings or reprofilings changed since their current geometry.

        A changed class of a vehicle, or a changed radius of a wheelset, counts as a change of the windows.

        Only those that have a bin table or a geometry: the others have nothing to estimate from.
        """
        self.changes.flush()
        statement = select(CHANGES.c.wheelset).where(
            CHANGES.c.change > CHANGES.c.geometry_change,
            or_(
                exists().where(TABLES.c.wheelset == CHANGES.c.wheelset),
                exists().where(GEOMETRIES.c.wheelset == CHANGES.c.wheelset),
            ),
        )
        return list(self.connection.scalars(statement.order_by(CHANGES.c.wheelset).limit(limit)))

    def change(self, wheelset: str) -> int:
        """Return how often the inputs of this wheelset's geometry have changed."""
        self.changes.flush()
        return self.connection.scalar(select(CHANGES.c.change).where(CHANGES.c.wheelset == wheelset)) or 0

    def mark_current(self, wheelset: str, change: int) -> None:
        """Record that the geometry of a wheelset covers its inputs up to ``change``; a later change makes it stale."""
        self.changes.flush()
        self.connection.execute(update(CHANGES).where(CHANGES.c.wheelset == wheelset).values(geometry_change=change))

    def _not_stale(self, wheelset: str) -> None:
        self.changes.flush()
        self.connection.execute(
            update(CHANGES).where(CHANGES.c.wheelset == wheelset).values(geometry_change=CHANGES.c.change)
        )

    def _current(self, wheelset: str, as_of_ns: int | None) -> Row[Any] | None:
        as_of = {"serial": wheelset, "as_of_ns": EVER_NS if as_of_ns is None else as_of_ns}
        return self.connection.execute(_current(), as_of).first()

    def bins_are_current(self, wheelset: str) -> bool:
        """Whether the plain rows of bins are those of the current geometry."""
        row = self._current(wheelset, None)
        return row is None or row.geometry_id == self._shown(wheelset)

    def _shown(self, wheelset: str) -> int | None:
        found: int | None = self.connection.scalar(
            select(BINS.c.geometry_id).where(BINS.c.wheelset == wheelset).limit(1)
        )
        return found

    def _show_bins(self, wheelset: str) -> None:
        """Let the plain rows of bins be those of the current geometry."""
        row = self._current(wheelset, None)
        if row is not None and row.geometry_id != self._shown(wheelset):
            _replace_bins(self.connection, wheelset, row.geometry_id, _record(row).geometry)


@cache
def _version() -> Select[tuple[int, int, str]]:
    """Return a statement that is built once, for it is executed whenever a geometry is read."""
    statement = select(GEOMETRIES.c.geometry_id, GEOMETRIES.c.recorded_ns, GEOMETRIES.c.input_digest)
    chosen = (GEOMETRIES.c.wheelset == bindparam("serial"), GEOMETRIES.c.baseline_interval.is_(None))
    return statement.where(*chosen).order_by(*NEWEST_FIRST).limit(1)


@cache
def _current() -> Select[Any]:
    with_windows_first = case((GEOMETRIES.c.windows > 0, 0), else_=1)
    statement = select(GEOMETRIES).where(GEOMETRIES.c.geometry_id.in_(newest_of_baselines()))
    return statement.order_by(with_windows_first, GEOMETRIES.c.baseline.desc()).limit(1)


def _key(record: GeometryRecord) -> ColumnElement[bool]:
    interval = GEOMETRIES.c.baseline_interval
    return and_(
        GEOMETRIES.c.wheelset == record.wheelset,
        GEOMETRIES.c.baseline == record.baseline,
        interval.is_(None) if record.interval is None else interval == record.interval,
    )


def geometry_columns(record: GeometryRecord) -> dict[str, Any]:
    """Return the columns of an estimate."""
    geometry = record.geometry
    return {
        "wheelset": record.wheelset,
        "baseline": record.baseline,
        "baseline_interval": record.interval,
        "mileage_km": null_if_nan(record.mileage_km),
        "from_ns": record.from_ns,
        "to_ns": record.to_ns,
        "input_digest": record.input_digest,
        "track_versions": {section: list(versions) for section, versions in record.track_versions.items()},
        "parameters": json.loads(to_json(dict(record.parameters))),
        "code_version": record.code_version,
        "recorded_ns": record.recorded_ns,
        "status": str(geometry.status),
        **reason_columns(geometry.reason),
        "windows": geometry.windows,
        "conicities": None if record.interval is None else conicities_text(geometry),
        "packed": pack_geometry(geometry),
    }


def _record(row: Row[Any]) -> GeometryRecord:
    return GeometryRecord(
        wheelset=row.wheelset,
        baseline=row.baseline,
        interval=row.baseline_interval,
        mileage_km=nan_if_null(row.mileage_km),
        from_ns=row.from_ns,
        to_ns=row.to_ns,
        geometry=unpack_geometry(row.packed, where=f"geometry estimate {row.geometry_id}"),
        input_digest=row.input_digest,
        track_versions={section: tuple(versions) for section, versions in row.track_versions.items()},
        parameters=row.parameters,
        code_version=row.code_version,
        recorded_ns=row.recorded_ns,
    )


def _replace_bins(connection: Connection, wheelset: str, geometry_id: int, geometry: WheelsetGeometry) -> None:
    """Replace the rows of ``wheelset`` by the bins of ``geometry``."""
    connection.execute(delete(BINS).where(BINS.c.wheelset == wheelset))
    rows = [
        {
            "wheelset": wheelset,
            "bin": index,
            "geometry_id": geometry_id,
            "lateral_displacement_low_m": float(geometry.bin_edges[index]),
            "lateral_displacement_high_m": float(geometry.bin_edges[index + 1]),
            "samples": null_if_nan(float(geometry.samples[index])),
            **_bin_columns(geometry, index),
        }
        for index in range(len(geometry.samples))
    ]
    if rows:
        connection.execute(insert(BINS), rows)


def _bin_columns(geometry: WheelsetGeometry, index: int) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    for name, unit in UNITS.items():
        values: BinValues = getattr(geometry, name)
        columns[f"{name}_{unit}"] = null_if_nan(float(values.value[index]))
        columns[f"{name}_std_{unit}"] = null_if_nan(float(values.std[index]))
        columns[f"{name}_status"] = str(values.status[index])
    return columns

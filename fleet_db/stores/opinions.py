"""What windows say of adhesion, dampers and rails, sections of friction, and their passes of suspensions."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Select, Text, and_, cast, delete, func, select
from sqlalchemy.sql.base import ReadOnlyColumnCollection

from estimation.errors import ParameterError, StorageError
from estimation.values.opinions import CELLS as CELLS_STAGE
from estimation.values.opinions import (
    CREEP,
    FRICTION,
    GEAR,
    GEAR_DAMPERS,
    GearDamper,
    RailKey,
    SectionAdhesion,
    SectionConicity,
    StoredCell,
    WheelKey,
    WindowAdhesion,
    WindowDamper,
)
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Facet, SubjectKind
from estimation.values.trend import SuspensionFinding
from estimation.values.windows import WindowKey
from fleet_db.due import NOT_LOOKED_AT, list_due
from fleet_db.fields import fields_of, from_json, to_json, value_of
from fleet_db.packed_values import (
    pack_value,
    pack_window_adhesion,
    pack_window_damper,
    unpack_value,
    unpack_window_adhesion,
    unpack_window_damper,
)
from fleet_db.rows import (
    columns_of,
    equal,
    given,
    key_given,
    key_of,
    put_rows,
    replace_all,
    row_of,
    same_window,
    table_of,
    upsert,
    value_of_row,
    window_key,
)
from fleet_db.rows import replace as replace_row
from fleet_db.stores.results import ResultStore
from fleet_db.subjects import RaisingStore
from fleet_db.tables.track import SuspensionFindingRow
from fleet_db.tables.windows import RailCellRow, SectionAdhesionRow, WindowAdhesionRow, WindowDamperRow, WindowRow

OF_WINDOWS, OF_SECTIONS = table_of(WindowAdhesionRow), table_of(SectionAdhesionRow)
WINDOWS = table_of(WindowRow)
FORGOTTEN = 1000  # windows at once: the next run goes on
SAME = same_window(OF_WINDOWS, WINDOWS)


class AdhesionStore(RaisingStore):
    """Creep forces of windows, and the friction of sections."""

    def looked_at(self, keys: Sequence[WindowKey]) -> Mapping[WindowKey, str]:
        """Return digests of the samples that the creep of windows was found from."""
        of_keys = window_key(OF_WINDOWS).in_(keys)
        rows = self.connection.execute(select(*OF_WINDOWS.primary_key, OF_WINDOWS.c.content_digest).where(of_keys))
        return {(row.wheelset, row.start_ns): row.content_digest for row in rows}

    def list_waiting(self, wheelset: str) -> None:
        """List the estimated windows of a wheelset that have not been looked at."""
        list_due(self.connection, CREEP, and_(WINDOWS.c.wheelset == wheelset, NOT_LOOKED_AT))

    def list_pooled(self, section: str, before_ns: int) -> None:
        """List the windows of a section that begin before a time, and whose sums are kept, to be pooled again."""
        kept = select(OF_WINDOWS.c.with_sums).where(SAME, OF_WINDOWS.c.with_sums).exists()
        old = (WINDOWS.c.track_section == section, WINDOWS.c.start_ns < before_ns)
        list_due(self.connection, FRICTION, and_(*old, kept))

    def put_all(self, creeps: Sequence[WindowAdhesion]) -> None:
        """Store the creep of windows; earlier ones are replaced. Their sections pool them then."""
        put_rows(self.connection, OF_WINDOWS, [_values(creep) for creep in creeps])
        keys = [(creep.wheelset, creep.start_ns) for creep in creeps]
        if keys:
            list_due(self.connection, FRICTION, window_key(WINDOWS).in_(keys))
        for creep in creeps:
            self.subjects.raised(SubjectKind.SECTION, creep.track_section, CREEP)
            self.subjects.raised(SubjectKind.VEHICLE, creep.vehicle, CREEP)

    def of_wheelset(self, wheelset: str, after_ns: int | None, limit: int) -> Sequence[WindowAdhesion]:
        """Return the creep of the windows of a wheelset that begin after a time, oldest first.

        A window whose samples are others by now is left out until it has been looked at again.
        """
        of_windows = (OF_WINDOWS.c.wheelset == wheelset, OF_WINDOWS.c.content_digest == WINDOWS.c.content_digest)
        chosen = select(OF_WINDOWS).select_from(OF_WINDOWS.join(WINDOWS, SAME))
        chosen = chosen.where(*of_windows, *given(after_ns, OF_WINDOWS.c.start_ns.__gt__))
        return self._windows(chosen.limit(limit))

    def of_section(self, section: str, from_ns: int, to_ns: int) -> Sequence[WindowAdhesion]:
        """Return the creep of the windows of a section that begin within ``[from_ns, to_ns]``, by time and wheelset.

        A window whose samples or section are others by now is left out until it has been looked at again.
        """
        within = (OF_WINDOWS.c.start_ns >= from_ns, OF_WINDOWS.c.start_ns <= to_ns)
        return self._windows(_standing(select(OF_WINDOWS), section).where(*within))

    def starts_with_sums(self, section: str, from_ns: int, to_ns: int) -> Sequence[int]:
        """Return when the windows of a section began within ``[from_ns, to_ns]`` whose sums of friction are kept."""
        start_ns = OF_WINDOWS.c.start_ns
        chosen = _standing(select(start_ns).distinct(), section).where(start_ns >= from_ns, start_ns <= to_ns)
        return list(self.connection.execute(chosen.where(OF_WINDOWS.c.with_sums).order_by(start_ns)).scalars())

    def forget_sums(self, section: str, before_ns: int) -> int:
        """Remove the sums of friction of the windows of a section that begin before a time; return of how many.

        They are a hundred times as long as the forces, and only what is pooled needs them.
        """
        old = (OF_WINDOWS.c.track_section == section, OF_WINDOWS.c.start_ns < before_ns, OF_WINDOWS.c.with_sums)
        with_sums = self._windows(select(OF_WINDOWS).where(*old).limit(FORGOTTEN))
        replace_all(self.connection, OF_WINDOWS, [_values(replace(creep, sums=None)) for creep in with_sums])
        return len(with_sums)

    def put_section(self, friction: SectionAdhesion, code_version: str, made_with: str) -> bool:
        """Store a section's friction; of hours that end within these, those that reach back furthest stay: no gaps."""
        values = {name: getattr(friction, name) for name in ("track_section", "to_ns", "from_ns")}
        values |= {"code_version": code_version, "made_with": made_with, "packed": pack_value(friction)}
        before = row_of(self.connection, OF_SECTIONS, friction.track_section, friction.to_ns)
        if before is not None and all(before[name] == value for name, value in values.items() if name != "made_with"):
            if before["made_with"] != made_with:
                replace_row(self.connection, OF_SECTIONS, values)
            return False
        within = (
            OF_SECTIONS.c.track_section == friction.track_section,
            OF_SECTIONS.c.to_ns >= friction.from_ns,
            OF_SECTIONS.c.to_ns < friction.to_ns,
        )
        first = select(func.min(OF_SECTIONS.c.to_ns)).where(*within).scalar_subquery()
        self.connection.execute(delete(OF_SECTIONS).where(*within, OF_SECTIONS.c.to_ns > first))
        self.subjects.raised(SubjectKind.SECTION, friction.track_section, FRICTION)
        return upsert(self.connection, OF_SECTIONS, values)

    def made_with(self, sections: Sequence[str]) -> Mapping[str, tuple[int, str]]:
        """Return when the newest hours of some sections end, and digests of the limits that they were found with."""
        columns = (OF_SECTIONS.c.track_section, OF_SECTIONS.c.to_ns, OF_SECTIONS.c.made_with)
        of_sections = select(*columns).where(OF_SECTIONS.c.track_section.in_(sections))
        rows = self.connection.execute(of_sections.order_by(OF_SECTIONS.c.to_ns))
        return {row.track_section: (row.to_ns, row.made_with) for row in rows}

    def section(self, section: str, at_ns: int | None = None) -> SectionAdhesion | None:
        """Return the newest friction of a section, or that of hours with a vehicle time; None where there is none."""
        return next(iter(self.during(section, at_ns, at_ns, most=1)), None)

    def during(
        self, section: str, from_ns: int | None, to_ns: int | None, most: int | None = None
    ) -> Sequence[SectionAdhesion]:
        """Return the friction of a section of all hours that hold a time of a span, newest first; None is all."""
        within = (*given(to_ns, OF_SECTIONS.c.from_ns.__le__), *given(from_ns, OF_SECTIONS.c.to_ns.__ge__))
        newest_first = select(OF_SECTIONS).where(OF_SECTIONS.c.track_section == section, *within)
        rows = self.connection.execute(newest_first.order_by(OF_SECTIONS.c.to_ns.desc()).limit(most))
        where = f"friction of section {section}"
        return [unpack_value(SectionAdhesion, row.packed, where=where) for row in rows]

    def _windows(self, statement: Select[Any]) -> Sequence[WindowAdhesion]:
        rows = self.connection.execute(statement.order_by(OF_WINDOWS.c.start_ns, OF_WINDOWS.c.wheelset))
        return [
            unpack_window_adhesion(row.packed, where=f"creep of window {row.wheelset}@{row.start_ns}") for row in rows
        ]


def _standing(statement: Select[Any], section: str) -> Select[Any]:
    """Return a statement for the creep of windows of a section, of the samples that they have."""
    return statement.select_from(OF_WINDOWS.join(WINDOWS, SAME)).where(
        OF_WINDOWS.c.track_section == section,
        WINDOWS.c.track_section == section,
        WINDOWS.c.content_digest == OF_WINDOWS.c.content_digest,
    )


def _values(creep: WindowAdhesion) -> dict[str, object]:
    plain = ("wheelset", "start_ns", "track_section", "content_digest")
    packed = {"with_sums": creep.sums is not None, "packed": pack_window_adhesion(creep)}
    return {**{name: getattr(creep, name) for name in plain}, **packed}


FINDINGS = table_of(SuspensionFindingRow)


class SuspensionStore(RaisingStore):
    """What the passes of sections show of the suspension of vehicles."""

    def put(self, finding: SuspensionFinding, epoch: int | None = None) -> None:
        """Store a finding of an epoch; one of the same vehicle, section and time is replaced."""
        values = columns_of(finding, "assumed") | {"assumed_m": finding.assumed, "epoch": epoch}
        put_rows(self.connection, FINDINGS, [values])
        self.subjects.raised(SubjectKind.VEHICLE, finding.vehicle, Facet.STIFFNESS)

    def forget(self, section: str, epoch: int, *, behind: bool) -> None:
        """Remove what an epoch of a section, with ``behind`` later ones too, has shown, before it is stored again."""
        chosen = FINDINGS.c.epoch >= epoch if behind else FINDINGS.c.epoch == epoch
        gone = delete(FINDINGS).where(FINDINGS.c.section == section, chosen).returning(FINDINGS.c.vehicle)
        for vehicle in self.connection.scalars(gone):
            self.subjects.raised(SubjectKind.VEHICLE, vehicle, Facet.STIFFNESS)

    def list(self, vehicle: str | None = None) -> Sequence[SuspensionFinding]:
        """Return the findings of a vehicle, or of all, in order of vehicle, time and section."""
        return self._read(select(FINDINGS).where(*equal(FINDINGS, vehicle=vehicle)), FINDINGS.c)

    def newest(self, count: int) -> Sequence[SuspensionFinding]:
        """Return at most ``count`` newest findings of every vehicle, in order of vehicle, time and section."""
        order = (FINDINGS.c.to_ns.desc(), FINDINGS.c.section.desc())
        rank = func.row_number().over(partition_by=FINDINGS.c.vehicle, order_by=order)
        ranked = select(FINDINGS, rank.label("rank")).subquery()
        return self._read(select(ranked).where(ranked.c.rank <= count), ranked.c)

    def _read(self, statement: Select[Any], columns: ReadOnlyColumnCollection[str, Any]) -> Sequence[SuspensionFinding]:
        ordered = statement.order_by(columns.vehicle, columns.to_ns, columns.section)
        return [value_of_row(SuspensionFinding, row, assumed=row.assumed_m) for row in self.connection.execute(ordered)]


DAMPERS = table_of(WindowDamperRow)
SAME_DAMPER = same_window(WINDOWS, DAMPERS, "content_digest")


@dataclass(frozen=True, slots=True)
class DamperStore:
    """What windows say of the lateral dampers of running gears, and what they say together."""

    connection: Connection
    results: ResultStore

    def put_all(self, dampers: Sequence[WindowDamper]) -> None:
        """Store what windows say of dampers; what they said before is replaced."""
        plain = ("vehicle", "first_axle", "start_ns", "wheelset", "content_digest")
        rows = [
            {**{name: getattr(damper, name) for name in plain}, "packed": pack_window_damper(damper)}
            for damper in dampers
        ]
        put_rows(self.connection, DAMPERS, rows)

    def gears(self, vehicles: Sequence[str]) -> Sequence[GEAR]:
        """Return the running gears of some vehicles of which windows say something."""
        columns = (DAMPERS.c.vehicle, DAMPERS.c.first_axle)
        rows = self.connection.execute(select(*columns).where(columns[0].in_(vehicles)).distinct().order_by(*columns))
        return [(row.vehicle, row.first_axle) for row in rows]

    def newest(self, vehicle: str, first_axle: int, limit: int) -> Sequence[WindowDamper]:
        """Return what the newest windows of a running gear that are there unchanged say, newest first."""
        of_gear = (DAMPERS.c.vehicle == vehicle, DAMPERS.c.first_axle == first_axle)
        statement = select(DAMPERS).select_from(DAMPERS.join(WINDOWS, SAME_DAMPER)).where(*of_gear)
        rows = self.connection.execute(statement.order_by(DAMPERS.c.start_ns.desc()).limit(limit))
        return [unpack_window_damper(row.packed, where=f"damper of {vehicle} axle {first_axle}") for row in rows]

    def forget(self, vehicle: str, first_axle: int, before_ns: int) -> int:
        """Remove what windows of a running gear say that began before a time; return of how many."""
        of_gear = (DAMPERS.c.vehicle == vehicle, DAMPERS.c.first_axle == first_axle)
        return self.connection.execute(delete(DAMPERS).where(*of_gear, DAMPERS.c.start_ns < before_ns)).rowcount

    def of_vehicles(self, vehicles: Collection[str]) -> Sequence[GearDamper]:
        """Return the dampers of some vehicles, by vehicle and axle."""
        results = self.results.in_force(GEAR_DAMPERS, vehicles)
        dampers = (result.value for result in results if result.value is not None)
        return sorted(dampers, key=lambda damper: (damper.vehicle, damper.first_axle))


CELLS = table_of(RailCellRow)


class RailsStore(RaisingStore):
    """Conicities of wheelsets by section."""

    def cells(self, wheelsets: Collection[str] | None = None) -> Sequence[StoredCell]:
        """Return all cells, or those of some wheelsets, in the order of their keys.

        One that cannot be read says so by its reason, and has no digest, so that it is made again.
        """
        columns = [CELLS.c[name] for name in (*_KEY, "digest", "interval_digest")]
        wanted: Select[Any] = select(*columns, cast(CELLS.c.document, Text).label("document"))
        rows = self.connection.execute(wanted.where(*given(wheelsets, CELLS.c.wheelset.in_)))
        return sorted((_cell(row) for row in rows), key=lambda cell: (cell.wheel, cell.rail))

    def put_cells(self, cells: Sequence[StoredCell]) -> None:
        """Store cells, in the place of earlier ones of the same keys."""
        put_rows(self.connection, CELLS, [_key_values(cell.wheel, cell.rail) | _cell_values(cell) for cell in cells])
        self._raise({cell.wheel.wheelset for cell in cells})

    def drop_cells(self, keys: Sequence[tuple[WheelKey, RailKey]]) -> None:
        """Remove cells."""
        if keys:
            parameters = [key_of(CELLS, _key_values(wheel, rail)) for wheel, rail in keys]
            self.connection.execute(delete(CELLS).where(key_given(CELLS)), parameters)
        self._raise({wheel.wheelset for wheel, _ in keys})

    def _raise(self, wheelsets: Collection[str]) -> None:
        for wheelset in wheelsets:
            self.subjects.raised(SubjectKind.WHEELSET, wheelset, CELLS_STAGE)


_KEY = ("wheelset", "baseline", "mileage_interval", "section", "period")

_EXTENT = ("windows", "from_ns", "to_ns")


def _key_values(wheel: WheelKey, rail: RailKey) -> dict[str, Any]:
    parts = (wheel.wheelset, wheel.baseline, wheel.interval, rail.section, rail.period)
    return dict(zip(_KEY, parts, strict=True))


def _cell_values(stored: StoredCell) -> dict[str, Any]:
    document: dict[str, Any] = {name: getattr(stored, name) for name in _EXTENT}
    if stored.reason is not None:
        document["reason"] = to_json(stored.reason)
    if stored.cell is not None:
        scalars, arrays = fields_of(stored.cell, without=("wheel", "rail"))
        of_arrays = {name: to_json(values.tolist()) for name, values in arrays.items()}
        document |= {"scalars": scalars, "arrays": of_arrays}
    return {"digest": stored.digest, "interval_digest": stored.interval_digest, "document": document}


def _cell(row: Row[Any]) -> StoredCell:
    wheel, rail = WheelKey(row.wheelset, row.baseline, row.mileage_interval), RailKey(row.section, row.period)
    try:
        document = json.loads(row.document)
        reason = from_json(document["reason"], Reason) if "reason" in document else None
        cell = _conicities(document, wheel, rail) if "arrays" in document or reason is None else None
        extent = {name: int(document[name]) for name in _EXTENT}
    except (ValueError, TypeError, LookupError, AttributeError, StorageError, ParameterError) as error:
        text = f"the conicities of {wheel.wheelset} on {rail.section} are damaged in the store ({error})"
        return StoredCell(wheel, rail, "", None, Reason(ReasonCode.CELL_DAMAGED, text))
    return StoredCell(wheel, rail, row.digest, cell, reason, **extent, interval_digest=row.interval_digest)


def _conicities(document: Mapping[str, Any], wheel: WheelKey, rail: RailKey) -> SectionConicity:
    arrays = {name: np.array(from_json(values, tuple[float, ...])) for name, values in document["arrays"].items()}
    return value_of(SectionConicity, document["scalars"], arrays, wheel=wheel, rail=rail)

"""What windows and passes of sections say of the dampers and the suspension of vehicles."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Select, and_, delete, func, select
from sqlalchemy.sql.base import ReadOnlyColumnCollection

from estimation.values.opinions import GEAR, GEAR_DAMPERS, GearDamper, WindowDamper
from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from estimation.values.trend import SuspensionFinding
from fleet_db.packed_values import pack_window_damper, unpack_window_damper
from fleet_db.rows import columns_of, put_rows, table_of, value_of_row
from fleet_db.stores.results import ResultStore
from fleet_db.subjects import Subjects
from fleet_db.tables.track import SuspensionFindingRow
from fleet_db.tables.windows import WindowDamperRow, WindowRow

FINDINGS = table_of(SuspensionFindingRow)


@dataclass(frozen=True, slots=True)
class SuspensionStore:
    """What the passes of sections show of the suspension of vehicles."""

    connection: Connection
    subjects: Subjects

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
        statement = select(FINDINGS)
        if vehicle is not None:
            statement = statement.where(FINDINGS.c.vehicle == vehicle)
        return self._read(statement, FINDINGS.c)

    def newest(self, count: int) -> Sequence[SuspensionFinding]:
        """Return at most ``count`` newest findings of every vehicle, in order of vehicle, time and section."""
        order = (FINDINGS.c.to_ns.desc(), FINDINGS.c.section.desc())
        rank = func.row_number().over(partition_by=FINDINGS.c.vehicle, order_by=order)
        ranked = select(FINDINGS, rank.label("rank")).subquery()
        return self._read(select(ranked).where(ranked.c.rank <= count), ranked.c)

    def _read(self, statement: Select[Any], columns: ReadOnlyColumnCollection[str, Any]) -> Sequence[SuspensionFinding]:
        ordered = statement.order_by(columns.vehicle, columns.to_ns, columns.section)
        return [value_of_row(SuspensionFinding, row, assumed=row.assumed_m) for row in self.connection.execute(ordered)]


OF_WINDOWS, WINDOWS = table_of(WindowDamperRow), table_of(WindowRow)
SAME = and_(
    WINDOWS.c.wheelset == OF_WINDOWS.c.wheelset,
    WINDOWS.c.start_ns == OF_WINDOWS.c.start_ns,
    WINDOWS.c.content_digest == OF_WINDOWS.c.content_digest,
)


@dataclass(frozen=True, slots=True)
class DamperStore:
    """What windows say of the lateral dampers of running gears, and what they say together."""

    connection: Connection
    results: ResultStore

    def put_all(self, found: Sequence[WindowDamper]) -> None:
        """Store what windows say of dampers; what they said before is replaced."""
        put_rows(self.connection, OF_WINDOWS, [_values(one) for one in found])

    def gears(self, vehicles: Sequence[str]) -> Sequence[GEAR]:
        """Return the running gears of some vehicles of which windows say something."""
        columns = (OF_WINDOWS.c.vehicle, OF_WINDOWS.c.first_axle)
        rows = self.connection.execute(select(*columns).where(columns[0].in_(vehicles)).distinct().order_by(*columns))
        return [(row.vehicle, row.first_axle) for row in rows]

    def newest(self, vehicle: str, first_axle: int, limit: int) -> Sequence[WindowDamper]:
        """Return what the newest windows of a running gear that are there unchanged say, newest first."""
        own = (OF_WINDOWS.c.vehicle == vehicle, OF_WINDOWS.c.first_axle == first_axle)
        statement = select(OF_WINDOWS).select_from(OF_WINDOWS.join(WINDOWS, SAME)).where(*own)
        rows = self.connection.execute(statement.order_by(OF_WINDOWS.c.start_ns.desc()).limit(limit))
        return [unpack_window_damper(row.packed, where=f"damper of {vehicle} axle {first_axle}") for row in rows]

    def forget(self, vehicle: str, first_axle: int, before_ns: int) -> int:
        """Remove what windows of a running gear say that began before a time; return of how many."""
        own = (OF_WINDOWS.c.vehicle == vehicle, OF_WINDOWS.c.first_axle == first_axle)
        return self.connection.execute(delete(OF_WINDOWS).where(*own, OF_WINDOWS.c.start_ns < before_ns)).rowcount

    def of_vehicle(self, vehicle: str) -> Sequence[GearDamper]:
        """Return the dampers of a vehicle by axle."""
        return self.of_vehicles([vehicle])

    def of_vehicles(self, vehicles: Collection[str]) -> Sequence[GearDamper]:
        """Return the dampers of some vehicles, by vehicle and axle."""
        found = self.results.in_force(GEAR_DAMPERS, vehicles)
        dampers = (one.value for one in found if one.value is not None)
        return sorted(dampers, key=lambda one: (one.vehicle, one.first_axle))


def _values(found: WindowDamper) -> dict[str, object]:
    plain = ("vehicle", "first_axle", "start_ns", "wheelset", "content_digest")
    return {**{name: getattr(found, name) for name in plain}, "packed": pack_window_damper(found)}

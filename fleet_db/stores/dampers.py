"""What windows say of the lateral dampers of running gears, and what they say together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, and_, delete, select

from estimation.values.dampers import GearDamper, WindowDamper
from estimation.values.runs import SubjectKind
from estimation.values.subjects import Facet
from fleet_db.changes import Changes
from fleet_db.packed_dampers import pack_gear_damper, pack_window_damper, unpack_gear_damper, unpack_window_damper
from fleet_db.rows import table_of, upsert
from fleet_db.tables.opinions import GearDamperRow, WindowDamperRow
from fleet_db.tables.windows import WindowRow

OF_WINDOWS, OF_GEARS, WINDOWS = table_of(WindowDamperRow), table_of(GearDamperRow), table_of(WindowRow)
SAME = and_(
    WINDOWS.c.wheelset == OF_WINDOWS.c.wheelset,
    WINDOWS.c.start_ns == OF_WINDOWS.c.start_ns,
    WINDOWS.c.content_digest == OF_WINDOWS.c.content_digest,
)


@dataclass(frozen=True, slots=True)
class DamperStore:
    """Implements ``estimation.storage.Dampers``."""

    connection: Connection
    changes: Changes

    def put(self, found: WindowDamper) -> None:
        """Store what a window says of a damper; what it said before is replaced."""
        values = {
            "vehicle": found.vehicle,
            "first_axle": found.first_axle,
            "start_ns": found.start_ns,
            "wheelset": found.wheelset,
            "content_digest": found.content_digest,
            "packed": pack_window_damper(found),
        }
        upsert(self.connection, OF_WINDOWS, values)

    def newest(self, vehicle: str, first_axle: int, limit: int) -> Sequence[WindowDamper]:
        """Return what the newest windows of a running gear say, newest first.

        Windows that are not there any more, or have other samples now, say nothing.

        Args:
            limit: How many at most.
        """
        own = (OF_WINDOWS.c.vehicle == vehicle, OF_WINDOWS.c.first_axle == first_axle)
        statement = select(OF_WINDOWS).select_from(OF_WINDOWS.join(WINDOWS, SAME)).where(*own)
        rows = self.connection.execute(statement.order_by(OF_WINDOWS.c.start_ns.desc()).limit(limit))
        return [unpack_window_damper(row.packed, where=f"damper of {vehicle} axle {first_axle}") for row in rows]

    def forget(self, vehicle: str, first_axle: int, before_ns: int) -> int:
        """Remove what windows of a running gear say that began before a time; return of how many."""
        own = (OF_WINDOWS.c.vehicle == vehicle, OF_WINDOWS.c.first_axle == first_axle)
        return self.connection.execute(delete(OF_WINDOWS).where(*own, OF_WINDOWS.c.start_ns < before_ns)).rowcount

    def put_gear(self, found: GearDamper, wheelset: str, code_version: str) -> bool:
        """Store the damper of a running gear in place of what was known; return whether anything changed.

        Jobs look again at the wheelset then: its alerts rest on it.

        Args:
            found: From its newest windows.
        """
        values = {
            "vehicle": found.vehicle,
            "first_axle": found.first_axle,
            "code_version": code_version,
            "packed": pack_gear_damper(found),
        }
        own = (OF_GEARS.c.vehicle == found.vehicle, OF_GEARS.c.first_axle == found.first_axle)
        before = self.connection.execute(select(OF_GEARS).where(*own)).mappings().first()
        if before is not None and all(before[name] == value for name, value in values.items()):
            return False
        self.changes.touch(wheelset)
        self.changes.subjects.raised(SubjectKind.VEHICLE, found.vehicle, Facet.DAMPER)
        return upsert(self.connection, OF_GEARS, values)

    def of_vehicle(self, vehicle: str) -> Sequence[GearDamper]:
        """Return the dampers of a vehicle by axle."""
        return self.of_vehicles([vehicle])

    def of_vehicles(self, vehicles: Collection[str]) -> Sequence[GearDamper]:
        """Return the dampers of some vehicles, by vehicle and axle."""
        statement = select(OF_GEARS).where(OF_GEARS.c.vehicle.in_(vehicles))
        rows = self.connection.execute(statement.order_by(OF_GEARS.c.vehicle, OF_GEARS.c.first_axle))
        return [unpack_gear_damper(row.packed, where=f"damper of {row.vehicle} axle {row.first_axle}") for row in rows]

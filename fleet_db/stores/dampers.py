"""What windows say of the lateral dampers of running gears, and what they say together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, and_, delete, select

from estimation.values.opinions import GEAR, GEAR_DAMPERS, GearDamper, WindowDamper
from fleet_db.packed_dampers import pack_window_damper, unpack_window_damper
from fleet_db.rows import insert_all_new, replace_all, table_of
from fleet_db.stores.results import ResultStore
from fleet_db.tables.opinions import WindowDamperRow
from fleet_db.tables.windows import WindowRow

OF_WINDOWS, WINDOWS = table_of(WindowDamperRow), table_of(WindowRow)
SAME = and_(
    WINDOWS.c.wheelset == OF_WINDOWS.c.wheelset,
    WINDOWS.c.start_ns == OF_WINDOWS.c.start_ns,
    WINDOWS.c.content_digest == OF_WINDOWS.c.content_digest,
)


@dataclass(frozen=True, slots=True)
class DamperStore:
    """Implements ``estimation.storage.Dampers``."""

    connection: Connection
    results: ResultStore

    def put_all(self, found: Sequence[WindowDamper]) -> None:
        """Store what windows say of dampers; what they said before is replaced."""
        rows = [_values(one) for one in found]
        if insert_all_new(self.connection, OF_WINDOWS, rows) < len(rows):
            replace_all(self.connection, OF_WINDOWS, rows)

    def gears(self, vehicles: Sequence[str]) -> Sequence[GEAR]:
        """Return the running gears of some vehicles of which windows say something."""
        columns = (OF_WINDOWS.c.vehicle, OF_WINDOWS.c.first_axle)
        rows = self.connection.execute(select(*columns).where(columns[0].in_(vehicles)).distinct().order_by(*columns))
        return [(row.vehicle, row.first_axle) for row in rows]

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

    def of_vehicle(self, vehicle: str) -> Sequence[GearDamper]:
        """Return the dampers of a vehicle by axle."""
        return self.of_vehicles([vehicle])

    def of_vehicles(self, vehicles: Collection[str]) -> Sequence[GearDamper]:
        """Return the dampers of some vehicles, by vehicle and axle."""
        found = self.results.in_force(GEAR_DAMPERS, vehicles)
        dampers = (one.value for one in found if one.value is not None)
        return sorted(dampers, key=lambda one: (one.vehicle, one.first_axle))


def _values(found: WindowDamper) -> dict[str, object]:
    return {
        "vehicle": found.vehicle,
        "first_axle": found.first_axle,
        "start_ns": found.start_ns,
        "wheelset": found.wheelset,
        "content_digest": found.content_digest,
        "packed": pack_window_damper(found),
    }

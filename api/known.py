"""Filters that name something: what is not there is refused, for an empty list would look like good news."""

from __future__ import annotations

from estimation.errors import NotFoundError
from fleet_db.storage import SqlUnitOfWork


def require_known(
    unit: SqlUnitOfWork,
    *,
    fleet: str | None = None,
    vehicle: str | None = None,
    wheelset: str | None = None,
    vehicle_class: str | None = None,
    fleet_alert: int | None = None,
) -> None:
    """Refuse filters that name nothing; to be asked where a page is empty, for one with rows shows that they do."""
    if fleet is not None and all(one.code != fleet for one in unit.registry.fleets()):
        raise NotFoundError("fleet", fleet)
    if vehicle is not None:
        unit.registry.vehicle(vehicle)
    if wheelset is not None:
        unit.registry.wheelset(wheelset)
    if vehicle_class is not None and unit.registry.vehicle_class(vehicle_class) is None:
        raise NotFoundError("vehicle class", vehicle_class)
    if fleet_alert is not None and unit.alerts.get(fleet_alert).wheelset is not None:
        raise NotFoundError("fleet alert", str(fleet_alert))

"""What is known of a vehicle, at one of its wheelsets: alerts are of wheelsets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from estimation.storage import UnitOfWork

T = TypeVar("T")


def at_first_axles(unit: UnitOfWork, of_vehicles: Mapping[str, T]) -> dict[str, T]:
    """Return what is known by vehicle by the serial of the wheelset at its first axle that has one.

    Parameters
    ----------
    unit
        The registry is read.
    of_vehicles
        By code; vehicles without a wheelset are left out.
    """
    if not of_vehicles:
        return {}
    first: dict[str, tuple[int, str]] = {}
    for wheelset in unit.registry.wheelsets():
        mounting = wheelset.mounting
        if mounting is not None:
            here = (mounting.axle, wheelset.serial)
            first[mounting.vehicle] = min(here, first.get(mounting.vehicle, here))
    return {first[code][1]: known for code, known in of_vehicles.items() if code in first}

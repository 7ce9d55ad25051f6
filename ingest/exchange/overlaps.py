"""Two exchanges of a vehicle never share an instant: neither would give a window there."""

from __future__ import annotations

from estimation.errors import ConflictError
from fleet_db.storage import SqlUnitOfWork
from ingest.exchange.bundle import SUFFIX


def check_alone(unit: SqlUnitOfWork, vehicle: str, first_ns: int, last_ns: int, digest: str) -> None:
    """Raise where another exchange of the vehicle shares an instant with one.

    Args:
        first_ns, last_ns: First and last instant of the exchange, ns on the vehicle's clock.

    Raises:
        ConflictError: There is one; names it.
    """
    for other in unit.chunks.overlapping(vehicle, first_ns, last_ns + 1):
        if other.suffix == SUFFIX and other.digest != digest:
            reason = (
                f"another exchange of vehicle {vehicle} is stored for the same time: {other.digest[:12]};"
                f" where that one is wrong: treadwatch recordings set-aside {other.digest[:12]}"
            )
            raise ConflictError(reason, kind="chunk", key=other.digest)

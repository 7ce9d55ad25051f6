"""Visits to the lathe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, select

from estimation.values.registry import Reprofiling
from fleet_db.rows import table_of
from fleet_db.tables import ReprofilingRow

REPROFILINGS = table_of(ReprofilingRow)


def reprofilings_of(connection: Connection, serials: Sequence[str]) -> dict[str, tuple[Reprofiling, ...]]:
    """Return the visits of some wheelsets by serial, oldest first."""
    statement = select(REPROFILINGS).where(REPROFILINGS.c.wheelset.in_(serials)).order_by(REPROFILINGS.c.at_ns)
    found: dict[str, tuple[Reprofiling, ...]] = {}
    for row in connection.execute(statement):
        found[row.wheelset] = (*found.get(row.wheelset, ()), Reprofiling(*row))
    return found


def stored_reprofiling(connection: Connection, wheelset: str, at_ns: int) -> dict[str, Any] | None:
    """Return the row of a visit; None where there is none."""
    same = (REPROFILINGS.c.wheelset == wheelset, REPROFILINGS.c.at_ns == at_ns)
    row = connection.execute(select(REPROFILINGS).where(*same)).mappings().first()
    return None if row is None else dict(row)

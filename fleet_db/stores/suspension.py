"""What the passes of sections show of the suspension of vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, select

from estimation.values.suspension import SuspensionFinding
from fleet_db.models.suspension import SuspensionFindingRow
from fleet_db.rows import table_of, upsert

FINDINGS = table_of(SuspensionFindingRow)


@dataclass(frozen=True, slots=True)
class SuspensionStore:
    """Implements ``estimation.storage.Suspensions``."""

    connection: Connection

    def put(self, finding: SuspensionFinding) -> None:
        """Store a finding; one of the same vehicle, section and time is replaced: its epoch was looked at again."""
        values = {
            "vehicle": finding.vehicle,
            "section": finding.section,
            "to_ns": finding.to_ns,
            "from_ns": finding.from_ns,
            "ratio": finding.ratio,
            "ratio_std": finding.ratio_std,
            "assumed_m": finding.assumed,
            "code_version": finding.code_version,
            "recorded_ns": finding.recorded_ns,
        }
        upsert(self.connection, FINDINGS, values)

    def list(self, vehicle: str | None = None) -> Sequence[SuspensionFinding]:
        """Return the findings of a vehicle, or of all, in order of vehicle, time and section."""
        statement = select(FINDINGS).order_by(FINDINGS.c.vehicle, FINDINGS.c.to_ns, FINDINGS.c.section)
        if vehicle is not None:
            statement = statement.where(FINDINGS.c.vehicle == vehicle)
        return [
            SuspensionFinding(
                vehicle=row.vehicle,
                section=row.section,
                from_ns=row.from_ns,
                to_ns=row.to_ns,
                ratio=row.ratio,
                ratio_std=row.ratio_std,
                assumed=row.assumed_m,
                code_version=row.code_version,
                recorded_ns=row.recorded_ns,
            )
            for row in self.connection.execute(statement)
        ]

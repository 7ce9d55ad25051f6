"""What the passes of sections show of the suspension of vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, Select, delete, func, select
from sqlalchemy.sql.base import ReadOnlyColumnCollection

from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from estimation.values.trend import SuspensionFinding
from fleet_db.rows import table_of, upsert
from fleet_db.subjects import Subjects
from fleet_db.tables.track import SuspensionFindingRow

FINDINGS = table_of(SuspensionFindingRow)


@dataclass(frozen=True, slots=True)
class SuspensionStore:
    """Implements ``estimation.storage.Suspensions``."""

    connection: Connection
    subjects: Subjects

    def put(self, finding: SuspensionFinding, epoch: int | None = None) -> None:
        """Store a finding of an epoch; one of the same vehicle, section and time is replaced."""
        values = {
            "vehicle": finding.vehicle,
            "section": finding.section,
            "to_ns": finding.to_ns,
            "from_ns": finding.from_ns,
            "ratio": finding.ratio,
            "ratio_std": finding.ratio_std,
            "assumed_m": finding.assumed,
            "code_version": finding.code_version,
            "epoch": epoch,
            "recorded_ns": finding.recorded_ns,
        }
        upsert(self.connection, FINDINGS, values)
        self.subjects.raised(SubjectKind.VEHICLE, finding.vehicle, Facet.STIFFNESS)

    def forget(self, section: str, epoch: int, *, behind: bool) -> None:
        """Remove what an epoch of a section has shown, before it is stored again.

        Args:
            behind: What the epochs behind it have shown goes too.
        """
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
        """Return the newest findings of every vehicle, in order of vehicle, time and section.

        Args:
            count: At most so many of each.
        """
        order = (FINDINGS.c.to_ns.desc(), FINDINGS.c.section.desc())
        rank = func.row_number().over(partition_by=FINDINGS.c.vehicle, order_by=order)
        ranked = select(FINDINGS, rank.label("rank")).subquery()
        return self._read(select(ranked).where(ranked.c.rank <= count), ranked.c)

    def _read(self, statement: Select[Any], columns: ReadOnlyColumnCollection[str, Any]) -> Sequence[SuspensionFinding]:
        ordered = statement.order_by(columns.vehicle, columns.to_ns, columns.section)
        return [_finding(row) for row in self.connection.execute(ordered)]


def _finding(row: Row[Any]) -> SuspensionFinding:
    return SuspensionFinding(
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

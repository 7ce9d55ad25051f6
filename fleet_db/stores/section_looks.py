"""What a job has seen of each track section."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import Connection, select

from estimation.values.runs import SectionLook
from fleet_db.rows import table_of, upsert
from fleet_db.tables import SectionChangeRow, SectionLookRow

LOOKS, CHANGES = table_of(SectionLookRow), table_of(SectionChangeRow)


@dataclass(frozen=True, slots=True)
class SectionLookStore:
    """Implements ``estimation.storage.SectionLooks``."""

    connection: Connection

    def of(self, stage: str) -> Mapping[str, SectionLook]:
        """Return by section what the last look of a job that found nothing to do was made from."""
        statement = select(LOOKS.c.section, LOOKS.c.inputs, LOOKS.c.touched).where(LOOKS.c.stage == stage)
        return {row.section: SectionLook(row.inputs, row.touched) for row in self.connection.execute(statement)}

    def touched(self) -> Mapping[str, int]:
        """Return by section how often something has happened to its windows, positions or epochs.

        Windows on no section count under the empty text; what is not in it has not been touched.
        """
        found = self.connection.execute(select(CHANGES.c.section, CHANGES.c.touched))
        return {row.section: row.touched for row in found}

    def note(self, stage: str, looks: Mapping[str, SectionLook]) -> None:
        """Note looks at sections that found nothing to do.

        Args:
            looks: By section what they were made from, as it was before they began.
        """
        for section, look in sorted(looks.items()):
            values = {"inputs": look.inputs, "touched": look.touched}
            upsert(self.connection, LOOKS, {"stage": stage, "section": section, **values})

"""What a job has seen of each wheelset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import Connection, select

from fleet_db.models import LookRow
from fleet_db.rows import table_of, upsert

LOOKS = table_of(LookRow)


@dataclass(frozen=True, slots=True)
class LookStore:
    """Implements ``estimation.storage.Looks``."""

    connection: Connection

    def of(self, stage: str) -> Mapping[str, str]:
        """Return by wheelset what the last look of a job was made from, as a digest."""
        rows = self.connection.execute(select(LOOKS.c.wheelset, LOOKS.c.inputs).where(LOOKS.c.stage == stage))
        return {row.wheelset: row.inputs for row in rows}

    def note(self, stage: str, wheelset: str, inputs: str) -> None:
        """Note what a look at a wheelset was made from.

        Parameters
        ----------
        stage
            Name of the job.
        wheelset
            Serial number.
        inputs
            Digest of 64 hexadecimal digits.
        """
        upsert(self.connection, LOOKS, {"stage": stage, "wheelset": wheelset, "inputs": inputs})

"""Receipts of recordings."""

from __future__ import annotations

import builtins
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import Connection, Row, exists, func, select, update

from estimation.errors import NotFoundError
from estimation.values.reasons import ReasonCode
from fleet_db.models import ChunkRow, VehicleRow
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.rows import insert_new, reason_columns, stored_reason, table_of

CHUNKS, VEHICLES = table_of(ChunkRow), table_of(VehicleRow)


@dataclass(frozen=True, slots=True)
class ChunkStore:
    """Receipts, in one transaction."""

    connection: Connection

    def get(self, digest: str) -> ChunkRecord | None:
        """Return the receipt of the recording with this digest."""
        row = self.connection.execute(select(CHUNKS).where(CHUNKS.c.digest == digest)).first()
        return None if row is None else _record(row)

    def put(self, record: ChunkRecord) -> bool:
        """Store a receipt; False, and nothing changed, if there is one of that digest."""
        return insert_new(self.connection, CHUNKS, _values(record))

    def update(self, record: ChunkRecord) -> None:
        """Replace the receipt of ``record.digest``.

        Raises
        ------
        NotFoundError
            There is none.
        """
        result = self.connection.execute(
            update(CHUNKS).where(CHUNKS.c.digest == record.digest).values(**_values(record))
        )
        if result.rowcount == 0:
            raise NotFoundError("chunk", record.digest)

    def overlapping(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[ChunkRecord]:
        """Return decoded recordings with frames in ``[from_ns, to_ns)``, by their first frame."""
        statement = (
            select(CHUNKS)
            .where(CHUNKS.c.vehicle == vehicle, CHUNKS.c.first_ns < to_ns, CHUNKS.c.last_ns >= from_ns)
            .where(CHUNKS.c.state == ChunkState.DECODED.value)
            .order_by(CHUNKS.c.first_ns, CHUNKS.c.digest)
        )
        return [_record(row) for row in self.connection.execute(statement)]

    def purge(self, before_ns: int, now_ns: int, limit: int) -> Sequence[ChunkRecord]:
        """Note of decoded recordings that came before a time that their raw bytes are deleted; return these."""
        old = (CHUNKS.c.received_ns < before_ns, CHUNKS.c.purged_ns.is_(None))
        decoded = select(CHUNKS).where(*old, CHUNKS.c.state == ChunkState.DECODED.value)
        found = [_record(row) for row in self.connection.execute(decoded.order_by(CHUNKS.c.digest).limit(limit))]
        digests = [record.digest for record in found]
        self.connection.execute(update(CHUNKS).where(CHUNKS.c.digest.in_(digests)).values(purged_ns=now_ns))
        return found

    def newest_ns(self) -> int | None:
        """Return the end of the newest decoded recording on its vehicle's clock; None where there is none."""
        decoded = CHUNKS.c.state == ChunkState.DECODED.value
        found: int | None = self.connection.scalar(select(func.max(CHUNKS.c.last_ns)).where(decoded))
        return found

    def purged(self) -> frozenset[str]:
        """Return the digests of the recordings whose raw bytes were deleted."""
        return frozenset(self.connection.scalars(select(CHUNKS.c.digest).where(CHUNKS.c.purged_ns.is_not(None))))

    def waiting_for_time(self, vehicle: str) -> Sequence[ChunkRecord]:
        """Return the receipts of a vehicle's recordings that wait for a TIME frame beside them, oldest first."""
        statement = (
            select(CHUNKS)
            .where(CHUNKS.c.vehicle == vehicle, CHUNKS.c.state == ChunkState.STORED.value)
            .where(CHUNKS.c.reason_code == ReasonCode.WAITS_FOR_TIME.value)
            .order_by(CHUNKS.c.recorded_ns, CHUNKS.c.digest)
        )
        return [_record(row) for row in self.connection.execute(statement)]

    def beginning(self, digest: str) -> Sequence[ChunkRecord]:
        """Return the receipts whose digest begins so, at most two."""
        begins = func.substr(CHUNKS.c.digest, 1, len(digest)) == digest
        return [_record(row) for row in self.connection.execute(select(CHUNKS).where(begins).limit(2))]

    def list(
        self, state: ChunkState | None, vehicle: str | None, code: ReasonCode | None, limit: int
    ) -> builtins.list[ChunkRecord]:
        """Return the newest receipts of a state, a vehicle and a reason, where given; newest first."""
        statement = select(CHUNKS).order_by(CHUNKS.c.recorded_ns.desc(), CHUNKS.c.digest).limit(limit)
        if state is not None:
            statement = statement.where(CHUNKS.c.state == state.value)
        if vehicle is not None:
            statement = statement.where(CHUNKS.c.vehicle == vehicle)
        if code is not None:
            statement = statement.where(CHUNKS.c.reason_code == code.value)
        return [_record(row) for row in self.connection.execute(statement)]

    def ends(self, count: int) -> Sequence[ChunkRecord]:
        """Return at most ``count`` of the oldest and of the newest receipts whose raw bytes are kept."""
        kept = select(CHUNKS).where(CHUNKS.c.purged_ns.is_(None)).limit(count)
        oldest = kept.order_by(CHUNKS.c.recorded_ns, CHUNKS.c.digest)
        newest = kept.order_by(CHUNKS.c.recorded_ns.desc(), CHUNKS.c.digest)
        return [_record(row) for statement in (oldest, newest) for row in self.connection.execute(statement)]

    def of_known_vehicles(self) -> Sequence[ChunkRecord]:
        """Return the receipts of recordings that waited for their vehicle and whose vehicle there is, oldest first."""
        statement = (
            select(CHUNKS)
            .where(CHUNKS.c.state == ChunkState.STORED.value)
            .where(CHUNKS.c.reason_code == ReasonCode.VEHICLE_UNKNOWN.value)
            .where(exists().where(VEHICLES.c.code == CHUNKS.c.vehicle))
            .order_by(CHUNKS.c.recorded_ns, CHUNKS.c.digest)
        )
        return [_record(row) for row in self.connection.execute(statement)]

    def with_state(self, state: ChunkState, limit: int = 100) -> Sequence[ChunkRecord]:
        """Return receipts in ``state``, oldest first."""
        statement = (
            select(CHUNKS)
            .where(CHUNKS.c.state == state.value)
            .order_by(CHUNKS.c.recorded_ns, CHUNKS.c.digest)
            .limit(limit)
        )
        return [_record(row) for row in self.connection.execute(statement)]


def _values(record: ChunkRecord) -> dict[str, object]:
    plain = {"counts": dict(record.counts), "state": record.state.value}
    return asdict(record) | plain | reason_columns(record.reason)


def _record(row: Row[Any]) -> ChunkRecord:
    fields = dict(row._mapping)  # noqa: SLF001 - SQLAlchemy's public accessor
    del fields["reason_code"]
    return ChunkRecord(**{**fields, "state": ChunkState(row.state), "reason": stored_reason(row)})

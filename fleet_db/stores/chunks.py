"""Receipts of recordings."""

from __future__ import annotations

import builtins
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    CompoundSelect,
    Connection,
    Row,
    bindparam,
    exists,
    func,
    select,
    tuple_,
    union_all,
    update,
)

from estimation.errors import NotFoundError
from estimation.values.reasons import ReasonCode
from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from estimation.values.windows import WindowState
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.rows import insert_new, reason_columns, stored_reason, table_of
from fleet_db.subjects import Subjects
from fleet_db.tables import ChunkRow, MountingRow, VehicleRow, WindowRow
from fleet_db.tables.recordings import CLOCKS, LENGTHS, UNDECODED, of_length

CHUNKS, VEHICLES = table_of(ChunkRow), table_of(VehicleRow)
MOUNTINGS, WINDOWS = table_of(MountingRow), table_of(WindowRow)
LOOKED_THROUGH = 5_000
"""Receipts of all vehicles, the newest, that are looked through for one of a vehicle."""


@dataclass(frozen=True, slots=True)
class ChosenChunks:
    """Which receipts are listed; None is no filter.

    Attributes:
        state, vehicle, fleet, code: Of the recording, of its vehicle now, and of its reason. Deleted recordings are
            listed where their state is asked for only.
        received_from_ns, received_to_ns: Received in this range, ns of our clock, half-open.
        measured_from_ns, measured_to_ns: With frames in this range of the vehicle's clock, half-open.
    """

    state: ChunkState | None = None
    vehicle: str | None = None
    fleet: str | None = None
    code: ReasonCode | None = None
    received_from_ns: int | None = None
    received_to_ns: int | None = None
    measured_from_ns: int | None = None
    measured_to_ns: int | None = None

    def conditions(self) -> builtins.list[ColumnElement[bool]]:
        """Return the conditions of a statement over the receipts."""
        of_fleet = None if self.fleet is None else select(VEHICLES.c.code).where(VEHICLES.c.fleet == self.fleet)
        not_deleted = CHUNKS.c.state != ChunkState.DELETED.value
        return [
            not_deleted if self.state is None else CHUNKS.c.state == self.state.value,
            *([] if self.vehicle is None else [CHUNKS.c.vehicle == self.vehicle]),
            *([] if of_fleet is None else [CHUNKS.c.vehicle.in_(of_fleet)]),
            *([] if self.code is None else [CHUNKS.c.reason_code == self.code.value]),
            *([] if self.received_from_ns is None else [CHUNKS.c.received_ns >= self.received_from_ns]),
            *([] if self.received_to_ns is None else [CHUNKS.c.received_ns < self.received_to_ns]),
            *([] if self.measured_from_ns is None else [CHUNKS.c.last_ns >= self.measured_from_ns]),
            *([] if self.measured_to_ns is None else [CHUNKS.c.first_ns < self.measured_to_ns]),
        ]


@dataclass(frozen=True, slots=True)
class Undecoded:
    """Recordings that wait for a worker: how many, of how many bytes, since when (ns of our clock; None for none)."""

    count: int
    size_bytes: int
    since_ns: int | None


@dataclass(frozen=True, slots=True)
class ChunkStore:
    """Receipts, in one transaction."""

    connection: Connection
    subjects: Subjects

    def get(self, digest: str) -> ChunkRecord | None:
        """Return the receipt of the recording with this digest."""
        row = self.connection.execute(select(CHUNKS).where(CHUNKS.c.digest == digest)).first()
        return None if row is None else _record(row)

    def put(self, record: ChunkRecord) -> bool:
        """Store a receipt; False, and nothing changed, if there is one of that digest."""
        self._note(record)
        return insert_new(self.connection, CHUNKS, _values(record))

    def update(self, record: ChunkRecord) -> None:
        """Replace the receipt of ``record.digest``.

        Raises:
            NotFoundError: There is none.
        """
        before = self.get(record.digest)
        if before is None:
            raise NotFoundError("chunk", record.digest)
        self.connection.execute(update(CHUNKS).where(CHUNKS.c.digest == record.digest).values(**_values(record)))
        self._note(before)
        self._note(record)

    def overlapping(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[ChunkRecord]:
        """Return decoded recordings with frames in ``[from_ns, to_ns)``, by their first frame.

        What is read does not grow with the recordings of the vehicle: those of each length have an index.
        """
        return self._overlapping(vehicle, from_ns, to_ns, CLOCKS[0])

    def overlapping_by_recorder(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[ChunkRecord]:
        """Return decoded recordings whose recorder stamped frames in ``[from_ns, to_ns)``, by their first frame."""
        return self._overlapping(vehicle, from_ns, to_ns, CLOCKS[1])

    def _overlapping(self, vehicle: str, from_ns: int, to_ns: int, clock: tuple[str, str]) -> Sequence[ChunkRecord]:
        within = {"of_vehicle": vehicle, "from_ns": from_ns, "to_ns": to_ns}
        within |= {f"from_ns_{number}": from_ns - (longest or 0) for number, (_, _, longest) in enumerate(LENGTHS)}
        found = [_record(row) for row in self.connection.execute(_in_span(clock), within)]
        return sorted(found, key=lambda record: (record.first_ns or 0, record.digest))

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

    def newest_of_vehicle(self, vehicle: str, most: int = LOOKED_THROUGH) -> ChunkRecord | None:
        """Return the receipt of a vehicle that came last; None where none is among the newest of all vehicles.

        Args:
            most: How many receipts of all vehicles are looked through: there is no index by vehicle.
        """
        place = (CHUNKS.c.received_ns.desc(), CHUNKS.c.digest.desc())
        there = CHUNKS.c.state != ChunkState.DELETED.value
        names = (CHUNKS.c.digest, CHUNKS.c.vehicle, CHUNKS.c.received_ns)
        newest = select(*names).where(there).order_by(*place).limit(most).subquery()
        of_vehicle = select(newest.c.digest).where(newest.c.vehicle == vehicle)
        digest = self.connection.scalar(of_vehicle.order_by(newest.c.received_ns.desc()).limit(1))
        return None if digest is None else self.get(digest)

    def purged(self) -> frozenset[str]:
        """Return the digests of the recordings whose raw bytes were deleted."""
        return frozenset(self.connection.scalars(select(CHUNKS.c.digest).where(CHUNKS.c.purged_ns.is_not(None))))

    def undecoded(
        self, limit: int, after: tuple[int, str] = (-1, ""), vehicle: str | None = None
    ) -> Sequence[ChunkRecord]:
        """Return the receipts of recordings that wait for a worker to decode them, in the order of their receipt.

        Args:
            limit: At most so many.
            after: Recorded time and digest of the last one of the page before.
            vehicle: Only its; None for all.
        """
        place = (CHUNKS.c.recorded_ns, CHUNKS.c.digest)
        statement = select(CHUNKS).where(UNDECODED, tuple_(*place) > tuple_(*after)).order_by(*place).limit(limit)
        if vehicle is not None:
            statement = statement.where(CHUNKS.c.vehicle == vehicle)
        return [_record(row) for row in self.connection.execute(statement)]

    def undecoded_size(self) -> Undecoded:
        """Return how many recordings wait for a worker to decode them, how large they are, and since when."""
        sums = (func.count(), func.coalesce(func.sum(CHUNKS.c.size_bytes), 0), func.min(CHUNKS.c.recorded_ns))
        count, size, since_ns = self.connection.execute(select(*sums).where(UNDECODED)).one()
        return Undecoded(int(count), int(size), since_ns)

    def of_digests(self, digests: Sequence[str]) -> dict[str, ChunkRecord]:
        """Return the receipts of these recordings, each under its digest.

        Args:
            digests: At most some hundreds.
        """
        found = self.connection.execute(select(CHUNKS).where(CHUNKS.c.digest.in_(digests)))
        return {row.digest: _record(row) for row in found}

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

    def page(
        self, chosen: ChosenChunks, limit: int, before: tuple[int, str] | None = None
    ) -> builtins.list[ChunkRecord]:
        """Return receipts, the one that was received last first.

        Args:
            limit: At most so many.
            before: Time of receipt and digest of the last one of the page before; None for the first page.
        """
        place = (CHUNKS.c.received_ns, CHUNKS.c.digest)
        statement = select(CHUNKS).where(*chosen.conditions()).order_by(*(one.desc() for one in place)).limit(limit)
        if before is not None:
            statement = statement.where(tuple_(*place) < tuple_(*before))
        return [_record(row) for row in self.connection.execute(statement)]

    def window_counts(self, record: ChunkRecord) -> dict[WindowState, int]:
        """Return how many windows share time and vehicle with a recording, by their state."""
        if record.first_ns is None or record.last_ns is None:
            return {}
        mounted = select(MOUNTINGS.c.wheelset).where(MOUNTINGS.c.vehicle == record.vehicle)
        statement = (
            select(WINDOWS.c.state, func.count())
            .where(WINDOWS.c.wheelset.in_(mounted), WINDOWS.c.vehicle == record.vehicle)
            .where(WINDOWS.c.start_ns <= record.last_ns, WINDOWS.c.start_ns > record.first_ns - WINDOWS.c.length_ns)
            .group_by(WINDOWS.c.state)
        )
        return {WindowState(state): int(count) for state, count in self.connection.execute(statement)}

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

    def _note(self, record: ChunkRecord) -> None:
        """Let what rests on the rejected recordings of a vehicle follow one that is among them, or was."""
        if record.state is ChunkState.REJECTED:
            self.subjects.raised(SubjectKind.VEHICLE, record.vehicle, Facet.RECORDINGS)


@cache
def _in_span(clock: tuple[str, str]) -> CompoundSelect[Any]:
    """Return the statement for decoded recordings in a span of a clock, in the parameters ``from_ns`` and ``to_ns``."""
    first, last = (CHUNKS.c[name] for name in clock)
    within = (CHUNKS.c.vehicle == bindparam("of_vehicle"), first < bindparam("to_ns"), last >= bindparam("from_ns"))
    each = [
        select(CHUNKS)
        .where(*within, of_length(condition, clock))
        .where(*([] if longest is None else [first >= bindparam(f"from_ns_{number}")]))
        for number, (_, condition, longest) in enumerate(LENGTHS)
    ]
    return union_all(*each)


def _values(record: ChunkRecord) -> dict[str, object]:
    plain = {"counts": dict(record.counts), "state": record.state.value}
    stamps = {name: record.counts.get(name) for name in CLOCKS[1]}
    return asdict(record) | plain | stamps | reason_columns(record.reason)


def _record(row: Row[Any]) -> ChunkRecord:
    fields = dict(row._mapping)  # noqa: SLF001 - SQLAlchemy's public accessor
    for name in ("reason_code", *CLOCKS[1]):
        del fields[name]
    return ChunkRecord(**{**fields, "state": ChunkState(row.state), "reason": stored_reason(row)})

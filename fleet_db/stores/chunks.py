"""Receipts of recordings, what was done to them by hand, and readings of their raw files."""

from __future__ import annotations

import builtins
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import (
    ColumnElement,
    CompoundSelect,
    Select,
    and_,
    bindparam,
    exists,
    func,
    insert,
    select,
    tuple_,
    union_all,
    update,
)

from estimation.errors import ConflictError
from estimation.values.reasons import ReasonCode
from estimation.values.runs import Facet, SubjectKind
from estimation.values.windows import WindowState
from fleet_db.records import ChunkRecord, ChunkState, RawScrub, RecordingChange
from fleet_db.rows import columns_of, equal, given, insert_new, present, row_of, table_of, value_of_row
from fleet_db.subjects import RaisingStore, Store
from fleet_db.tables.recordings import CLOCKS, LENGTHS, UNDECODED, ChunkRow, RawScrubRow, RecordingChangeRow, of_length
from fleet_db.tables.registry import MountingRow, VehicleRow
from fleet_db.tables.windows import WindowRow

CHUNKS, VEHICLES = table_of(ChunkRow), table_of(VehicleRow)
MOUNTINGS, WINDOWS = table_of(MountingRow), table_of(WindowRow)
LOOKED_THROUGH = 5_000
"""Receipts of all vehicles, the newest, that are looked through for one of a vehicle."""


@dataclass(frozen=True, slots=True)
class ChosenChunks:
    """Which receipts are listed; None is no filter. Deleted recordings are only where their state is asked for."""

    state: ChunkState | None = None
    vehicle: str | None = None
    fleet: str | None = None  # of its vehicle now
    code: ReasonCode | None = None  # of its reason
    received_from_ns: int | None = None  # by our clock, half-open with the next
    received_to_ns: int | None = None
    measured_from_ns: int | None = None  # with frames in this range of the vehicle's clock, half-open
    measured_to_ns: int | None = None

    def conditions(self) -> builtins.list[ColumnElement[bool]]:
        """Return the conditions of a statement over the receipts."""
        of_fleet = None if self.fleet is None else select(VEHICLES.c.code).where(VEHICLES.c.fleet == self.fleet)
        not_deleted = CHUNKS.c.state != ChunkState.DELETED.value
        return [
            *([not_deleted] if self.state is None else []),
            *equal(CHUNKS, state=self.state, vehicle=self.vehicle, reason_code=self.code),
            *given(of_fleet, CHUNKS.c.vehicle.in_),
            *given(self.received_from_ns, CHUNKS.c.received_ns.__ge__),
            *given(self.received_to_ns, CHUNKS.c.received_ns.__lt__),
            *given(self.measured_from_ns, CHUNKS.c.last_ns.__ge__),
            *given(self.measured_to_ns, CHUNKS.c.first_ns.__lt__),
        ]


@dataclass(frozen=True, slots=True)
class Undecoded:
    """Recordings that wait for a worker: how many, of how many bytes, since when (ns of our clock; None for none)."""

    count: int
    size_bytes: int
    since_ns: int | None


class ChunkStore(RaisingStore):
    """Receipts, in one transaction."""

    def get(self, digest: str) -> ChunkRecord | None:
        """Return the receipt of the recording with this digest."""
        row = row_of(self.connection, CHUNKS, digest)
        return None if row is None else value_of_row(ChunkRecord, row)

    def put(self, record: ChunkRecord) -> bool:
        """Store a receipt; False, and nothing changed, if there is one of that digest."""
        self._note(record)
        return insert_new(self.connection, CHUNKS, _values(record))

    def update(self, record: ChunkRecord) -> None:
        """Replace the receipt of ``record.digest``; raises NotFoundError."""
        before = present(self.get(record.digest), "chunk", record.digest)
        self.connection.execute(update(CHUNKS).where(CHUNKS.c.digest == record.digest).values(**_values(record)))
        self._note(before)
        self._note(record)

    def overlapping(
        self, vehicle: str, from_ns: int, to_ns: int, clock: tuple[str, str] = CLOCKS[0]
    ) -> Sequence[ChunkRecord]:
        """Return decoded recordings with frames in ``[from_ns, to_ns)`` of a clock, by their first frame.

        What is read does not grow with the recordings of the vehicle: those of each length have an index.
        """
        within = {"of_vehicle": vehicle, "from_ns": from_ns, "to_ns": to_ns}
        within |= {f"from_ns_{number}": from_ns - (longest or 0) for number, (_, _, longest) in enumerate(LENGTHS)}
        return sorted(self._read(IN_SPAN[clock], within), key=lambda record: (record.first_ns or 0, record.digest))

    def overlapping_by_recorder(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[ChunkRecord]:
        """Return decoded recordings whose recorder stamped frames in ``[from_ns, to_ns)``, by their first frame."""
        return self.overlapping(vehicle, from_ns, to_ns, CLOCKS[1])

    def purge(self, before_ns: int, now_ns: int, limit: int) -> Sequence[ChunkRecord]:
        """Note of decoded recordings that came before a time that their raw bytes are deleted; return these."""
        old = (CHUNKS.c.received_ns < before_ns, CHUNKS.c.purged_ns.is_(None))
        decoded = select(CHUNKS).where(*old, CHUNKS.c.state == ChunkState.DECODED.value)
        records = self._read(decoded.order_by(CHUNKS.c.digest).limit(limit))
        digests = [record.digest for record in records]
        self.connection.execute(update(CHUNKS).where(CHUNKS.c.digest.in_(digests)).values(purged_ns=now_ns))
        return records

    def newest_ns(self) -> int | None:
        """Return the end of the newest decoded recording on its vehicle's clock; None where there is none."""
        decoded = CHUNKS.c.state == ChunkState.DECODED.value
        newest_ns: int | None = self.connection.scalar(select(func.max(CHUNKS.c.last_ns)).where(decoded))
        return newest_ns

    def newest_of_vehicle(self, vehicle: str, most: int = LOOKED_THROUGH) -> ChunkRecord | None:
        """Return the newest receipt of a vehicle among the ``most`` newest of all (there is no index by vehicle)."""
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
        """Return receipts that wait for decoding, oldest first, behind (recorded time, digest) of ``after``."""
        place = (CHUNKS.c.recorded_ns, CHUNKS.c.digest)
        behind = select(CHUNKS).where(UNDECODED, tuple_(*place) > tuple_(*after), *equal(CHUNKS, vehicle=vehicle))
        return self._read(behind.order_by(*place).limit(limit))

    def undecoded_size(self) -> Undecoded:
        """Return how many recordings wait for a worker to decode them, how large they are, and since when."""
        sums = (func.count(), func.coalesce(func.sum(CHUNKS.c.size_bytes), 0), func.min(CHUNKS.c.recorded_ns))
        count, size, since_ns = self.connection.execute(select(*sums).where(UNDECODED)).one()
        return Undecoded(int(count), int(size), since_ns)

    def of_digests(self, digests: Sequence[str]) -> dict[str, ChunkRecord]:
        """Return the receipts of some hundred recordings at most, each under its digest."""
        return {record.digest: record for record in self._read(select(CHUNKS).where(CHUNKS.c.digest.in_(digests)))}

    def waiting_for_time(self, vehicle: str) -> Sequence[ChunkRecord]:
        """Return the receipts of a vehicle's recordings that wait for a TIME frame beside them, oldest first."""
        return self._stored(ReasonCode.WAITS_FOR_TIME, CHUNKS.c.vehicle == vehicle)

    def receipt(self, digest: str) -> ChunkRecord:
        """Return the receipt of a recording by its digest, or the begin of it that no other recording has."""
        begins = func.substr(CHUNKS.c.digest, 1, len(digest)) == digest
        records = self._read(select(CHUNKS).where(begins).limit(2))
        if len(records) > 1:
            reason = f"several recordings have a digest that begins {digest!r}"
            raise ConflictError(reason, kind="recording", key=digest)
        return present(next(iter(records), None), "recording", digest)

    def page(
        self, chosen: ChosenChunks, limit: int, before: tuple[int, str] | None = None
    ) -> builtins.list[ChunkRecord]:
        """Return receipts, the newest first, behind (time of receipt, digest) of ``before``."""
        place = (CHUNKS.c.received_ns, CHUNKS.c.digest)
        behind = given(before, lambda key: tuple_(*place) < tuple_(*key))
        statement = select(CHUNKS).where(*chosen.conditions(), *behind)
        return self._read(statement.order_by(*(column.desc() for column in place)).limit(limit))

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
        return [*self._read(oldest), *self._read(newest)]

    def of_known_vehicles(self) -> Sequence[ChunkRecord]:
        """Return the receipts of recordings that waited for their vehicle and whose vehicle there is, oldest first."""
        return self._stored(ReasonCode.VEHICLE_UNKNOWN, exists().where(VEHICLES.c.code == CHUNKS.c.vehicle))

    def _stored(self, code: ReasonCode, condition: ColumnElement[bool]) -> Sequence[ChunkRecord]:
        waiting = (CHUNKS.c.state == ChunkState.STORED.value, CHUNKS.c.reason_code == code.value, condition)
        return self._read(select(CHUNKS).where(*waiting).order_by(CHUNKS.c.recorded_ns, CHUNKS.c.digest))

    def with_state(self, state: ChunkState, limit: int = 100) -> Sequence[ChunkRecord]:
        """Return receipts in ``state``, oldest first."""
        in_state = select(CHUNKS).where(CHUNKS.c.state == state.value)
        return self._read(in_state.order_by(CHUNKS.c.recorded_ns, CHUNKS.c.digest).limit(limit))

    def _read(
        self, statement: Select[Any] | CompoundSelect[Any], parameters: Mapping[str, Any] | None = None
    ) -> builtins.list[ChunkRecord]:
        return [value_of_row(ChunkRecord, row) for row in self.connection.execute(statement, parameters)]

    def _note(self, record: ChunkRecord) -> None:
        """Let what rests on the rejected recordings of a vehicle follow one that is among them, or was."""
        if record.state is ChunkState.REJECTED:
            self.subjects.raised(SubjectKind.VEHICLE, record.vehicle, Facet.RECORDINGS)


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


IN_SPAN = {clock: _in_span(clock) for clock in CLOCKS}


def _values(record: ChunkRecord) -> dict[str, object]:
    return columns_of(record) | {name: record.counts.get(name) for name in CLOCKS[1]}


CHANGES = table_of(RecordingChangeRow)


class RecordingChangeStore(Store):
    """The record of changes, append-only, in one transaction."""

    def add(self, change: RecordingChange) -> None:
        """Add one."""
        self.connection.execute(insert(CHANGES).values(columns_of(change)))

    def list(self, digest: str) -> Sequence[RecordingChange]:
        """Return what was done to one recording, oldest first."""
        statement = select(CHANGES).where(CHANGES.c.digest == digest).order_by(CHANGES.c.id)
        return [value_of_row(RecordingChange, row) for row in self.connection.execute(statement)]


SCRUBS = table_of(RawScrubRow)
RAW_KEPT = and_(CHUNKS.c.purged_ns.is_(None), CHUNKS.c.state != ChunkState.DELETED.value)


@dataclass(frozen=True, slots=True)
class RawFile:
    """A raw file that a receipt refers to."""

    digest: str
    suffix: str
    size_bytes: int
    vehicle: str


class RawScrubStore(Store):
    """Readings, in one transaction."""

    def last(self) -> RawScrub | None:
        """Return the newest; None before the first."""
        row = self.connection.execute(select(SCRUBS).order_by(SCRUBS.c.scrub_id.desc()).limit(1)).first()
        return None if row is None else value_of_row(RawScrub, row)

    def begin(self, now_ns: int) -> RawScrub:
        """Begin one, and return it."""
        number = int(self.connection.scalar(select(func.coalesce(func.max(SCRUBS.c.scrub_id), 0))) or 0) + 1
        begun = RawScrub(number, now_ns, None, "", 0, 0, 0)
        self.connection.execute(insert(SCRUBS).values(**asdict(begun)))
        return begun

    def put(self, scrub: RawScrub) -> None:
        """Keep how far one has come."""
        self.connection.execute(update(SCRUBS).where(SCRUBS.c.scrub_id == scrub.scrub_id).values(**asdict(scrub)))

    def files_after(self, digest: str, limit: int) -> Sequence[RawFile]:
        """Return raw files that must be there, in the order of their digests, behind one."""
        columns = (CHUNKS.c.digest, CHUNKS.c.suffix, CHUNKS.c.size_bytes, CHUNKS.c.vehicle)
        kept = select(*columns).where(RAW_KEPT, CHUNKS.c.digest > digest)
        return [RawFile(*row) for row in self.connection.execute(kept.order_by(CHUNKS.c.digest).limit(limit))]

    def count_after(self, digest: str) -> int:
        """Return how many raw files are still to be read behind a digest."""
        return int(self.connection.scalar(select(func.count()).where(RAW_KEPT, CHUNKS.c.digest > digest)) or 0)

"""What is decoded or estimated again after a bus, the class of vehicles or the radius of a wheelset has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sqlalchemy import ColumnElement, Connection, and_, delete, exists, func, select

from estimation.errors import ConflictError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import SubjectKind, after_failure
from estimation.values.windows import PassedOver
from estimation.vehicle.vehicle_class import ClassOnFile, same_motion
from fleet_db.due import positions_forgotten
from fleet_db.records import NOTHING_AGAIN, ChunkRecord, ChunkState, EstimatedAgain
from fleet_db.rows import same_window, table_of
from fleet_db.stores.chunks import ChosenChunks, ChunkStore
from fleet_db.stores.stage_marks import QuarantineStore
from fleet_db.stores.window_rows import wait_again
from fleet_db.subjects import Subjects
from fleet_db.tables.track import TrackVersionRow, WindowPositionRow
from fleet_db.tables.windows import WindowRow

WINDOWS, POSITIONS, VERSIONS = table_of(WindowRow), table_of(WindowPositionRow), table_of(TrackVersionRow)
OF_WINDOW = same_window(POSITIONS, WINDOWS)


@dataclass(frozen=True, slots=True)
class Again:
    """Puts windows back to the begin of the pipeline, in one writing transaction."""

    connection: Connection
    subjects: Subjects

    def class_changed(
        self, vehicles: Sequence[str], before: ClassOnFile | None, after: ClassOnFile | None
    ) -> EstimatedAgain:
        """Let what rests on the class of vehicles be estimated again: every window where their motion changes."""
        if before is None or after is None:
            return NOTHING_AGAIN if before is after else self.vehicles(vehicles)
        if not same_motion(before.vehicle_class, after.vehicle_class):
            return self.vehicles(vehicles)
        return NOTHING_AGAIN if before.digest == after.digest else self.geometries(vehicles)

    def vehicles(self, codes: Sequence[str]) -> EstimatedAgain:
        """Let all windows of some vehicles wait again, and the epochs in which they helped to align a section."""
        return self._windows(tuple(codes), WINDOWS.c.vehicle.in_(codes))

    def wheelset(self, serial: str) -> EstimatedAgain:
        """Let all windows of a wheelset wait again, and the epochs in which it helped to align a section."""
        return self._windows((f"wheelset {serial}",), WINDOWS.c.wheelset == serial)

    def mounting(self, serial: str, from_ns: int, to_ns: int | None, *, there: bool) -> None:
        """Let the windows of a wheelset that overlap some time wait again; ``there``: it is where it was, as it was."""
        within = and_(WINDOWS.c.wheelset == serial, WINDOWS.c.start_ns + WINDOWS.c.length_ns > from_ns)
        ended = within if to_ns is None else and_(within, WINDOWS.c.start_ns < to_ns)
        self._wait(ended, PassedOver.SUPERSEDED if there else PassedOver.RECORD_CHANGED)

    def _windows(self, names: tuple[str, ...], chosen: ColumnElement[bool]) -> EstimatedAgain:
        windows, from_ns = self.connection.execute(
            select(func.count(), func.min(WINDOWS.c.start_ns)).where(chosen)
        ).one()
        sections = tuple(self._aligned_by(chosen))
        self._wait(chosen, PassedOver.CLASS_CHANGED)
        return EstimatedAgain(names, int(windows), from_ns, sections)

    def geometries(self, codes: Sequence[str]) -> EstimatedAgain:
        """Return that only the geometries of the wheelsets of some vehicles are estimated again."""
        of_vehicles = WINDOWS.c.vehicle.in_(codes)
        from_ns = self.connection.scalar(select(func.min(WINDOWS.c.start_ns)).where(of_vehicles))
        return EstimatedAgain(tuple(codes), 0, from_ns, ())

    def _aligned_by(self, chosen: ColumnElement[bool]) -> list[str]:
        """Return the sections with a version of the fleet's own that windows may have contributed to."""
        of_fleet = exists().where(VERSIONS.c.section == WINDOWS.c.track_section)
        placed = exists().where(OF_WINDOW, POSITIONS.c.reason_code.is_distinct_from(ReasonCode.CLASS_UNKNOWN.value))
        statement = select(WINDOWS.c.track_section).where(chosen, of_fleet, placed).distinct()
        return sorted(self.connection.scalars(statement))

    def _wait(self, chosen: ColumnElement[bool], what: PassedOver) -> None:
        """Let windows wait again, and forget where they were; those without samples stay as they are."""
        with_samples = WINDOWS.c.samples_purged_ns.is_(None)
        positions_forgotten(self.subjects, and_(chosen, with_samples))
        self.connection.execute(delete(POSITIONS).where(exists().where(OF_WINDOW, chosen, with_samples)))
        wait_again(self.subjects, chosen, what)


STAGE = "ingest"
MOST = 1_000_000
UNDECODED = (
    (ChunkState.REJECTED, ReasonCode.LOG_DAMAGED),
    (ChunkState.REJECTED, ReasonCode.CLOCK_IMPLAUSIBLE),
    (ChunkState.STORED, ReasonCode.WAITS_FOR_TIME),
)
"""What becomes of a recording that is read with a wrong bus."""


def decode_again(chunks: ChunkStore, record: ChunkRecord, why: str, now_ns: int) -> None:
    """Let a recording be decoded at the next run of the job or ingest."""
    error = ConflictError(why, kind="recording", key=record.digest)
    item = after_failure(None, (SubjectKind.RECORDING, record.digest, STAGE), record.vehicle, error, now_ns)
    QuarantineStore(chunks.connection).put(item)
    reason = Reason(item.code, item.error)
    chunks.update(replace(record, state=ChunkState.STORED, reason=reason, first_ns=None, last_ns=None))


def decode_undecoded(chunks: ChunkStore, vehicle: str, why: str, now_ns: int) -> None:
    """Let the recordings of a vehicle be decoded again that were rejected, or wait for a time."""
    for state, code in UNDECODED:
        for record in chunks.page(ChosenChunks(state=state, vehicle=vehicle, code=code), MOST):
            if record.purged_ns is None:
                decode_again(chunks, record, why, now_ns)

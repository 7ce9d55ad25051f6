"""A wheelset-year for measurements: windows of a simulated recording, put again over a year."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from sqlalchemy import update

from bench.put_values import put_table
from bench.standing_clock import StandingClock
from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.values.geometry import BinTable
from estimation.values.runs import JobTrigger
from estimation.values.track import EpochMember, FoldState, TrackEpoch
from estimation.values.units import DAY_NS
from estimation.values.windows import Window, WindowPosition, WindowRecord, WindowState
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.tables.recordings import ChunkRow

WINDOWS_A_DAY = 4
DAYS_A_RUN = 5  # of the jobs
KM_A_DAY, HOURS_A_DAY = 960.0, 16.0
SERIAL = "WS-1011"


@dataclass(frozen=True, slots=True)
class Original:
    """A window of the recording, with its table and track version."""

    window: Window
    table: BinTable
    version: int | None


@dataclass(slots=True)
class WheelsetYear:
    """Windows of a recording put over days, with what the jobs store of them."""

    context: JobContext
    storage: SqlStorage
    originals: Sequence[Original]
    newest: WindowRecord = field(init=False)

    def __post_init__(self) -> None:
        with self.storage.read() as unit:
            newest = unit.windows.latest(SERIAL)
        assert newest is not None
        self.newest = newest

    def put(self, first: int, last: int) -> int:
        """Put the windows of some days and run the jobs; return our time at the end, ns UTC."""
        at_ns = 0
        for day in range(first, last + 1):
            at_ns = self._put_day(day)
            if day % DAYS_A_RUN == 0 or day == last:
                at = replace(self.context, clock=StandingClock(at_ns))
                for name in ("refresh_geometry", "refresh_trends"):
                    run_job(job_named(name), at, JobTrigger.CLI)
        with self.storage.write() as unit:  # the age of windows is counted from the newest recording
            unit.connection.execute(update(table_of(ChunkRow)).values(last_ns=at_ns))
        return at_ns + DAY_NS // 2

    def _put_day(self, day: int) -> int:
        """Put the windows of a day, placed and of an epoch; return the start of the last."""
        section = self.newest.track_section
        assert section is not None
        with self.storage.write() as unit:
            members = [self.put_window(unit, day, number) for number in range(WINDOWS_A_DAY)]
            last_ns = members[-1].record.start_ns
            version = self.originals[0].version
            epoch = TrackEpoch(
                section, len(unit.epochs.list(section)) + 1, "b" * 64, "d" * 64, last_ns, len(members), waits=False,
                after=FoldState(version, version), estimated_on=version, report=0, recorded_ns=last_ns,
            )  # fmt: skip
            unit.epochs.put(epoch, members)
        return last_ns

    def put_window(self, unit: SqlUnitOfWork, day: int, number: int) -> EpochMember:
        """Put a window of a day with its table and place."""
        one = self.originals[(day + number) % len(self.originals)]
        part = number / WINDOWS_A_DAY
        start_ns = self.newest.start_ns + day * DAY_NS + round(part * HOURS_A_DAY * 3600) * 1_000_000_000
        unit.windows.put(
            replace(one.window, start_ns=start_ns), self.newest.mileage_km + (day + part) * KM_A_DAY, start_ns
        )
        record = unit.windows.get(SERIAL, start_ns)
        assert record is not None
        put_table(unit, SERIAL, start_ns, one.table, one.version, record.content_digest)
        unit.windows.mark(SERIAL, start_ns, WindowState.ESTIMATED)
        unit.tracks.put_positions([WindowPosition(SERIAL, start_ns, record.content_digest, one.version)])
        return EpochMember(record, "c" * 64, "a" * 64)

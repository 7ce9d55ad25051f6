"""Windows as a set that is made from recordings and registry: which there are, which go, and which are stale."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import groupby

from sqlalchemy import Connection, and_, case, delete, exists, func, insert, or_, select, union_all, update

from estimation.errors import DamagedError
from estimation.values.windows import SUSTAINED, DueStage, PassedOver, Window, WindowKey, WindowRecord
from fleet_db.due import OF_SAMPLES, raise_sections, windows_changed, windows_left
from fleet_db.records import ChunkState
from fleet_db.rows import equal, insert_all_new, replace_all, same_window, table_of, value_of_row, window_key
from fleet_db.stores.window_rows import list_for_sums, pass_over, to_window_record, window_values
from fleet_db.subjects import Store, Subjects
from fleet_db.tables.recordings import ChunkRow, StaleSpanRow
from fleet_db.tables.track import WindowPositionRow
from fleet_db.tables.windows import WindowBinTableRow, WindowRow
from fleet_db.telemetry import WindowFiles

WINDOWS, TABLES, POSITIONS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(WindowPositionRow)
CHUNKS = table_of(ChunkRow)
HAS_TABLE = exists().where(same_window(TABLES, WINDOWS))


@dataclass(frozen=True, slots=True)
class AssembledWindow:
    """A window as it was assembled, to be stored."""

    window: Window  # with its samples
    digest: str  # of its content
    mileage_km: float  # of the wheelset since new, at its start
    odometer_excess_m: float = 0.0  # by which odometer and speed differ beyond what they may
    off_line_m: float = 0.0  # from the line of its section, by GNSS; 0 within the limit


@dataclass(frozen=True, slots=True)
class StoredWindow:
    """A stored window with what only its storage needs; distances as in :class:`AssembledWindow`."""

    record: WindowRecord
    sample_bytes: int  # size of its file
    samples_purged: bool
    untouched: bool  # whether there is no bin table of it, nor was one
    odometer_excess_m: float
    off_line_m: float


@dataclass(frozen=True, slots=True)
class AssembledWindowStore:
    """The stored windows of a vehicle over a span of its clock, in one transaction."""

    connection: Connection
    subjects: Subjects
    files: WindowFiles

    def of_vehicle(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[WindowRecord]:
        """Return the windows of a vehicle that start in ``[from_ns, to_ns)``, by start and wheelset."""
        statement = (
            select(WINDOWS)
            .where(WINDOWS.c.vehicle == vehicle, WINDOWS.c.start_ns >= from_ns, WINDOWS.c.start_ns < to_ns)
            .order_by(WINDOWS.c.start_ns, WINDOWS.c.wheelset)
        )
        return [to_window_record(row) for row in self.connection.execute(statement)]

    def in_span(self, vehicle: str, wheelsets: Collection[str], from_ns: int, to_ns: int) -> Sequence[StoredWindow]:
        """Return the windows that start in ``[from_ns, to_ns)`` of a vehicle, and of wheelsets wherever they ran."""
        within = (WINDOWS.c.start_ns >= from_ns, WINDOWS.c.start_ns < to_ns)
        in_time = select(WINDOWS, HAS_TABLE.label("has_table")).where(*within)
        elsewhere = in_time.where(WINDOWS.c.wheelset.in_(sorted(wheelsets)), WINDOWS.c.vehicle != vehicle)
        both = union_all(in_time.where(WINDOWS.c.vehicle == vehicle), elsewhere)  # each by an index of its own
        return [
            StoredWindow(
                to_window_record(row),
                row.sample_bytes,
                row.samples_purged_ns is not None,
                not row.has_table and row.table_purged_ns is None,
                row.odometer_excess_m,
                row.off_line_m,
            )
            for row in self.connection.execute(both)
        ]

    def add(self, windows: Sequence[AssembledWindow], recorded_ns: int) -> bool:
        """Store windows that are not there yet; False: another transaction has stored one meanwhile, which stays."""
        rows = [self._row(assembled, recorded_ns) for assembled in windows]
        count = insert_all_new(self.connection, WINDOWS, rows)
        self._changed(windows)
        return count == len(rows)

    def replace(self, windows: Sequence[AssembledWindow], recorded_ns: int) -> None:
        """Replace windows without bin tables by what they are now; they wait to be estimated."""
        not_purged = {"samples_purged_ns": None, "passed_over": None}
        rows = [self._row(assembled, recorded_ns) | not_purged for assembled in windows]
        if rows:
            keys = [(assembled.window.wheelset, assembled.window.start_ns) for assembled in windows]
            self._touch(keys)
            replace_all(self.connection, WINDOWS, rows)
            self._changed(windows)
            windows_left(self.subjects, keys)

    def _changed(self, windows: Sequence[AssembledWindow]) -> None:
        """List windows that have these samples now; those on no section are no concern of an alignment."""
        stored = [assembled.window for assembled in windows]
        sections = {(window.wheelset, window.start_ns): window.track_section for window in stored}
        windows_changed(self.connection, [key for key, section in sections.items() if section is None])
        on_section = [key for key, section in sections.items() if section is not None]
        windows_changed(self.connection, on_section, (*OF_SAMPLES, DueStage.ALIGNMENT))
        raise_sections(self.subjects, sections.values())

    def _touch(self, keys: Sequence[WindowKey]) -> None:
        """Let jobs look again at the sections that windows are on as they are stored, and at who hunts in them."""
        same = window_key(WINDOWS).in_(keys)
        hunts = WINDOWS.c.hunting_share >= SUSTAINED.hunting_share
        stored = select(WINDOWS.c.wheelset, WINDOWS.c.track_section, case((hunts, WINDOWS.c.vehicle)))
        for wheelset, section, hunting_in in self.connection.execute(stored.where(same).distinct()):
            self.subjects.places(section)
            self.subjects.windows(wheelset, hunting_in)

    def _row(self, assembled: AssembledWindow, recorded_ns: int) -> dict[str, object]:
        window = assembled.window
        self.subjects.windows(window.wheelset, window.vehicle if window.quality.hunting.sustained else None)
        self.subjects.places(window.track_section)
        return window_values(window, assembled.mileage_km) | {
            "content_digest": assembled.digest,
            "sample_bytes": self.files.save(window, assembled.digest),
            "recorded_ns": recorded_ns,
            "odometer_excess_m": assembled.odometer_excess_m,
            "off_line_m": assembled.off_line_m,
        }

    def is_as_stored(self, stored: StoredWindow, now: AssembledWindow) -> bool:
        """Return whether a window is stored just as it was assembled now, with its file unless that was purged."""
        record = stored.record
        return (
            (record.vehicle, record.axle, record.mileage_km) == (now.window.vehicle, now.window.axle, now.mileage_km)
            and (stored.odometer_excess_m, stored.off_line_m) == (now.odometer_excess_m, now.off_line_m)
            and record.content_digest == now.digest
            and (stored.samples_purged or self.files.has(record.content_digest, stored.sample_bytes))
        )

    def first_start(self, vehicle: str, from_ns: int, to_ns: int) -> int | None:
        """Return the start of the first window of a vehicle in ``[from_ns, to_ns)``; None where there is none."""
        within = (WINDOWS.c.vehicle == vehicle, WINDOWS.c.start_ns >= from_ns, WINDOWS.c.start_ns < to_ns)
        first: int | None = self.connection.scalar(select(func.min(WINDOWS.c.start_ns)).where(*within))
        return first

    def extents(self, vehicle: str, from_ns: int, to_ns: int, limit: int) -> Sequence[tuple[int, int, int]]:
        """Return ``(first, last, frames)`` of at most ``limit`` decoded recordings in a span, by their first frame."""
        statement = (
            select(CHUNKS.c.first_ns, CHUNKS.c.last_ns, CHUNKS.c.frames)
            .where(CHUNKS.c.vehicle == vehicle, CHUNKS.c.first_ns < to_ns, CHUNKS.c.last_ns >= from_ns)
            .where(CHUNKS.c.state == ChunkState.DECODED.value)
            .order_by(CHUNKS.c.first_ns, CHUNKS.c.digest)
            .limit(limit)
        )
        return [(row.first_ns, row.last_ns, row.frames) for row in self.connection.execute(statement)]

    def remove(self, records: Sequence[WindowRecord]) -> Sequence[WindowRecord]:
        """Remove windows with their bin tables and positions; return those. Files are no concern of a transaction.

        One whose bin table has been purged stays, for it cannot be taken from its roll-up.
        """
        removed = [record for record in records if not self._stays(record)]
        list_for_sums(self.connection, [record.key for record in removed])
        for record in removed:
            for table in (TABLES, POSITIONS, WINDOWS):
                same = (table.c.wheelset == record.wheelset, table.c.start_ns == record.start_ns)
                self.connection.execute(delete(table).where(*same))
            self.subjects.tables(record.wheelset)
            self.subjects.windows(record.wheelset, record.vehicle if record.quality.hunting.sustained else None)
            self.subjects.places(record.track_section)
        windows_left(self.subjects, [record.key for record in removed])
        return removed

    def _stays(self, record: WindowRecord) -> bool:
        key = and_(WINDOWS.c.wheelset == record.wheelset, WINDOWS.c.start_ns == record.start_ns)
        purged = self.connection.scalar(select(WINDOWS.c.table_purged_ns).where(key)) is not None
        if purged and pass_over(self.connection, key, PassedOver.RECORD_CHANGED):
            self.subjects.tables(record.wheelset)
        return purged

    def intact(self, record: WindowRecord, *, verify: bool) -> bool:
        """Return whether the file of a window is there, whole if ``verify``, or purged; a damaged one is removed."""
        key = and_(WINDOWS.c.wheelset == record.wheelset, WINDOWS.c.start_ns == record.start_ns)
        row = self.connection.execute(select(WINDOWS.c.sample_bytes, WINDOWS.c.samples_purged_ns).where(key)).first()
        if row is not None and row.samples_purged_ns is not None:
            return True
        if not self.files.has(record.content_digest, 0 if row is None else row.sample_bytes):
            return False
        if verify:
            try:
                self.files.load(record.content_digest)
            except DamagedError:
                self.files.path(record.content_digest).unlink(missing_ok=True)
                return False
        return True


SPANS = table_of(StaleSpanRow)

EARLIEST_NS, LATEST_NS = -(1 << 62), 1 << 62
"""Ends of a span that is open."""


@dataclass(frozen=True, slots=True)
class StaleSpan:
    """Windows of a vehicle that overlap ``[from_ns, to_ns)`` are to be assembled again, and why."""

    id: int
    vehicle: str
    from_ns: int
    to_ns: int
    cause: str


class StaleSpanStore(Store):
    """Stale spans, in one transaction."""

    def add(self, vehicle: str, from_ns: int | None, to_ns: int | None, cause: str) -> None:
        """Let the windows of a vehicle in ``[from_ns, to_ns)`` be assembled again; None is an open end.

        Called in the transaction that changes what they are made from; the vehicle need not be registered.
        """
        begin = EARLIEST_NS if from_ns is None else from_ns
        end = LATEST_NS if to_ns is None else to_ns
        if end > begin:
            self.connection.execute(insert(SPANS).values(vehicle=vehicle, from_ns=begin, to_ns=end, cause=cause))

    def all(self, vehicle: str | None = None) -> Sequence[StaleSpan]:
        """Return the stale spans, of one vehicle or of all, by vehicle and begin."""
        statement = select(SPANS).where(*equal(SPANS, vehicle=vehicle))
        rows = self.connection.execute(statement.order_by(SPANS.c.vehicle, SPANS.c.from_ns, SPANS.c.id))
        return [value_of_row(StaleSpan, row) for row in rows]

    def advance(self, spans: Sequence[StaleSpan], to_ns: int) -> None:
        """Remove the part of spans before ``to_ns``, in the transaction that stores the windows of that part."""
        for span in spans:
            same = SPANS.c.id == span.id
            if span.to_ns <= to_ns:
                self.connection.execute(delete(SPANS).where(same))
            elif span.from_ns < to_ns:
                self.connection.execute(update(SPANS).where(same).values(from_ns=to_ns))

    def remove(self, spans: Sequence[StaleSpan]) -> None:
        """Remove spans whose windows have been assembled again, in the transaction that stores those."""
        self.connection.execute(delete(SPANS).where(SPANS.c.id.in_([span.id for span in spans])))


APART_NS = 86_400_000_000_000
"""Windows that are nearer to each other are made again together, with what is between them."""


def make_stale(connection: Connection, section: str, cause: str, *, elsewhere: bool) -> None:
    """Let the windows on a section be assembled again, and ``elsewhere`` those on none, which may have its new number.

    A window on another registered section stays: its vehicle sent the number of that one.
    """
    on_it = WINDOWS.c.track_section == section
    touched = or_(on_it, WINDOWS.c.track_section.is_(None)) if elsewhere else on_it
    statement = select(WINDOWS.c.vehicle, WINDOWS.c.start_ns, WINDOWS.c.length_ns).where(touched).distinct()
    rows = connection.execute(statement.order_by(WINDOWS.c.vehicle, WINDOWS.c.start_ns)).all()
    stale = StaleSpanStore(connection)
    for vehicle, windows in groupby(rows, key=lambda row: row.vehicle):
        spans: list[list[int]] = []
        for window in windows:
            end_ns = window.start_ns + window.length_ns
            if spans and window.start_ns - spans[-1][1] <= APART_NS:
                spans[-1][1] = max(spans[-1][1], end_ns)
            else:
                spans.append([window.start_ns, end_ns])
        for from_ns, to_ns in spans:
            stale.add(vehicle, from_ns, to_ns, cause)

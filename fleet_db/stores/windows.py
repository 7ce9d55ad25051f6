"""Windows and their state; their samples are in files."""

from __future__ import annotations

import builtins
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    and_,
    bindparam,
    delete,
    exists,
    func,
    or_,
    select,
)

from estimation.errors import PurgedError
from estimation.values.alerts import MileageNow
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import SIGNATURES
from estimation.values.windows import (
    SUSTAINED,
    DueStage,
    PassedOver,
    Window,
    WindowKey,
    WindowMark,
    WindowRecord,
    WindowState,
)
from fleet_db.due import list_due, list_for_alignment, positions_forgotten, windows_changed, windows_left
from fleet_db.rows import (
    batches,
    given,
    grouped,
    insert_new,
    key_given,
    key_of,
    keys_given,
    on_sections,
    present,
    replace,
    table_of,
    window_key,
)
from fleet_db.stores.window_rows import (
    NOTED_OF,
    list_for_sums,
    mark_all,
    noted_columns,
    noted_in,
    pass_over,
    remove_tables,
    to_window_record,
    wait_again,
    window_values,
)
from fleet_db.subjects import ReadOnce, Subjects
from fleet_db.tables.registry import MountingRow, WheelsetRow
from fleet_db.tables.track import WindowPositionRow
from fleet_db.tables.windows import WindowBinTableRow, WindowRow
from fleet_db.telemetry import WindowFiles, window_digest

WINDOWS, TABLES, WHEELSETS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(WheelsetRow)
POSITIONS, MOUNTINGS = table_of(WindowPositionRow), table_of(MountingRow)
PURGED = ("samples_purged_ns", "table_purged_ns")
NOT_PASSED_OVER = or_(WINDOWS.c.samples_purged_ns.is_(None), WINDOWS.c.passed_over.is_(None))
SAME = and_(WINDOWS.c.wheelset == WHEELSETS.c.serial, WINDOWS.c.start_ns == bindparam("start_ns"))
OF_STORED = ("content_digest", "sample_bytes", "mileage_km", "track_section", "hunting_share", *PURGED)
STORED = (
    select(*(WINDOWS.c[name] for name in OF_STORED))
    .select_from(WHEELSETS.outerjoin(WINDOWS, SAME))
    .where(WHEELSETS.c.serial == bindparam("wheelset"))
)
DIGEST = select(*(WINDOWS.c[name] for name in ("content_digest", "samples_purged_ns"))).where(key_given(WINDOWS))


@dataclass(frozen=True, slots=True)
class WindowStore:
    """Windows of samples and their state."""

    connection: Connection
    subjects: Subjects
    files: WindowFiles
    once: ReadOnce = field(default_factory=ReadOnce)

    def put(self, window: Window, mileage_km: float, recorded_ns: int) -> bool:
        """Store a window as pending; return whether anything changed.

        The same content again changes nothing, except that a lost sample file is made again, and a window that was
        refused without it waits again. Other content replaces the window,
        which is pending again, and removes its bin table. Another mileage alone keeps state and bin table. A window
        whose bin table has been purged stays as it is.

        Raises:
            NotFoundError: The wheelset is unknown.
        """
        digest = window_digest(window)
        key = (window.wheelset, window.start_ns)
        row = self.connection.execute(STORED, {"wheelset": window.wheelset, "start_ns": window.start_ns}).first()
        stored = present(row, "wheelset", window.wheelset)
        if stored.content_digest == digest:
            if stored.samples_purged_ns is None and not self.files.has(digest, stored.sample_bytes):
                self.files.save(window, digest)
                self.healed([key])
            return self._set_mileage(window, stored, mileage_km)
        if stored.table_purged_ns is not None:
            self.pass_over(window.wheelset, window.start_ns, PassedOver.SUPERSEDED)
            return False
        values = window_values(window, mileage_km) | {
            "content_digest": digest,
            "sample_bytes": self.files.save(window, digest),
            "recorded_ns": recorded_ns,
            "samples_purged_ns": None,
            "passed_over": None,
        }
        hunts = max(window.quality.hunting.share, stored.hunting_share or 0.0) >= SUSTAINED.hunting_share
        self.subjects.windows(window.wheelset, window.vehicle if hunts else None)
        self.subjects.places(window.track_section)
        if stored.content_digest is None:
            if not insert_new(self.connection, WINDOWS, values):  # another transaction has stored it meanwhile
                return self.put(window, mileage_km, recorded_ns)
            windows_changed(self.connection, [key])
            list_for_alignment(self.subjects, {key: window.track_section})
            return True
        replace(self.connection, WINDOWS, values)
        windows_changed(self.connection, [key])
        list_for_alignment(self.subjects, {key: window.track_section})
        if window.track_section != stored.track_section:
            windows_left(self.subjects, [key])
        self.subjects.places(stored.track_section)
        remove_tables(self.connection, self.subjects, [key])
        return True

    def several(self, keys: Sequence[WindowKey], *, held: bool = False) -> Sequence[WindowRecord]:
        """Return the records of some windows, by wheelset and start; those that are not there are left out.

        Args:
            held: Whether nobody else may change them until this transaction, which writes, has ended.
        """
        records: builtins.list[WindowRecord] = []
        for some in batches(sorted(set(keys))):
            records += map(to_window_record, self.connection.execute(_several(held), {"keys": some}))
        return records

    def get(self, wheelset: str, start_ns: int) -> WindowRecord | None:
        """Return one window's record."""
        return next(iter(self.several([(wheelset, start_ns)])), None)

    def any_decided(self, section: str) -> bool:
        """Return whether a window on a section has been estimated or refused; the empty text stands for none."""
        decided = (on_sections(WINDOWS.c.track_section, [section]), WINDOWS.c.state != WindowState.PENDING.value)
        return bool(self.connection.scalar(select(exists().where(*decided))))

    def refused_on(self, section: str, codes: Sequence[ReasonCode]) -> Sequence[WindowRecord]:
        """Return the windows on a section that were refused for some reasons and can be looked at again.

        Args:
            section: Its code; the empty text stands for windows on none.
        """
        refused = WINDOWS.c.reason_code.in_([code.value for code in codes])
        on_it = on_sections(WINDOWS.c.track_section, [section])
        statement = select(WINDOWS).where(WINDOWS.c.state == WindowState.REFUSED.value, refused, on_it, NOT_PASSED_OVER)
        return self._records(statement.order_by(*WINDOWS.primary_key))

    def look_again(self, keys: Sequence[WindowKey]) -> Sequence[WindowKey]:
        """Let windows wait again, their positions too; return those that do."""
        waiting = [mark.key for mark in self.mark_all([WindowMark(*key, WindowState.PENDING) for key in keys])]
        self._forget_positions(waiting)
        return waiting

    def healed(self, keys: Sequence[WindowKey]) -> None:
        """Let windows whose file had been lost or damaged wait again, unless they are estimated already.

        Where they were is looked for again, if that was done without their samples.
        """
        estimated = [record.key for record in self.several(keys) if record.state is WindowState.ESTIMATED]
        self._forget_positions(estimated, POSITIONS.c.reason_code == ReasonCode.FILE_DAMAGED.value)
        self.look_again([key for key in keys if key not in estimated])
        windows_changed(self.connection, keys, (SIGNATURES, DueStage.TABLES))

    def estimate_again(self, section: str) -> None:
        """Let every window on a section wait to be estimated again."""
        wait_again(self.subjects, WINDOWS.c.track_section == section, PassedOver.SUPERSEDED)

    def load(self, wheelset: str, start_ns: int) -> Window:
        """Return a window with its samples.

        Raises:
            NotFoundError: There is no such window.
            PurgedError: Its samples have been purged.
            DamagedError: Its file is missing or damaged; names the file.
        """
        stored = self.connection.execute(DIGEST, {"key_wheelset": wheelset, "key_start_ns": start_ns}).first()
        row = present(stored, "window", f"{wheelset}@{start_ns}")
        if row.samples_purged_ns is not None:
            raise _purged(wheelset, start_ns)
        return self.files.load(row.content_digest)

    def samples(self, record: WindowRecord) -> Window:
        """Return the window of a record that this transaction has read; raises as :meth:`load`."""
        if record.samples_purged:
            raise _purged(record.wheelset, record.start_ns)
        return self.files.load(record.content_digest)

    def mark(self, wheelset: str, start_ns: int, state: WindowState, reason: Reason | None = None) -> bool:
        """Set the state of a window; one that is refused loses its bin table. Return whether it has that state now.

        A window whose samples have been purged stays as it is; that it was to change is noted.

        Raises:
            NotFoundError: There is no such window.
        """
        return bool(self.mark_all([WindowMark(wheelset, start_ns, state, reason)]))

    def mark_all(
        self,
        marks: Sequence[WindowMark],
        standing: Mapping[WindowKey, WindowRecord] | None = None,
        tabled: Sequence[WindowKey] = (),
    ) -> Sequence[WindowMark]:
        """Set the states of several windows as :meth:`mark` does; return those that have their states now.

        Args:
            standing: The windows, where this transaction holds them.
            tabled: Those that have another bin table and are to be listed to be summed.
        """
        if standing is None:
            standing = {record.key: record for record in self.several([mark.key for mark in marks])}
        return mark_all(self.connection, self.subjects, marks, standing, tabled)

    def pass_over(self, wheelset: str, start_ns: int, what: PassedOver) -> None:
        """Note what would have changed a window that stays as it is; that its table is wrong stands before the rest."""
        if pass_over(self.connection, and_(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns == start_ns), what):
            self.subjects.tables(wheelset)

    def passed_over(self, wheelset: str) -> Sequence[tuple[int, PassedOver]]:
        """Return start and cause of the estimated windows of a wheelset that stay as they are, oldest first."""
        if "passed_over" not in self.noted(wheelset):
            return ()

        def read(some: Collection[str]) -> Mapping[str, Sequence[tuple[int, PassedOver]]]:
            statement = select(WINDOWS.c.wheelset, WINDOWS.c.start_ns, WINDOWS.c.passed_over).where(
                WINDOWS.c.wheelset.in_(some),
                WINDOWS.c.passed_over.is_not(None),
                WINDOWS.c.state == WindowState.ESTIMATED.value,
            )
            rows = self.connection.execute(statement.order_by(WINDOWS.c.start_ns))
            return grouped(rows, lambda row: (row.start_ns, PassedOver(row.passed_over)))

        return self.once.of_wheelset("passed_over", wheelset, read) or ()

    def noted(self, wheelset: str) -> frozenset[str]:
        """Return which columns of ``NOTED`` are not null of a window of a wheelset: of most wheelsets none is."""

        def read(some: Collection[str]) -> Mapping[str, frozenset[str]]:
            noted = select(WHEELSETS.c.serial, *noted_columns()).where(WHEELSETS.c.serial.in_(some))
            return {row.serial: noted_in(row) for row in self.connection.execute(noted)}

        return self.once.of_wheelset(NOTED_OF, wheelset, read) or frozenset()

    def list(self, wheelset: str, from_ns: int | None = None, to_ns: int | None = None) -> Sequence[WindowRecord]:
        """Return windows of a wheelset that start in ``[from_ns, to_ns)``, oldest first."""
        within = [*given(from_ns, WINDOWS.c.start_ns.__ge__), *given(to_ns, WINDOWS.c.start_ns.__lt__)]
        return self._records(self._of(wheelset).where(*within))

    def refused(self, wheelset: str, codes: Sequence[ReasonCode]) -> Sequence[WindowRecord]:
        """Return the windows of a wheelset that were refused for some reasons, oldest first."""
        if "reason_code" not in self.noted(wheelset):
            return ()

        def read(some: Collection[str]) -> Mapping[str, Sequence[WindowRecord]]:
            statement = select(WINDOWS).where(
                WINDOWS.c.wheelset.in_(some),
                WINDOWS.c.state == WindowState.REFUSED.value,
                WINDOWS.c.reason_code.in_([code.value for code in codes]),
            )
            return grouped(self._records(statement.order_by(WINDOWS.c.start_ns)))

        return self.once.of_wheelset(f"refused {codes}", wheelset, read) or ()

    def latest(self, wheelset: str) -> WindowRecord | None:
        """Return the window of a wheelset that starts last."""
        of_wheelset = select(WINDOWS).where(WINDOWS.c.wheelset == wheelset)
        return next(iter(self._records(of_wheelset.order_by(WINDOWS.c.start_ns.desc()).limit(1))), None)

    def hunted(self, vehicle: str, from_ns: int) -> frozenset[int]:
        """Return the starts, from ``from_ns`` on, of windows in which a wheelset of a vehicle hunts."""
        statement = select(WINDOWS.c.start_ns).where(
            WINDOWS.c.vehicle == vehicle,
            WINDOWS.c.start_ns >= from_ns,
            WINDOWS.c.hunting_share >= SUSTAINED.hunting_share,
        )
        return frozenset(self.connection.scalars(statement))

    def in_service(self, wheelsets: Collection[str], count: int) -> Mapping[str, Sequence[WindowRecord]]:
        """Return by serial the newest windows of wheelsets since they were mounted where they are, oldest first.

        Args:
            count: At most so many of each.
        """
        return grouped(self._records(_in_service(wheelsets, count)))

    def mileage_then(self, wheelset: str, as_of_ns: int) -> MileageNow | None:
        """Return the newest mileage of the windows recorded until a time that is believed; None where none is."""
        believed = (WINDOWS.c.recorded_ns <= as_of_ns, WINDOWS.c.implausible_code.is_(None))
        statement = select(WINDOWS.c.mileage_km, WINDOWS.c.start_ns).where(WINDOWS.c.wheelset == wheelset, *believed)
        row = self.connection.execute(statement.order_by(WINDOWS.c.start_ns.desc()).limit(1)).first()
        return None if row is None else MileageNow(*row)

    def page(self, wheelset: str, after_start_ns: int | None, limit: int) -> Sequence[WindowRecord]:
        """Return at most ``limit`` windows of a wheelset that start after ``after_start_ns``, oldest first."""
        behind = given(after_start_ns, WINDOWS.c.start_ns.__gt__)
        return self._records(self._of(wheelset).where(*behind).limit(limit))

    def counts(self) -> Mapping[str, int]:
        """Return how many windows are in each state."""
        statement = select(WINDOWS.c.state, func.count()).group_by(WINDOWS.c.state)
        counted = {row[0]: int(row[1]) for row in self.connection.execute(statement)}
        return {state.value: counted.get(state.value, 0) for state in WindowState}

    def _forget_positions(self, keys: Sequence[WindowKey], *chosen: ColumnElement[bool]) -> None:
        """Let it be found again where windows were: their sections are looked at."""
        for some in batches(keys):
            on = select(WINDOWS.c.track_section).where(keys_given(WINDOWS)).distinct()
            for section in self.connection.scalars(on, {"keys": some}):
                self.subjects.places(section)
            positions_forgotten(self.subjects, and_(window_key(WINDOWS).in_(some), *chosen))
            self.connection.execute(delete(POSITIONS).where(keys_given(POSITIONS), *chosen), {"keys": some})

    def _set_mileage(self, window: Window, stored: Row[Any], mileage_km: float) -> bool:
        if stored.mileage_km == mileage_km:
            return False
        if stored.table_purged_ns is not None:
            self.pass_over(window.wheelset, window.start_ns, PassedOver.RECORD_CHANGED)
            return False
        values = {"wheelset": window.wheelset, "start_ns": window.start_ns, "mileage_km": mileage_km}
        replace(self.connection, WINDOWS, values)
        list_due(self.connection, DueStage.MILEAGES, key_given(WINDOWS), **key_of(WINDOWS, values))
        list_for_sums(self.connection, [(window.wheelset, window.start_ns)])
        list_for_alignment(self.subjects, {(window.wheelset, window.start_ns): stored.track_section})
        self.subjects.tables(window.wheelset)
        self.subjects.windows(window.wheelset)
        self.subjects.places(stored.track_section)
        return True

    def _of(self, wheelset: str) -> Select[Any]:
        return select(WINDOWS).where(WINDOWS.c.wheelset == wheelset).order_by(WINDOWS.c.start_ns)

    def _records(self, statement: Select[Any]) -> builtins.list[WindowRecord]:
        return [to_window_record(row) for row in self.connection.execute(statement)]


def _purged(wheelset: str, start_ns: int) -> PurgedError:
    return PurgedError(f"the samples of window {wheelset}@{start_ns} have been purged")


def _in_service(wheelsets: Collection[str], count: int) -> Select[Any]:
    """Return the statement for the newest windows of mountings that last: of each by one range of the index."""
    newest = WINDOWS.alias("newest")
    since_mounted = (newest.c.wheelset == MOUNTINGS.c.wheelset, newest.c.start_ns >= MOUNTINGS.c.from_ns)
    last = select(newest.c.start_ns).where(*since_mounted).order_by(newest.c.start_ns.desc()).limit(1).offset(count - 1)
    from_ns = func.coalesce(last.correlate(MOUNTINGS).scalar_subquery(), MOUNTINGS.c.from_ns).label("from_ns")
    chosen = (MOUNTINGS.c.wheelset.in_(wheelsets), MOUNTINGS.c.to_ns.is_(None))
    begins = select(MOUNTINGS.c.wheelset, from_ns).where(*chosen).cte("begins").prefix_with("MATERIALIZED")
    behind = and_(WINDOWS.c.wheelset == begins.c.wheelset, WINDOWS.c.start_ns >= begins.c.from_ns)
    return select(WINDOWS).join(begins, behind).order_by(*WINDOWS.primary_key)


@cache
def _several(held: bool) -> Select[Any]:  # noqa: FBT001 - a key of the cache
    statement = select(WINDOWS).where(keys_given(WINDOWS)).order_by(*WINDOWS.primary_key)
    return statement.with_for_update(key_share=True) if held else statement

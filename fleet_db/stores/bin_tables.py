"""One packed bin table per window."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import ColumnElement, Connection, FromClause, Row, and_, func, or_, select

from estimation.errors import ConflictError, NotFoundError
from estimation.motion.parameters import MOTION
from estimation.values.geometry import BinTable, FilledCells, TableKey, WindowTable
from estimation.values.roll_up import TabledWindow
from estimation.values.windows import WindowKey, WindowRecord, WindowState
from fleet_db.packed_values import pack_bin_table, unpack_bin_table, unpack_filled_cells
from fleet_db.rows import (
    batches,
    given,
    grouped,
    keys_given,
    on_sections,
    put_rows,
    replace_all,
    same_window,
    table_of,
    window_key,
)
from fleet_db.stores.window_rows import list_for_sums, spans_given, to_window_record
from fleet_db.stores.windows import NOT_PASSED_OVER
from fleet_db.subjects import ReadOnce, Subjects
from fleet_db.tables.windows import WindowBinTableRow, WindowRow

WINDOWS, TABLES = table_of(WindowRow), table_of(WindowBinTableRow)
SAME_WINDOW = same_window(WINDOWS, TABLES)
BATCH = 500  # rows fetched at once
TabledSpan = tuple[str, int, int | None, int]
"""Wheelset, first start, that behind the last one, and how many windows at most."""
COMPARED = ("track_version", "window_digest", "parameter_key", "samples", "content_digest", "packed")
_CONTENT = ("wheelset", "start_ns", "content_digest", "track_section", "table_purged_ns")
STORED = (
    select(*(WINDOWS.c[name] for name in _CONTENT), *(TABLES.c[name].label(f"table_{name}") for name in COMPARED))
    .select_from(WINDOWS.outerjoin(TABLES, SAME_WINDOW))
    .where(keys_given(WINDOWS))
)
"""Windows with their tables, if they have one."""
WITHOUT_TABLES = select(
    WINDOWS,
    *(TABLES.c[name] for name in ("parameter_key", "track_version", "running_km")),
    TABLES.c.content_digest.label("table_digest"),
).join_from(WINDOWS, TABLES, SAME_WINDOW)


@dataclass(frozen=True, slots=True)
class BinTableStore:
    """One packed bin table per window."""

    connection: Connection
    subjects: Subjects
    once: ReadOnce = field(default_factory=ReadOnce)

    def put_all(self, tables: Sequence[WindowTable], *, listed: bool = True) -> Sequence[WindowKey]:
        """Store the bin tables of different windows; where one has been purged it stays summed.

        Args:
            listed: Whether windows with another table are listed to be summed here.

        Returns:
            Those windows.

        Raises:
            NotFoundError: There is no such window.
            ConflictError: Its content is another.
        """
        windows = self._checked([(tabled.key, tabled.window_digest) for tabled in tables])
        rows = {tabled.key: _values(tabled) for tabled in tables if windows[tabled.key].table_purged_ns is None}
        changed = [
            key
            for key, row in sorted(rows.items())
            if any(getattr(windows[key], f"table_{name}") != row[name] for name in COMPARED)
        ]
        put_rows(self.connection, TABLES, [rows[key] for key in changed])
        for key in changed:
            self.subjects.tables(key[0])  # its geometry follows
            self.subjects.places(windows[key].track_section)
        if listed:
            list_for_sums(self.connection, changed)
        return changed

    def _checked(self, expected: Sequence[tuple[WindowKey, str]]) -> Mapping[WindowKey, Row[Any]]:
        """Return windows with their tables, once the contents of the windows are those expected."""
        windows: dict[WindowKey, Row[Any]] = {}
        for some in batches([key for key, _ in expected]):
            windows |= {(row.wheelset, row.start_ns): row for row in self.connection.execute(STORED, {"keys": some})}
        for key, digest in expected:
            name = f"{key[0]}@{key[1]}"
            if key not in windows:
                raise NotFoundError("window", name)
            if windows[key].content_digest != digest:
                raise ConflictError(f"window {name} was replaced while it was estimated", kind="window", key=name)
        return windows

    def parameter_keys(self, sections: Collection[str]) -> Sequence[TableKey]:
        """Return every combination of wheelset, vehicle and parameters of which there is a table on some sections."""
        columns = (TABLES.c.wheelset, WINDOWS.c.vehicle, TABLES.c.parameter_key)
        statement = select(*columns).join_from(WINDOWS, TABLES, SAME_WINDOW)
        statement = statement.where(on_sections(WINDOWS.c.track_section, sections)).distinct().order_by(*columns)
        return [TableKey(*row) for row in self.connection.execute(statement)]

    def made_with(self, key: TableKey) -> Sequence[tuple[str, int]]:
        """Return (wheelset, start) of the tables of one wheelset on one vehicle with certain parameters.

        Those whose windows wait already, or have no samples any more and are known to be of other parameters, are left
        out.
        """
        statement = (
            select(TABLES.c.start_ns)
            .join_from(WINDOWS, TABLES, SAME_WINDOW)
            .where(TABLES.c.wheelset == key.wheelset, TABLES.c.parameter_key == key.parameter_key)
            .where(WINDOWS.c.vehicle == key.vehicle, NOT_PASSED_OVER)
            .where(WINDOWS.c.state == WindowState.ESTIMATED.value)
            .order_by(TABLES.c.start_ns)
        )
        return [(key.wheelset, start_ns) for start_ns in self.connection.scalars(statement)]

    def tabled(
        self, wheelset: str, from_ns: int | None = None, to_ns: int | None = None, limit: int | None = None
    ) -> Sequence[TabledWindow]:
        """Return windows with tables that start in ``[from_ns, to_ns)``, oldest first, without the tables."""
        if limit is not None and from_ns is not None:
            span = (wheelset, from_ns, to_ns, limit)
            return self.once.of("tabled", [span], self._some_tabled).get(span, [])
        if from_ns is None and to_ns is None and (ahead := self.once.known("all tabled", wheelset)) is not None:
            return list(ahead)
        within = (*given(from_ns, TABLES.c.start_ns.__ge__), *given(to_ns, TABLES.c.start_ns.__lt__))
        statement = WITHOUT_TABLES.where(TABLES.c.wheelset == wheelset, *within)
        return [_tabled(row) for row in self.connection.execute(statement.order_by(TABLES.c.start_ns))]

    def last_reading(self, wheelset: str, from_ns: int, to_ns: int) -> TabledWindow | None:
        """Return the last window in ``[from_ns, to_ns)`` that has been summed and whose odometer had a reading."""
        span = (wheelset, from_ns, to_ns)
        return self.once.of("last reading", [span], self._last_readings).get(span)

    def read_ahead(
        self,
        readings: Collection[tuple[str, int, int]] = (),
        spans: Collection[TabledSpan] = (),
        keys: Collection[WindowKey] = (),
        wheelsets: Collection[str] = (),
    ) -> None:
        """Read together what is asked for one by one afterwards.

        Args:
            readings: Arguments of :meth:`last_reading`.
            spans: Arguments of :meth:`tabled`.
            keys: Windows whose tables :meth:`cells_of` returns.
            wheelsets: Of which :meth:`tabled` returns all windows.
        """
        self.once.of("all tabled", wheelsets, self._all_tabled)
        self.once.of("last reading", readings, self._last_readings)
        self.once.of("tabled", spans, self._some_tabled)
        self.once.of("packed", keys, self._packed)

    def _all_tabled(self, wheelsets: Collection[str]) -> Mapping[str, Sequence[TabledWindow]]:
        statement = WITHOUT_TABLES.where(TABLES.c.wheelset.in_(wheelsets))
        rows = self.connection.execute(statement.order_by(TABLES.c.wheelset, TABLES.c.start_ns))
        return grouped(rows, _tabled)

    def _last_readings(self, spans: Collection[tuple[str, int, int]]) -> Mapping[tuple[str, int, int], TabledWindow]:
        asked = spans_given(spans)
        earlier, its_window = TABLES.alias("earlier"), WINDOWS.alias("its_window")
        last = (
            select(earlier.c.start_ns)
            .join_from(earlier, its_window, same_window(its_window, earlier))
            .where(*_within(earlier, asked), earlier.c.running_km.is_not(None))
            .where(func.abs(its_window.c.mileage_km) <= MOTION.most_mileage_km)
            .order_by(earlier.c.start_ns.desc())
            .limit(1)
        )
        chosen = TABLES.c.start_ns == last.correlate(asked).scalar_subquery()
        return {(row.of_wheelset, row.from_ns, row.to_ns): _tabled(row) for row in self._of_spans(asked, chosen)}

    def _some_tabled(self, spans: Collection[TabledSpan]) -> Mapping[TabledSpan, Sequence[TabledWindow]]:
        windows: dict[TabledSpan, list[TabledWindow]] = {span: [] for span in spans}
        for limit in sorted({span[3] for span in spans}):
            asked = spans_given(span[:3] for span in spans if span[3] == limit)
            behind = TABLES.alias("behind")
            following = select(behind.c.start_ns).where(*_within(behind, asked)).order_by(behind.c.start_ns)
            left_out = following.limit(1).offset(limit).correlate(asked).scalar_subquery()
            before = or_(left_out.is_(None), TABLES.c.start_ns < left_out)
            for row in self._of_spans(asked, and_(*_within(TABLES, asked), before)):
                windows[row.of_wheelset, row.from_ns, row.to_ns, limit].append(_tabled(row))
        return windows

    def _of_spans(self, asked: FromClause, chosen: ColumnElement[bool]) -> Sequence[Row[Any]]:
        statement = WITHOUT_TABLES.add_columns(*asked.c).join(asked, asked.c.of_wheelset == TABLES.c.wheelset)
        return self.connection.execute(statement.where(chosen).order_by(TABLES.c.wheelset, TABLES.c.start_ns)).all()

    def _packed(self, keys: Collection[WindowKey]) -> Mapping[WindowKey, bytes]:
        of_keys = window_key(TABLES).in_(sorted(keys))
        rows = self.connection.execute(select(TABLES.c.wheelset, TABLES.c.start_ns, TABLES.c.packed).where(of_keys))
        return {(row.wheelset, row.start_ns): row.packed for row in rows}

    def note_running(self, mileages: Mapping[str, Mapping[int, float]]) -> None:
        """Keep the mileages that wheelsets had run at windows, by serial and start."""
        rows = [
            {"wheelset": wheelset, "start_ns": start_ns, "running_km": km}
            for wheelset, by_start in mileages.items()
            for start_ns, km in by_start.items()
        ]
        replace_all(self.connection, TABLES, rows)

    def cells_of(self, wheelset: str, starts: Sequence[int]) -> Iterator[tuple[int, FilledCells]]:
        """Yield start and filled cells of the tables of some windows, oldest first; DamagedError names the window."""
        ahead = [(start_ns, self.once.known("packed", (wheelset, start_ns))) for start_ns in starts]
        if all(packed is not None for _, packed in ahead):
            for start_ns, packed in ahead:
                yield start_ns, unpack_filled_cells(packed, where=f"bin table of window {wheelset}@{start_ns}")
            return
        for some in batches(starts):
            of_windows = (TABLES.c.wheelset == wheelset, TABLES.c.start_ns.in_(some))
            statement = select(TABLES.c.start_ns, TABLES.c.packed).where(*of_windows).order_by(TABLES.c.start_ns)
            with self.connection.execute(statement.execution_options(yield_per=BATCH)) as rows:
                for start_ns, packed in rows:
                    yield start_ns, unpack_filled_cells(packed, where=f"bin table of window {wheelset}@{start_ns}")

    def stream(
        self, wheelset: str, from_ns: int, to_ns: int | None
    ) -> Iterator[tuple[WindowRecord, BinTable, int | None]]:
        """Yield windows that start in ``[from_ns, to_ns)`` with bin table and track version, oldest first."""
        statement = select(WINDOWS, TABLES.c.track_version, TABLES.c.packed).join_from(WINDOWS, TABLES, SAME_WINDOW)
        within = (WINDOWS.c.start_ns >= from_ns, *given(to_ns, WINDOWS.c.start_ns.__lt__))
        statement = statement.where(WINDOWS.c.wheelset == wheelset, *within).order_by(WINDOWS.c.start_ns)
        with self.connection.execute(statement.execution_options(yield_per=BATCH)) as rows:
            for row in rows:
                where = f"bin table of window {wheelset}@{row.start_ns}"
                yield to_window_record(row), unpack_bin_table(row.packed, where=where), row.track_version


def _values(tabled: WindowTable) -> dict[str, Any]:
    packed = pack_bin_table(tabled.table)
    return {
        **{name: getattr(tabled, name) for name in ("wheelset", "start_ns", "track_version", "window_digest")},
        "parameter_key": tabled.table.parameter_key,
        "samples": int(tabled.table.samples),
        "content_digest": hashlib.sha256(packed).hexdigest(),
        "packed": packed,
    }


def _within(table: FromClause, asked: FromClause) -> tuple[ColumnElement[bool], ...]:
    before = or_(asked.c.to_ns.is_(None), table.c.start_ns < asked.c.to_ns)
    return table.c.wheelset == asked.c.of_wheelset, table.c.start_ns >= asked.c.from_ns, before


def _tabled(row: Row[Any]) -> TabledWindow:
    return TabledWindow(
        record=to_window_record(row),
        parameter_key=row.parameter_key,
        track_version=row.track_version,
        content_digest=row.table_digest,
        running_km=row.running_km,
        samples_purged=row.samples_purged_ns is not None,
    )

"""One packed bin table per window."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Select, and_, select

from estimation.errors import ConflictError
from estimation.values.geometry import BinTable, FilledCells, TableKey
from estimation.values.windows import WindowRecord
from fleet_db.changes import Changes
from fleet_db.models import WindowBinTableRow, WindowRow
from fleet_db.packed_values import pack_bin_table, unpack_bin_table, unpack_filled_cells
from fleet_db.rows import table_of, upsert
from fleet_db.stores.windows import content_digest, to_window_record

WINDOWS, TABLES = table_of(WindowRow), table_of(WindowBinTableRow)
SAME_WINDOW = and_(WINDOWS.c.wheelset == TABLES.c.wheelset, WINDOWS.c.start_ns == TABLES.c.start_ns)
BATCH = 500  # rows fetched at once


@dataclass(frozen=True, slots=True)
class BinTableStore:
    """Implements ``estimation.storage.BinTables``."""

    connection: Connection
    changes: Changes

    def put(self, wheelset: str, start_ns: int, table: BinTable, track_version: int | None, window_digest: str) -> None:
        """Store the bin table of a window, in the place of an earlier one; the same again changes nothing.

        Raises
        ------
        NotFoundError
            There is no such window.
        ConflictError
            The window holds other content now than ``window_digest``.
        """
        if content_digest(self.connection, wheelset, start_ns) != window_digest:
            key = f"{wheelset}@{start_ns}"
            raise ConflictError(f"window {key} was replaced while it was estimated", kind="window", key=key)
        packed = pack_bin_table(table)
        values = {
            "wheelset": wheelset,
            "start_ns": start_ns,
            "track_version": track_version,
            "window_digest": window_digest,
            "parameter_key": table.parameter_key,
            "samples": int(table.samples),
            "content_digest": hashlib.sha256(packed).hexdigest(),
            "packed": packed,
        }
        if upsert(self.connection, TABLES, values):
            self.changes.note(wheelset, shown=False)  # its geometry follows

    def parameter_keys(self) -> Sequence[TableKey]:
        """Return every combination of wheelset, vehicle and parameters of which there is a table."""
        columns = (TABLES.c.wheelset, WINDOWS.c.vehicle, TABLES.c.parameter_key)
        statement = select(*columns).join_from(WINDOWS, TABLES, SAME_WINDOW).distinct().order_by(*columns)
        return [TableKey(*row) for row in self.connection.execute(statement)]

    def made_with(self, key: TableKey) -> Sequence[tuple[str, int]]:
        """Return (wheelset, start) of the tables of one wheelset on one vehicle with certain parameters."""
        statement = (
            select(TABLES.c.start_ns)
            .join_from(WINDOWS, TABLES, SAME_WINDOW)
            .where(TABLES.c.wheelset == key.wheelset, TABLES.c.parameter_key == key.parameter_key)
            .where(WINDOWS.c.vehicle == key.vehicle)
            .order_by(TABLES.c.start_ns)
        )
        return [(key.wheelset, start_ns) for start_ns in self.connection.scalars(statement)]

    def index(self, wheelset: str, from_ns: int, to_ns: int | None) -> Sequence[tuple[WindowRecord, str, int | None]]:
        """Return what :meth:`stream` would yield without the tables: window, parameter key, track version."""
        statement = _selected(select(WINDOWS, TABLES.c.parameter_key, TABLES.c.track_version), wheelset, from_ns, to_ns)
        rows = self.connection.execute(statement)
        return [(to_window_record(row), row.parameter_key, row.track_version) for row in rows]

    def digests(self, wheelset: str, from_ns: int, to_ns: int | None) -> Mapping[int, str]:
        """Return the digest of each table by start of its window; older tables may have none."""
        columns = select(TABLES.c.start_ns, TABLES.c.content_digest)
        rows = self.connection.execute(_selected(columns, wheelset, from_ns, to_ns))
        return {row.start_ns: row.content_digest for row in rows if row.content_digest is not None}

    def stream(
        self, wheelset: str, from_ns: int, to_ns: int | None
    ) -> Iterator[tuple[WindowRecord, BinTable, int | None]]:
        """Yield windows that start in ``[from_ns, to_ns)`` with their bin table and track version, oldest first.

        Raises
        ------
        DamagedError
            A table is damaged; names the window.
        """
        statement = _selected(select(WINDOWS, TABLES.c.track_version, TABLES.c.packed), wheelset, from_ns, to_ns)
        with self.connection.execute(statement.execution_options(yield_per=BATCH)) as found:
            for row in found:
                where = f"bin table of window {wheelset}@{row.start_ns}"
                yield to_window_record(row), unpack_bin_table(row.packed, where=where), row.track_version

    def filled(self, wheelset: str, from_ns: int, to_ns: int | None) -> Iterator[tuple[int, FilledCells]]:
        """Yield start and filled cells of the tables of windows that start in ``[from_ns, to_ns)``, oldest first.

        Raises
        ------
        DamagedError
            A table is damaged; names the window.
        """
        statement = _selected(select(TABLES.c.start_ns, TABLES.c.packed), wheelset, from_ns, to_ns)
        with self.connection.execute(statement.execution_options(yield_per=BATCH)) as found:
            for start_ns, packed in found:
                yield start_ns, unpack_filled_cells(packed, where=f"bin table of window {wheelset}@{start_ns}")


def _selected(columns: Select[Any], wheelset: str, from_ns: int, to_ns: int | None) -> Select[Any]:
    statement = (
        columns.join_from(WINDOWS, TABLES, SAME_WINDOW)
        .where(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns >= from_ns)
        .order_by(WINDOWS.c.start_ns)
    )
    return statement if to_ns is None else statement.where(WINDOWS.c.start_ns < to_ns)

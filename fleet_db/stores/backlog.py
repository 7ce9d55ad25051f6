"""What waits to be worked off, and how old the newest data of each vehicle are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import Connection, func, select

from estimation.values.windows import WindowState
from fleet_db.receipts import ChunkState
from fleet_db.rows import table_of
from fleet_db.tables import ChunkRow, WindowRow, WorklistEntryRow

CHUNKS, WINDOWS, ENTRIES = table_of(ChunkRow), table_of(WindowRow), table_of(WorklistEntryRow)


@dataclass(frozen=True, slots=True)
class Backlog:
    """What waits.

    Attributes:
        recordings: How many there are, by state.
        oldest_recording_ns, oldest_window_ns: Since when, ns of our clock, the oldest recording waits to be decoded and
            the oldest window to be estimated; None where none does.
        last_data: Fleet, and newest data on the vehicle's clock, of each vehicle with a mounted wheelset; None without
            data.
    """

    recordings: Mapping[ChunkState, int]
    oldest_recording_ns: int | None
    oldest_window_ns: int | None
    last_data: tuple[tuple[str, int | None], ...]


def backlog_of(connection: Connection) -> Backlog:
    """Return what waits now."""
    states = connection.execute(select(CHUNKS.c.state, func.count()).group_by(CHUNKS.c.state))
    stored = select(func.min(CHUNKS.c.received_ns)).where(CHUNKS.c.state == ChunkState.STORED.value)
    pending = select(func.min(WINDOWS.c.recorded_ns)).where(WINDOWS.c.state == WindowState.PENDING.value)
    newest = (
        select(ENTRIES.c.fleet, func.max(ENTRIES.c.last_data_ns))
        .where(ENTRIES.c.vehicle.is_not(None))
        .group_by(ENTRIES.c.fleet, ENTRIES.c.vehicle)
    )
    return Backlog(
        recordings={ChunkState(state): int(count) for state, count in states},
        oldest_recording_ns=connection.scalar(stored),
        oldest_window_ns=connection.scalar(pending),
        last_data=tuple((fleet, at_ns) for fleet, at_ns in connection.execute(newest)),
    )

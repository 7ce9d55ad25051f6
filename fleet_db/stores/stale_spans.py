"""Spans of a vehicle's clock whose windows are no longer what recordings, registry and catalogue give."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from sqlalchemy import Connection, delete, func, insert, or_, select, update

from estimation.values.runs import Due
from fleet_db.rows import table_of
from fleet_db.tables.recordings import StaleSpanRow
from fleet_db.tables.windows import WindowRow

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


@dataclass(frozen=True, slots=True)
class StaleSpanStore:
    """Stale spans, in one transaction."""

    connection: Connection

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
        statement = select(SPANS).order_by(SPANS.c.vehicle, SPANS.c.from_ns, SPANS.c.id)
        if vehicle is not None:
            statement = statement.where(SPANS.c.vehicle == vehicle)
        return [StaleSpan(**row._mapping) for row in self.connection.execute(statement)]  # noqa: SLF001 - public accessor of SQLAlchemy

    def due(self, vehicles: Collection[str] | None = None) -> Mapping[str, Due]:
        """Return the vehicles of which something is stale, by code; of some or of all."""
        statement = select(SPANS.c.vehicle, func.max(SPANS.c.id).label("newest"))
        if vehicles is not None:
            statement = statement.where(SPANS.c.vehicle.in_(vehicles))
        rows = self.connection.execute(statement.group_by(SPANS.c.vehicle).order_by(SPANS.c.vehicle))
        return {row.vehicle: Due(row.newest) for row in rows}

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


WINDOWS = table_of(WindowRow)
APART_NS = 86_400_000_000_000
"""Windows that are nearer to each other are made again together, with what is between them."""


def make_stale(connection: Connection, section: str, cause: str, *, elsewhere: bool) -> None:
    """Let the windows on a section be assembled again.

    A window on another registered section stays: its vehicle sent the number of that one.

    Args:
        elsewhere: Whether those on no registered section are, too: their vehicles may have sent its new number.
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

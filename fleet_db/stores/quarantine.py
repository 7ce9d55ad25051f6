"""What failed by itself and is kept apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, String, and_, cast, func, or_, select, tuple_, update

from estimation.values.reasons import ReasonCode
from estimation.values.runs import Quarantined, QuarantineState, SubjectKind
from fleet_db.rows import columns_of, row_of, table_of, upsert, value_of_row
from fleet_db.tables.recordings import ChunkRow, QuarantineRow
from fleet_db.tables.windows import WindowRow

ITEMS, CHUNKS, WINDOWS = table_of(QuarantineRow), table_of(ChunkRow), table_of(WindowRow)
Place = tuple[str, str, str]
"""Kind, key and stage."""


@dataclass(frozen=True, slots=True)
class QuarantineStore:
    """What failed by itself and is kept apart."""

    connection: Connection

    def get(self, kind: SubjectKind, key: str, stage: str) -> Quarantined | None:
        """Return what is kept of one thing, held or resolved."""
        row = row_of(self.connection, ITEMS, kind.value, key, stage)
        return None if row is None else value_of_row(Quarantined, row)

    def held(self, stage: str | None = None) -> Sequence[Quarantined]:
        """Return what is held, of one stage or of all, by last failure."""
        statement = select(ITEMS).where(ITEMS.c.state == QuarantineState.HELD.value)
        if stage is not None:
            statement = statement.where(ITEMS.c.stage == stage)
        return self._items(statement)

    def due(self, stage: str, now_ns: int, limit: int) -> Sequence[Quarantined]:
        """Return what is held of a stage and due for another attempt, at most ``limit``, by last failure."""
        held = (ITEMS.c.state == QuarantineState.HELD.value, ITEMS.c.stage == stage)
        return self._items(select(ITEMS).where(*held, ITEMS.c.due_ns <= now_ns).limit(limit))

    def all(self, limit: int) -> Sequence[Quarantined]:
        """Return what is or was held, at most ``limit``, by last failure."""
        return self._items(select(ITEMS).limit(limit))

    def page(
        self,
        *,
        kind: SubjectKind | None,
        state: QuarantineState | None,
        code: ReasonCode | None,
        vehicle: str | None,
        after: Place | None,
        limit: int,
    ) -> Sequence[Quarantined]:
        """Return items behind a place, by kind, key and stage; of a vehicle with its recordings and windows."""
        chosen = [
            column == value.value
            for column, value in ((ITEMS.c.kind, kind), (ITEMS.c.state, state), (ITEMS.c.code, code))
            if value is not None
        ]
        place = (ITEMS.c.kind, ITEMS.c.key, ITEMS.c.stage)
        if vehicle is not None:
            chosen.append(_of_vehicle(vehicle))
        if after is not None:
            chosen.append(tuple_(*place) > tuple_(*after))
        statement = select(ITEMS).where(*chosen).order_by(*place).limit(limit)
        return [value_of_row(Quarantined, row) for row in self.connection.execute(statement)]

    def counts(self) -> dict[tuple[SubjectKind, ReasonCode], int]:
        """Return how many are held, by kind and code."""
        columns = (ITEMS.c.kind, ITEMS.c.code)
        statement = select(*columns, func.count()).where(ITEMS.c.state == QuarantineState.HELD.value).group_by(*columns)
        return {(SubjectKind(kind), ReasonCode(code)): int(n) for kind, code, n in self.connection.execute(statement)}

    def put(self, item: Quarantined) -> None:
        """Keep a failure, or its end."""
        upsert(self.connection, ITEMS, columns_of(item))

    def retry(self, kind: SubjectKind | None = None, key: str | None = None) -> Sequence[Quarantined]:
        """Let what is held be tried at the next run: all, one kind, or one thing; return what that is."""
        chosen = [ITEMS.c.state == QuarantineState.HELD.value]
        chosen += [] if kind is None else [ITEMS.c.kind == kind.value]
        chosen += [] if key is None else [ITEMS.c.key == key]
        found = self._items(select(ITEMS).where(*chosen))
        self.connection.execute(update(ITEMS).where(*chosen).values(due_ns=ITEMS.c.last_ns))
        return found

    def _items(self, statement: Any) -> Sequence[Quarantined]:  # noqa: ANN401 - a select of any shape
        ordered = statement.order_by(ITEMS.c.last_ns, ITEMS.c.kind, ITEMS.c.key, ITEMS.c.stage)
        return [value_of_row(Quarantined, row) for row in self.connection.execute(ordered)]


def _of_vehicle(vehicle: str) -> ColumnElement[bool]:
    recordings = select(CHUNKS.c.digest).where(CHUNKS.c.vehicle == vehicle)
    window_key = WINDOWS.c.wheelset + "@" + cast(WINDOWS.c.start_ns, String)
    windows = select(window_key).where(WINDOWS.c.vehicle == vehicle)
    return or_(
        and_(ITEMS.c.kind == SubjectKind.VEHICLE.value, ITEMS.c.key == vehicle),
        and_(ITEMS.c.kind == SubjectKind.RECORDING.value, ITEMS.c.key.in_(recordings)),
        and_(ITEMS.c.kind == SubjectKind.WINDOW.value, ITEMS.c.key.in_(windows)),
    )

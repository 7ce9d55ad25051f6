"""The conicities of wheelsets by section and period."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Select, Text, cast, delete, select

from estimation.errors import ParameterError, StorageError
from estimation.values.opinions import CELLS as CELLS_STAGE
from estimation.values.opinions import RailKey, SectionConicity, StoredCell, WheelKey
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import SubjectKind
from fleet_db.fields import fields_of, from_json, to_json, value_of
from fleet_db.rows import insert_all_new, key_given, key_of, replace_all, table_of
from fleet_db.subjects import Subjects
from fleet_db.tables.windows import RailCellRow

CELLS = table_of(RailCellRow)


@dataclass(frozen=True, slots=True)
class RailsStore:
    """Conicities of wheelsets by section."""

    connection: Connection
    subjects: Subjects

    def cells(self, wheelsets: Collection[str] | None = None) -> Sequence[StoredCell]:
        """Return all cells, or those of some wheelsets, in the order of their keys.

        One that cannot be read says so by its reason, and has no digest, so that it is made again.
        """
        columns = [CELLS.c[name] for name in (*_KEY, "digest", "interval_digest")]
        wanted: Select[Any] = select(*columns, cast(CELLS.c.document, Text).label("document"))
        if wheelsets is not None:
            wanted = wanted.where(CELLS.c.wheelset.in_(sorted(wheelsets)))
        rows = self.connection.execute(wanted)
        return sorted((_cell(row) for row in rows), key=lambda one: (one.wheel, one.rail))

    def put_cells(self, cells: Sequence[StoredCell]) -> None:
        """Store cells, in the place of earlier ones of the same keys."""
        rows = [{**_key_values(one.wheel, one.rail), **_values(one)} for one in cells]
        if insert_all_new(self.connection, CELLS, rows) < len(rows):
            replace_all(self.connection, CELLS, rows)
        self._raise({one.wheel.wheelset for one in cells})

    def drop_cells(self, keys: Sequence[tuple[WheelKey, RailKey]]) -> None:
        """Remove cells."""
        if keys:
            given = [key_of(CELLS, _key_values(wheel, rail)) for wheel, rail in keys]
            self.connection.execute(delete(CELLS).where(key_given(CELLS)), given)
        self._raise({wheel.wheelset for wheel, _ in keys})

    def _raise(self, wheelsets: Collection[str]) -> None:
        for wheelset in wheelsets:
            self.subjects.raised(SubjectKind.WHEELSET, wheelset, CELLS_STAGE)


_KEY = ("wheelset", "baseline", "mileage_interval", "section", "period")

_EXTENT = ("windows", "from_ns", "to_ns")


def _key_values(wheel: WheelKey, rail: RailKey) -> dict[str, Any]:
    parts = (wheel.wheelset, wheel.baseline, wheel.interval, rail.section, rail.period)
    return dict(zip(_KEY, parts, strict=True))


def _key(row: Row[Any]) -> tuple[WheelKey, RailKey]:
    return WheelKey(row.wheelset, row.baseline, row.mileage_interval), RailKey(row.section, row.period)


def _values(one: StoredCell) -> dict[str, Any]:
    document: dict[str, Any] = {name: getattr(one, name) for name in _EXTENT}
    if one.reason is not None:
        document["reason"] = to_json(one.reason)
    if one.cell is not None:
        scalars, arrays = fields_of(one.cell, without=("wheel", "rail"))
        of_arrays = {name: to_json(values.tolist()) for name, values in arrays.items()}
        document |= {"scalars": scalars, "arrays": of_arrays}
    return {"digest": one.digest, "interval_digest": one.interval_digest, "document": document}


def _cell(row: Row[Any]) -> StoredCell:
    wheel, rail = _key(row)
    try:
        document = json.loads(row.document)
        reason = from_json(document["reason"], Reason) if "reason" in document else None
        cell = _conicities(document, wheel, rail) if "arrays" in document or reason is None else None
        extent = {name: int(document[name]) for name in _EXTENT}
    except (ValueError, TypeError, LookupError, AttributeError, StorageError, ParameterError) as error:
        text = f"the conicities of {wheel.wheelset} on {rail.section} are damaged in the store ({error})"
        return StoredCell(wheel, rail, "", None, Reason(ReasonCode.CELL_DAMAGED, text))
    return StoredCell(wheel, rail, row.digest, cell, reason, **extent, interval_digest=row.interval_digest)


def _conicities(document: Mapping[str, Any], wheel: WheelKey, rail: RailKey) -> SectionConicity:
    arrays = {name: np.array(from_json(values, tuple[float, ...])) for name, values in document["arrays"].items()}
    return value_of(SectionConicity, document["scalars"], arrays, wheel=wheel, rail=rail)

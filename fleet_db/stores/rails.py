"""Wheels and rails apart: cells, and what was found last of each section and each wheelset."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Select, Table, Text, cast, delete, select

from estimation.errors import ParameterError, StorageError
from estimation.values.rails import (
    RailKey,
    SectionConicity,
    SectionRailsRecord,
    StoredCell,
    WheelKey,
    WheelsetRailsRecord,
)
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.fields import fields_of, from_json, to_json, value_of
from fleet_db.locks import Subject, serialise
from fleet_db.rows import key_given, key_of, table_of, upsert
from fleet_db.tables import RailCellRow, SectionRailsRow, WheelsetRailsRow

CELLS = table_of(RailCellRow)
OF_SECTIONS, OF_WHEELSETS = table_of(SectionRailsRow), table_of(WheelsetRailsRow)


@dataclass(frozen=True, slots=True)
class RailsStore:
    """Implements ``estimation.storage.Rails``."""

    connection: Connection

    def cells(self, wheelset: str | None = None) -> Sequence[StoredCell]:
        """Return all cells, or those of a wheelset, in the order of their keys.

        One that cannot be read says so by its reason, and has no digest, so that it is made again.
        """
        columns = [CELLS.c[name] for name in (*_KEY, "digest")]
        wanted: Select[Any] = select(*columns, cast(CELLS.c.document, Text).label("document"))
        found = self.connection.execute(wanted if wheelset is None else wanted.where(CELLS.c.wheelset == wheelset))
        return sorted((_cell(row) for row in found), key=lambda one: (one.wheel, one.rail))

    def put_cells(self, cells: Sequence[StoredCell]) -> None:
        """Store cells, in the place of earlier ones of the same keys."""
        for one in cells:
            upsert(self.connection, CELLS, {**_key_values(one.wheel, one.rail), **_values(one)})

    def drop_cells(self, keys: Sequence[tuple[WheelKey, RailKey]]) -> None:
        """Remove cells."""
        for wheel, rail in keys:
            given = key_of(CELLS, _key_values(wheel, rail))
            self.connection.execute(delete(CELLS).where(key_given(CELLS)), given)

    def input_digest(self) -> tuple[str, str] | None:
        """Return digest of the inputs and version of the code of what was found last; None before there is any."""
        columns = (OF_SECTIONS.c.input_digest, OF_SECTIONS.c.code_version)
        row = self.connection.execute(select(*columns).order_by(OF_SECTIONS.c.section).limit(1)).first()
        return None if row is None else (row.input_digest, row.code_version)

    def put_found(self, sections: Sequence[SectionRailsRecord], wheelsets: Sequence[WheelsetRailsRecord]) -> None:
        """Store what was found, in the place of all that was found before."""
        serialise(self.connection, Subject.GEOMETRIES)
        for table in (OF_SECTIONS, OF_WHEELSETS):
            self.connection.execute(delete(table))
        self._insert(OF_SECTIONS, [_section_values(one) for one in sections])
        self._insert(OF_WHEELSETS, [{"wheelset": one.wheelset, "document": to_json(one)} for one in wheelsets])

    def of_section(self, section: str) -> SectionRailsRecord | None:
        """Return what was found last of the rails of a section."""
        row = self.connection.execute(select(OF_SECTIONS).where(OF_SECTIONS.c.section == section)).first()
        return None if row is None else _read(SectionRailsRecord, row.document)

    def of_wheelset(self, wheelset: str) -> WheelsetRailsRecord | None:
        """Return what was found last of the wheels of a wheelset."""
        row = self.connection.execute(select(OF_WHEELSETS).where(OF_WHEELSETS.c.wheelset == wheelset)).first()
        return None if row is None else _read(WheelsetRailsRecord, row.document)

    def _insert(self, table: Table, rows: list[dict[str, Any]]) -> None:
        if rows:
            self.connection.execute(table.insert(), rows)


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
    return {"digest": one.digest, "document": document}


def _cell(row: Row[Any]) -> StoredCell:
    wheel, rail = _key(row)
    try:
        document = json.loads(row.document)
        reason = from_json(document["reason"], Reason) if "reason" in document else None
        cell = _conicities(document, wheel, rail) if "arrays" in document or reason is None else None
        extent = tuple(int(document[name]) for name in _EXTENT)
    except (ValueError, TypeError, LookupError, AttributeError, StorageError, ParameterError) as error:
        text = f"the conicities of {wheel.wheelset} on {rail.section} are damaged in the store ({error})"
        return StoredCell(wheel, rail, "", None, Reason(ReasonCode.CELL_DAMAGED, text))
    return StoredCell(wheel, rail, row.digest, cell, reason, *extent)


def _conicities(document: Mapping[str, Any], wheel: WheelKey, rail: RailKey) -> SectionConicity:
    arrays = {name: np.array(from_json(values, tuple[float, ...])) for name, values in document["arrays"].items()}
    return value_of(SectionConicity, document["scalars"], arrays, wheel=wheel, rail=rail)


def _section_values(record: SectionRailsRecord) -> dict[str, Any]:
    return {
        "section": record.section,
        "input_digest": record.input_digest,
        "code_version": record.code_version,
        "document": to_json(record),
    }


def _read(kind: type[Any], document: Any) -> Any:  # noqa: ANN401 - the record of that kind
    return from_json(document, kind)

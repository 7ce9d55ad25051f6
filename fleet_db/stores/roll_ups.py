"""Sums of bin tables by mileage interval."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Update, bindparam, delete, func, insert, select, update

from estimation.errors import ConflictError
from estimation.values.geometry import BinTable
from estimation.values.roll_up import (
    ExactTable,
    Odometer,
    RolledPart,
    RollingSums,
    RollUp,
    RollUpKey,
    RollUpState,
    Side,
    TabledWindow,
    TakenTable,
    WindowRollingSums,
)
from fleet_db.packed_values import (
    pack_bin_table,
    pack_exact_table,
    pack_rolling_sums,
    unpack_bin_table,
    unpack_exact_table,
    unpack_filled_cells,
    unpack_rolling_sums,
)
from fleet_db.rows import insert_all_new, replace_all, table_of, upsert
from fleet_db.tables import RollingSumsRow, RollUpRow, RollUpStateRow, TakenTableRow, WindowBinTableRow

ROLL_UPS, TAKEN, STATES = table_of(RollUpRow), table_of(TakenTableRow), table_of(RollUpStateRow)
TABLES, ROLLING = table_of(WindowBinTableRow), table_of(RollingSumsRow)
BATCH = 500  # numbers in a statement
KEY = ("baseline", "baseline_interval", "side", "table_key", "vehicle_class")
KNOWN = ("number", *KEY, "windows", "content", "sealed", "summary")


@dataclass(frozen=True, slots=True)
class RollUpStore:
    """Implements ``estimation.storage.RollUps``."""

    connection: Connection

    def state(self, wheelset: str) -> RollUpState | None:
        """Return what the roll-ups of a wheelset were made by; None where there are none."""
        columns = (STATES.c.rules, STATES.c.classes, STATES.c.odometers)
        row = self.connection.execute(select(*columns).where(STATES.c.wheelset == wheelset)).first()
        if row is None:
            return None
        odometers = {int(number): Odometer(*of) for number, of in row.odometers.items()}
        return RollUpState(row.rules, row.classes, odometers)

    def of(self, wheelset: str) -> Sequence[RollUp]:
        """Return what is known of the roll-ups of a wheelset, without their sums."""
        statement = select(*(ROLL_UPS.c[name] for name in KNOWN)).where(ROLL_UPS.c.wheelset == wheelset)
        return [_roll_up(row) for row in self.connection.execute(statement.order_by(ROLL_UPS.c.number))]

    def sums(self, number: int) -> tuple[ExactTable, ExactTable] | None:
        """Return the sums of a roll-up, plain and with forgetting; None where they are not kept any more.

        What has been forgotten is nothing.

        Raises:
            DamagedError: They are damaged.
        """
        columns = (ROLL_UPS.c.plain, ROLL_UPS.c.forgetting)
        row = self.connection.execute(select(*columns).where(ROLL_UPS.c.number == number)).one()
        if row.plain is None:
            return None
        where = f"roll-up {number}"
        plain = unpack_exact_table(row.plain, where=where)
        if row.forgetting is None:
            upper, lower = np.zeros_like(plain.upper), np.zeros_like(plain.lower)
            return plain, replace(plain, upper=upper, lower=lower, samples=0, windows=0)
        return plain, unpack_exact_table(row.forgetting, where=where)

    def taken(self, wheelset: str) -> Sequence[TakenTable]:
        """Return the tables that are to be taken from the roll-ups of a wheelset, in the order they were replaced."""
        rows = self.connection.execute(select(TAKEN).where(TAKEN.c.wheelset == wheelset).order_by(TAKEN.c.number))
        return [
            TakenTable(
                number=row.number,
                roll_up=row.roll_up,
                start_ns=row.start_ns,
                mileage_km=row.running_km,
                line=row.line,
                cells=unpack_filled_cells(row.packed, where=f"replaced bin table of {wheelset}@{row.start_ns}"),
            )
            for row in rows
        ]

    def earlier(self, wheelset: str, digest: str) -> BinTable | None:
        """Return the forgetting sum of the intervals that are over; None where it is not of this digest.

        Args:
            digest: Of all that goes into it.
        """
        same = (STATES.c.wheelset == wheelset, STATES.c.earlier_digest == digest)
        packed: bytes | None = self.connection.scalar(select(STATES.c.earlier).where(*same))
        return None if packed is None else unpack_bin_table(packed, where=f"earlier intervals of {wheelset}")

    def put_earlier(self, wheelset: str, digest: str, table: BinTable) -> None:
        """Keep the forgetting sum of the intervals that are over, beside the state that is there."""
        values = {"earlier_digest": digest, "earlier": pack_bin_table(table)}
        self.connection.execute(update(STATES).where(STATES.c.wheelset == wheelset).values(**values))

    def put(self, wheelset: str, parts: Sequence[RolledPart], outside: Sequence[TabledWindow] = ()) -> None:
        """Store roll-ups with their sums, and note which windows they have.

        Args:
            outside: Windows that were looked at and belong to none.

        Raises:
            ConflictError: A roll-up or a table is another by now.
        """
        notes = []
        for part in parts:
            number = self._put_sums(wheelset, part)
            notes += [_note(wheelset, one.window, number, one.mileage_km, one.line) for one in part.added]
        self._note_all([*notes, *(_note(wheelset, window, None, None, None) for window in outside)])

    def put_state(self, wheelset: str, state: RollUpState) -> None:
        """Store what the roll-ups of a wheelset were made by."""
        values = {
            "wheelset": wheelset,
            "rules": state.rules,
            "classes": dict(state.classes),
            "odometers": {
                str(k): [of.shift, of.last, of.last_km, of.last_ns, of.seen_ns] for k, of in state.odometers.items()
            },
        }
        upsert(self.connection, STATES, values)

    def drop(self, wheelset: str, roll_ups: Sequence[int], taken: Sequence[int]) -> None:
        """Remove roll-ups without windows, and replaced tables that have been taken away."""
        for table, numbers in ((ROLL_UPS, roll_ups), (TAKEN, taken)):
            if numbers:
                self.connection.execute(delete(table).where(table.c.wheelset == wheelset, table.c.number.in_(numbers)))

    def forget(self, wheelset: str, roll_ups: Sequence[int]) -> None:
        """Delete the sums with forgetting of those of some roll-ups that are sealed.

        Args:
            roll_ups: Their numbers; what is added to them has no weight any more.
        """
        for first in range(0, len(roll_ups), BATCH):
            some = ROLL_UPS.c.number.in_(roll_ups[first : first + BATCH])
            kept = (ROLL_UPS.c.wheelset == wheelset, ROLL_UPS.c.sealed, ROLL_UPS.c.forgetting.is_not(None))
            self.connection.execute(update(ROLL_UPS).where(some, *kept).values(forgetting=None))

    def rolling(self, wheelset: str, windows: Mapping[int, str], assumed: str) -> Mapping[int, tuple[RollingSums, ...]]:
        """Return by start what windows say of their rolling radius, where that is kept.

        Args:
            windows: Digest of their content by start; what was made of other content does not count.
            assumed: Digest of the class and parameters that it must have been made with.
        """
        rows = self.connection.execute(
            select(ROLLING.c.start_ns, ROLLING.c.window_digest, ROLLING.c.packed)
            .where(ROLLING.c.wheelset == wheelset, ROLLING.c.start_ns.in_(list(windows)))
            .where(ROLLING.c.assumed == assumed)
        )
        return {
            row.start_ns: unpack_rolling_sums(row.packed, where=f"rolling sums of {wheelset}@{row.start_ns}")
            for row in rows
            if row.window_digest == windows[row.start_ns]
        }

    def put_rolling(self, found: Sequence[WindowRollingSums]) -> None:
        """Keep what windows say of their rolling radius, in the place of what was known of them."""
        rows = [
            {
                "wheelset": one.wheelset,
                "start_ns": one.start_ns,
                "window_digest": one.window_digest,
                "assumed": one.assumed,
                "packed": pack_rolling_sums(one.parts),
            }
            for one in found
        ]
        if insert_all_new(self.connection, ROLLING, rows) < len(rows):
            replace_all(self.connection, ROLLING, rows)

    def newest_chosen(self, wheelsets: Sequence[str]) -> Mapping[str, Sequence[str]]:
        """Return by wheelset the digests of the windows that stand for its newest roll-up.

        With those of later windows of which it is kept what they say of their rolling radius.
        """
        newest = (
            select(func.max(ROLL_UPS.c.number)).where(ROLL_UPS.c.wheelset.in_(wheelsets)).group_by(ROLL_UPS.c.wheelset)
        )
        statement = select(ROLL_UPS.c.wheelset, ROLL_UPS.c.summary).where(ROLL_UPS.c.number.in_(newest))
        summaries = {row.wheelset: row.summary for row in self.connection.execute(statement)}
        found = {wheelset: [digest for digest, _ in of["chosen"]] for wheelset, of in summaries.items()}
        kept = select(ROLLING.c.wheelset, ROLLING.c.start_ns, ROLLING.c.window_digest)
        for row in self.connection.execute(kept.where(ROLLING.c.wheelset.in_(wheelsets))):
            if row.wheelset not in summaries or row.start_ns > summaries[row.wheelset]["last_ns"]:
                found.setdefault(row.wheelset, []).append(row.window_digest)
        return found

    def keep_rolling(self, wheelset: str, starts: Sequence[int]) -> None:
        """Forget what windows other than these say of their rolling radius."""
        self.connection.execute(
            delete(ROLLING).where(ROLLING.c.wheelset == wheelset, ROLLING.c.start_ns.not_in(starts))
        )

    def _put_sums(self, wheelset: str, part: RolledPart) -> int:
        """Store what is known of a roll-up and its sums; return its number."""
        roll_up = part.roll_up
        values = _columns(wheelset, roll_up) | {
            "plain": pack_exact_table(part.plain),
            "forgetting": pack_exact_table(part.forgetting),
        }
        if roll_up.number is None:
            return int(
                self.connection.execute(insert(ROLL_UPS).values(**values).returning(ROLL_UPS.c.number)).scalar_one()
            )
        same = (
            ROLL_UPS.c.number == roll_up.number,
            ROLL_UPS.c.content == part.before,
            ROLL_UPS.c.sealed.is_(roll_up.sealed),
        )
        if not self.connection.execute(update(ROLL_UPS).where(*same).values(**values)).rowcount:
            raise ConflictError(f"roll-up {roll_up.number} changed", kind="roll-up", key=str(roll_up.number))
        return roll_up.number

    def _note_all(self, notes: Sequence[Mapping[str, Any]]) -> None:
        """Note of which roll-ups the tables of windows are."""
        if not notes or self.connection.execute(_noted(), list(notes)).rowcount == len(notes):
            return
        for note in notes:  # the same again, to find the table that has changed
            if not self.connection.execute(_noted(), note).rowcount:
                key = f"{note['of_wheelset']}@{note['of_start_ns']}"
                raise ConflictError(f"the bin table of window {key} changed", kind="bin table", key=key)


def _note(
    wheelset: str, window: TabledWindow, number: int | None, km: float | None, line: str | None
) -> dict[str, Any]:
    return {
        "of_wheelset": wheelset,
        "of_start_ns": window.record.start_ns,
        "of_window": window.record.content_digest,
        "of_table": window.content_digest,
        "roll_up": number,
        "running_km": km,
        "line": line,
    }


@cache
def _noted() -> Update:
    return (
        update(TABLES)
        .where(TABLES.c.wheelset == bindparam("of_wheelset"), TABLES.c.start_ns == bindparam("of_start_ns"))
        .where(TABLES.c.window_digest == bindparam("of_window"), TABLES.c.content_digest == bindparam("of_table"))
        .values(rolled=True, roll_up=bindparam("roll_up"), running_km=bindparam("running_km"), line=bindparam("line"))
        .execution_options(preserve_rowcount=True)
    )


def _columns(wheelset: str, roll_up: RollUp) -> dict[str, Any]:
    key = roll_up.key
    return {
        "wheelset": wheelset,
        "baseline": key.baseline,
        "baseline_interval": key.interval,
        "side": int(key.side),
        "table_key": key.table_key,
        "vehicle_class": key.vehicle_class,
        "windows": roll_up.windows,
        "content": roll_up.content_digest,
        "sealed": roll_up.sealed,
        "summary": json.loads(json.dumps(_summary(roll_up))),
    }


def _summary(roll_up: RollUp) -> Mapping[str, Any]:
    return {
        "first_ns": roll_up.first_ns,
        "last_ns": roll_up.last_ns,
        "end_ns": roll_up.end_ns,
        "last_km": roll_up.last_km,
        "last_stored_km": roll_up.last_stored_km,
        "mileage_mm": roll_up.mileage_mm,
        "weight": roll_up.weight,
        "weighted_mileage": roll_up.weighted_mileage,
        "versions": {section: list(versions) for section, versions in roll_up.versions.items()},
        "vehicles": list(roll_up.vehicles),
        "chosen": [list(one) for one in roll_up.chosen],
    }


def _roll_up(row: Row[Any]) -> RollUp:
    of = row.summary
    return RollUp(
        key=RollUpKey(row.baseline, row.baseline_interval, Side(row.side), row.table_key, row.vehicle_class),
        number=row.number,
        windows=row.windows,
        content=int(row.content, 16),
        first_ns=of["first_ns"],
        last_ns=of["last_ns"],
        end_ns=of["end_ns"],
        last_km=of["last_km"],
        last_stored_km=of["last_stored_km"],
        mileage_mm=of["mileage_mm"],
        weight=of["weight"],
        weighted_mileage=of["weighted_mileage"],
        versions={section: tuple(versions) for section, versions in of["versions"].items()},
        vehicles=tuple(of["vehicles"]),
        chosen=tuple((digest, start_ns) for digest, start_ns in of["chosen"]),
        sealed=row.sealed,
    )

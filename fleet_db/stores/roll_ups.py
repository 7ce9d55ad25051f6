"""Sums of bin tables by mileage interval."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Connection, Row, and_, delete, func, insert, or_, select, update

from estimation.errors import ConflictError
from estimation.values.geometry import BinTable
from estimation.values.roll_up import RolledPart, RollingSums, RollUp, RollUpKey, RollUpState, WindowRollingSums
from estimation.values.windows import WindowKey
from fleet_db.fields import fields_of, value_of
from fleet_db.packed_values import pack_bin_table, pack_rolling_sums, unpack_bin_table, unpack_rolling_sums
from fleet_db.rows import (
    batches,
    columns_of,
    grouped,
    keys_given,
    put_rows,
    replace_all,
    table_of,
    value_of_row,
    window_key,
)
from fleet_db.subjects import ReadOnce
from fleet_db.tables.registry import WheelsetRow
from fleet_db.tables.windows import RollingSumsRow, RollUpRow, RollUpStateRow, WindowBinTableRow, WindowRow

ROLL_UPS, STATES, ROLLING = table_of(RollUpRow), table_of(RollUpStateRow), table_of(RollingSumsRow)
TABLES, WINDOWS, WHEELSETS = table_of(WindowBinTableRow), table_of(WindowRow), table_of(WheelsetRow)
STATE = "roll-up state"
OWN = ("number", "windows", "content", "first_ns", "last_ns", "sealed")  # columns beside those of the key
KNOWN = (*OWN, "baseline", "baseline_interval", "side", "table_key", "vehicle_class", "summary")


@dataclass(frozen=True, slots=True)
class RollUpStore:
    """Sums of bin tables by mileage interval."""

    connection: Connection
    once: ReadOnce = field(default_factory=ReadOnce)

    def state(self, wheelset: str) -> RollUpState | None:
        """Return what the roll-ups of a wheelset were made by; None where there are none."""

        def read(some: Collection[str]) -> Mapping[str, RollUpState]:
            columns = (STATES.c.wheelset, STATES.c.rules, STATES.c.classes)
            rows = self.connection.execute(select(*columns).where(STATES.c.wheelset.in_(some)))
            return {row.wheelset: RollUpState(row.rules, row.classes) for row in rows}

        return self.once.of_wheelset(STATE, wheelset, read)

    def of(self, wheelset: str) -> Sequence[RollUp]:
        """Return what is known of the roll-ups of a wheelset, without their sums."""

        def read(some: Collection[str]) -> Mapping[str, Sequence[RollUp]]:
            columns = (ROLL_UPS.c.wheelset, *(ROLL_UPS.c[name] for name in KNOWN))
            statement = select(*columns).where(ROLL_UPS.c.wheelset.in_(some)).order_by(ROLL_UPS.c.number)
            return grouped(self.connection.execute(statement), roll_up)

        def roll_up(row: Row[Any]) -> RollUp:
            key = value_of_row(RollUpKey, row, interval=row.baseline_interval)
            return value_of(RollUp, row.summary, {}, key=key, **{name: getattr(row, name) for name in OWN})

        return self.once.of_wheelset("roll-ups", wheelset, read) or ()

    def sums(self, number: int) -> tuple[BinTable, BinTable]:
        """Return the sums of a roll-up, plain and with forgetting (zero where forgotten); raises DamagedError."""
        packed, forgetting = self.once.known("sums", number) or self._sums([number])[number]
        where = f"roll-up {number}"
        plain = unpack_bin_table(packed, where=where)
        return plain, plain.without_samples if forgetting is None else unpack_bin_table(forgetting, where=where)

    def read_ahead(self, numbers: Collection[int], rolling: Collection[WindowKey]) -> None:
        """Read together what :meth:`sums` and :meth:`rolling` are asked for one by one afterwards."""
        self.once.of("sums", numbers, self._sums)
        self.once.of("rolling sums", rolling, self._rolling)

    def _sums(self, numbers: Collection[int]) -> Mapping[int, tuple[bytes, bytes | None]]:
        columns = (ROLL_UPS.c.number, ROLL_UPS.c.plain, ROLL_UPS.c.forgetting)
        rows = self.connection.execute(select(*columns).where(ROLL_UPS.c.number.in_(numbers)))
        return {row.number: (row.plain, row.forgetting) for row in rows}

    def earlier(self, wheelset: str, digest: str) -> BinTable | None:
        """Return the forgetting sum of the intervals that are over; None where it is not of this digest."""

        def read(some: Collection[str]) -> Mapping[str, tuple[str, bytes]]:
            kept = select(STATES).where(STATES.c.wheelset.in_(some), STATES.c.earlier.is_not(None))
            return {row.wheelset: (row.earlier_digest, row.earlier) for row in self.connection.execute(kept)}

        if self.once.is_absent(STATE, wheelset):
            return None
        of, packed = self.once.of_wheelset("earlier intervals", wheelset, read) or ("", b"")
        return unpack_bin_table(packed, where=f"earlier intervals of {wheelset}") if of == digest else None

    def put(self, parts: Mapping[str, Sequence[RolledPart]], now_ns: int) -> None:
        """Store roll-ups of wheelsets with their sums; raises ConflictError where one is another by now."""
        new = []
        for wheelset, part in ((wheelset, part) for wheelset, of_wheelset in parts.items() for part in of_wheelset):
            values = _with_sums(wheelset, part)
            if part.roll_up.number is None:
                new.append(values)
            else:
                self._change(part, part.roll_up.number, values)
            if part.roll_up.sealed and part.added:
                self._purge([(wheelset, window.start_ns) for window in part.added], now_ns)
        if new:
            self.connection.execute(insert(ROLL_UPS), new)

    def _change(self, part: RolledPart, number: int, values: Mapping[str, Any]) -> None:
        same = (
            ROLL_UPS.c.number == number,
            ROLL_UPS.c.content == part.before,
            ROLL_UPS.c.sealed.is_(part.roll_up.sealed),
        )
        if not self.connection.execute(update(ROLL_UPS).where(*same).values(**values)).rowcount:
            raise ConflictError(f"roll-up {number} changed", kind="roll-up", key=str(number))

    def _purge(self, keys: Sequence[WindowKey], now_ns: int) -> None:
        purged = update(WINDOWS).where(keys_given(WINDOWS)).values(table_purged_ns=now_ns)
        for some in batches(keys):
            self.connection.execute(purged, {"keys": some})
            self.connection.execute(delete(TABLES).where(keys_given(TABLES)), {"keys": some})

    def put_states(
        self, states: Mapping[str, RollUpState], earlier: Mapping[str, tuple[str, BinTable]] | None = None
    ) -> None:
        """Store what the roll-ups of wheelsets were made by.

        Args:
            earlier: Forgetting sums of the intervals that are over, with their digests, to be kept beside states that
                are there.
        """
        of_states = {
            wheelset: {"wheelset": wheelset, "rules": state.rules, "classes": dict(state.classes)}
            for wheelset, state in states.items()
        }
        of_earlier = {
            wheelset: {"wheelset": wheelset, "earlier_digest": digest, "earlier": pack_bin_table(table)}
            for wheelset, (digest, table) in (earlier or {}).items()
        }
        both = sorted(of_states.keys() & of_earlier.keys())
        put_rows(self.connection, STATES, [of_states.pop(serial) | of_earlier.pop(serial) for serial in both])
        put_rows(self.connection, STATES, [of_states[serial] for serial in sorted(of_states)])
        replace_all(self.connection, STATES, list(of_earlier.values()))

    def drop(self, wheelset: str, roll_ups: Sequence[int]) -> None:
        """Remove roll-ups without windows."""
        if roll_ups:
            gone = (ROLL_UPS.c.wheelset == wheelset, ROLL_UPS.c.number.in_(roll_ups))
            self.connection.execute(delete(ROLL_UPS).where(*gone))

    def forget(self, wheelset: str, roll_ups: Sequence[int]) -> None:
        """Delete the sums with forgetting of those of some roll-ups that are sealed: what is added has no weight."""
        kept = (ROLL_UPS.c.wheelset == wheelset, ROLL_UPS.c.sealed, ROLL_UPS.c.forgetting.is_not(None))
        for some in batches(roll_ups):
            forgotten = update(ROLL_UPS).where(ROLL_UPS.c.number.in_(some), *kept)
            self.connection.execute(forgotten.values(forgetting=None))

    def rolling(self, wheelset: str, windows: Mapping[int, str], assumed: str) -> Mapping[int, tuple[RollingSums, ...]]:
        """Return by start what windows (digest by start) say of their rolling radius, where that was so assumed."""
        rows = self.once.of("rolling sums", [(wheelset, start_ns) for start_ns in windows], self._rolling)
        return {
            row.start_ns: unpack_rolling_sums(row.packed, where=f"rolling sums of {wheelset}@{row.start_ns}")
            for row in rows.values()
            if row.assumed == assumed and windows[row.start_ns] == row.window_digest
        }

    def _rolling(self, keys: Collection[WindowKey]) -> Mapping[WindowKey, Row[Any]]:
        of_keys = select(ROLLING).where(window_key(ROLLING).in_(keys))
        return {(row.wheelset, row.start_ns): row for row in self.connection.execute(of_keys)}

    def put_rolling(self, sums: Sequence[WindowRollingSums]) -> None:
        """Keep what windows say of their rolling radius, in the place of what was known of them."""
        rows = [columns_of(window, "parts") | {"packed": pack_rolling_sums(window.parts)} for window in sums]
        put_rows(self.connection, ROLLING, sorted(rows, key=lambda row: (row["wheelset"], row["start_ns"])))

    def newest_chosen(self, wheelsets: Sequence[str]) -> Mapping[str, Sequence[str]]:
        """Return by wheelset the digests of the windows behind its newest roll-up, and of later ones beside it."""
        newest = ROLL_UPS.alias("newest")
        last = select(func.max(newest.c.number)).where(newest.c.wheelset == WHEELSETS.c.serial).scalar_subquery()
        later = or_(ROLL_UPS.c.last_ns.is_(None), ROLLING.c.start_ns > ROLL_UPS.c.last_ns)
        joined = WHEELSETS.outerjoin(ROLL_UPS, ROLL_UPS.c.number == last)
        joined = joined.outerjoin(ROLLING, and_(ROLLING.c.wheelset == WHEELSETS.c.serial, later))
        chosen = select(WHEELSETS.c.serial, ROLL_UPS.c.summary, ROLLING.c.window_digest).select_from(joined)
        digests: dict[str, list[str]] = {}
        for serial, summary, later_digest in self.connection.execute(chosen.where(WHEELSETS.c.serial.in_(wheelsets))):
            if serial not in digests:
                digests[serial] = [] if summary is None else [digest for digest, _ in summary["chosen"]]
            if later_digest is not None:
                digests[serial].append(later_digest)
        return digests

    def keep_rolling(self, starts: Mapping[str, Sequence[int]]) -> None:
        """Forget what windows of wheelsets other than these say of their rolling radius."""
        others = [
            and_(ROLLING.c.wheelset == wheelset, ROLLING.c.start_ns.not_in(kept)) for wheelset, kept in starts.items()
        ]
        if others:
            self.connection.execute(delete(ROLLING).where(or_(*others)))


def _with_sums(wheelset: str, part: RolledPart) -> dict[str, Any]:
    roll_up = part.roll_up
    return {
        "wheelset": wheelset,
        **columns_of(roll_up.key, "interval"),
        "baseline_interval": roll_up.key.interval,
        **{name: getattr(roll_up, name) for name in OWN if name != "number"},
        "summary": fields_of(roll_up, without={"key", *OWN})[0],
        "plain": pack_bin_table(part.plain),
        "forgetting": pack_bin_table(part.forgetting),
    }

"""Wear signatures of windows, and what is concluded from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, and_, delete, func, or_, select, tuple_

from estimation.errors import DamagedError
from estimation.values.reasons import ReasonCode
from estimation.values.signatures import KnownSignatures, SignatureRecord, StoredSignatures, WindowSignatures
from estimation.values.windows import WindowKey, WindowState
from fleet_db.packed_signatures import pack_answer, pack_signatures, unpack_answer, unpack_signatures
from fleet_db.rows import reason_columns, stored_reason, table_of, upsert
from fleet_db.tables import SignatureAnswerRow, WearSignatureRow, WindowRow

SIGNATURES, ANSWERS, WINDOWS = table_of(WearSignatureRow), table_of(SignatureAnswerRow), table_of(WindowRow)
SAME = and_(SIGNATURES.c.wheelset == WINDOWS.c.wheelset, SIGNATURES.c.start_ns == WINDOWS.c.start_ns)
SPEED_BAND = 5  # m/s
NEWEST = 24  # windows of a wheelset on a section in a band of speed that the library may use
OF_OTHERS = (
    ReasonCode.FRAME_UNKNOWN.value,
    ReasonCode.MOUNTING_DIFFERS.value,
)  # what other windows or the registry lack


@dataclass(frozen=True, slots=True)
class SignatureStore:
    """Implements ``estimation.storage.Signatures``."""

    connection: Connection

    def missing(self, wheelsets: Sequence[str], limit: int, after: WindowKey | None = None) -> Sequence[WindowKey]:
        """Return windows with samples that have no signatures, or have those of other samples, by wheelset and start.

        A window that lacked the other axle of its bogie is one of them once it has been estimated.

        Args:
            wheelsets: Serials, a few hundred at most.
            after: Key behind which they are.
        """
        key = (WINDOWS.c.wheelset, WINDOWS.c.start_ns)
        other = SIGNATURES.c.window_digest != WINDOWS.c.content_digest
        possible = and_(SIGNATURES.c.reason_code.in_(OF_OTHERS), WINDOWS.c.state == WindowState.ESTIMATED.value)
        statement = select(*key).select_from(WINDOWS.outerjoin(SIGNATURES, SAME))
        statement = statement.where(
            WINDOWS.c.wheelset.in_(wheelsets),
            WINDOWS.c.samples_purged_ns.is_(None),
            or_(SIGNATURES.c.window_digest.is_(None), other, possible),
        )
        if after is not None:
            statement = statement.where(tuple_(*key) > tuple_(*after))
        rows = self.connection.execute(statement.order_by(*key).limit(limit))
        return [(row.wheelset, row.start_ns) for row in rows]

    def put_all(self, found: Sequence[WindowSignatures]) -> None:
        """Store what became of windows, in the place of what was stored of them."""
        for one in found:
            first = one.signatures[0] if one.signatures else None
            place = None if first is None else first.place
            values = {
                "wheelset": one.wheelset,
                "start_ns": one.start_ns,
                "vehicle": one.vehicle,
                "section": None if place is None else place.section,
                "speed_band_m_s": None if first is None else SPEED_BAND * int(first.speed // SPEED_BAND),
                "window_digest": one.window_digest,
                "assumed": one.assumed,
                "places": len(one.signatures),
                "packed": pack_signatures(one.signatures),
                **reason_columns(one.reason),
            }
            upsert(self.connection, SIGNATURES, values)

    def assumptions(self, wheelsets: Sequence[str]) -> Sequence[tuple[str, str, str]]:
        """Return vehicle, wheelset and digest of what was assumed, of all that is stored with samples to make it of.

        Args:
            wheelsets: Serials, a few hundred at most.
        """
        columns = (SIGNATURES.c.vehicle, SIGNATURES.c.wheelset, SIGNATURES.c.assumed)
        statement = select(*columns).select_from(SIGNATURES.join(WINDOWS, SAME))
        statement = (
            statement.where(SIGNATURES.c.wheelset.in_(wheelsets), WINDOWS.c.samples_purged_ns.is_(None))
            .distinct()
            .order_by(*columns)
        )
        return [(row.vehicle, row.wheelset, row.assumed) for row in self.connection.execute(statement)]

    def forget(self, vehicle: str, wheelset: str, assumed: str) -> int:
        """Remove signatures that were made with other assumptions and can be made again; return how many."""
        with_samples = select(WINDOWS.c.start_ns).where(
            WINDOWS.c.wheelset == wheelset, WINDOWS.c.samples_purged_ns.is_(None)
        )
        same = (
            SIGNATURES.c.vehicle == vehicle,
            SIGNATURES.c.wheelset == wheelset,
            SIGNATURES.c.assumed == assumed,
            SIGNATURES.c.start_ns.in_(with_samples),
        )
        return int(self.connection.execute(delete(SIGNATURES).where(*same)).rowcount)

    def known(self) -> StoredSignatures:
        """Return signatures of windows as they are stored by now, whose mileage is believed; by key.

        Of each wheelset, section and band of speed those of the newest windows, ``NEWEST`` of them. What is damaged is
        named beside.
        """
        order = func.row_number().over(
            partition_by=(SIGNATURES.c.wheelset, SIGNATURES.c.section, SIGNATURES.c.speed_band_m_s),
            order_by=SIGNATURES.c.start_ns.desc(),
        )
        keys = select(SIGNATURES.c.wheelset, SIGNATURES.c.start_ns, WINDOWS.c.mileage_km, order.label("age"))
        keys = keys.select_from(SIGNATURES.join(WINDOWS, SAME)).where(
            SIGNATURES.c.places > 0,
            SIGNATURES.c.window_digest == WINDOWS.c.content_digest,
            WINDOWS.c.implausible_code.is_(None),
        )
        newest = keys.subquery()
        own = and_(newest.c.wheelset == SIGNATURES.c.wheelset, newest.c.start_ns == SIGNATURES.c.start_ns)
        statement = select(SIGNATURES, newest.c.mileage_km).select_from(SIGNATURES.join(newest, own))
        statement = statement.where(newest.c.age <= NEWEST)
        rows = self.connection.execute(statement.order_by(SIGNATURES.c.wheelset, SIGNATURES.c.start_ns))
        known, damaged = [], []
        for row in rows:
            try:
                known.append(KnownSignatures(_of_window(row), row.mileage_km))
            except DamagedError as error:
                damaged.append((row.wheelset, row.start_ns, str(error)))
        return StoredSignatures(known, damaged)

    def drop(self, keys: Sequence[WindowKey]) -> None:
        """Remove what is stored of windows, so that it is made again where their samples are there."""
        for wheelset, start_ns in keys:
            own = (SIGNATURES.c.wheelset == wheelset, SIGNATURES.c.start_ns == start_ns)
            self.connection.execute(delete(SIGNATURES).where(*own))

    def counts(self) -> Mapping[str, int]:
        """Return how many windows have signatures, and how many have none, by code of the reason; empty for none."""
        statement = select(SIGNATURES.c.reason_code, func.count()).group_by(SIGNATURES.c.reason_code)
        return {code or "": count for code, count in self.connection.execute(statement)}

    def put_answer(self, record: SignatureRecord) -> None:
        """Store the answer about a wheelset, in the place of an earlier one."""
        values = {
            "wheelset": record.wheelset,
            "input_digest": record.input_digest,
            "code_version": record.code_version,
            "packed": pack_answer(record),
        }
        upsert(self.connection, ANSWERS, values)

    def answer(self, wheelset: str) -> SignatureRecord | None:
        """Return the newest answer about a wheelset; None where there is none."""
        packed: bytes | None = self.connection.scalar(select(ANSWERS.c.packed).where(ANSWERS.c.wheelset == wheelset))
        return None if packed is None else unpack_answer(packed, wheelset)

    def answered(self) -> Mapping[str, tuple[str, str]]:
        """Return by wheelset what its newest answer was made from, and by which version of the code."""
        columns = (ANSWERS.c.wheelset, ANSWERS.c.input_digest, ANSWERS.c.code_version)
        return {row.wheelset: (row.input_digest, row.code_version) for row in self.connection.execute(select(*columns))}


def _of_window(row: Row[Any]) -> WindowSignatures:
    return WindowSignatures(
        wheelset=row.wheelset,
        start_ns=row.start_ns,
        vehicle=row.vehicle,
        window_digest=row.window_digest,
        assumed=row.assumed,
        signatures=unpack_signatures(row.packed, row.wheelset, row.start_ns),
        reason=stored_reason(row),
    )

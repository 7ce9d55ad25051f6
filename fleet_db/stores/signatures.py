"""Wear signatures of windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sqlalchemy import and_, delete, func, or_, select

from estimation.errors import DamagedError
from estimation.values.runs import SubjectKind
from estimation.values.signatures import OF_OTHERS, KnownSignatures, MadeOf, StoredSignatures, WindowSignatures
from estimation.values.signatures import SIGNATURES as STAGE
from estimation.values.windows import WindowKey
from fleet_db.due import list_due, windows_changed
from fleet_db.packed_values import pack_signatures, unpack_signatures
from fleet_db.rows import batches, columns_of, put_rows, same_window, table_of, value_of_row, window_key
from fleet_db.subjects import RaisingStore
from fleet_db.tables.windows import WearSignatureRow, WindowRow

SIGNATURES, WINDOWS = table_of(WearSignatureRow), table_of(WindowRow)
KEY = window_key(SIGNATURES)
SAME = same_window(SIGNATURES, WINDOWS)
SPEED_BAND = 5  # m/s
NEWEST = 24  # windows of a wheelset on a section in a band of speed that the library may use
TOGETHER = 100
"""Conditions in a statement: SQLite takes no more than a thousand, one behind the other."""


class SignatureStore(RaisingStore):
    """Wear signatures of windows."""

    def made_of(self, keys: Sequence[WindowKey]) -> Mapping[WindowKey, MadeOf]:
        """Return what the signatures of windows are made from, of those that have been looked at."""
        names = ("wheelset", "start_ns", "window_digest", "assumed", "reason_code")
        rows = self.connection.execute(select(*(SIGNATURES.c[name] for name in names)).where(KEY.in_(keys)))
        return {
            (serial, start_ns): MadeOf(digest, assumed, code in OF_OTHERS)
            for serial, start_ns, digest, assumed, code in rows
        }

    def put_all(self, looked_at: Sequence[WindowSignatures]) -> None:
        """Store what became of windows, in the place of what was stored of them."""
        put_rows(self.connection, SIGNATURES, [_values(window) for window in looked_at])
        for window in looked_at:
            self.subjects.raised(SubjectKind.WHEELSET, window.wheelset, STAGE)

    def vehicles(self, wheelsets: Sequence[str]) -> Sequence[tuple[str, str]]:
        """Return wheelset and vehicle of the windows with samples of some wheelsets."""
        columns = (WINDOWS.c.wheelset, WINDOWS.c.vehicle)
        chosen = (WINDOWS.c.wheelset.in_(wheelsets), WINDOWS.c.samples_purged_ns.is_(None))
        rows = self.connection.execute(select(*columns).where(*chosen).distinct().order_by(*columns))
        return [(row.wheelset, row.vehicle) for row in rows]

    def list_other(self, expected: Sequence[tuple[str, str, str]]) -> None:
        """List the windows whose signatures were not made with the digest expected of their wheelset and vehicle."""
        for some in batches(expected, TOGETHER):
            others = []
            for wheelset, vehicle, assumed in some:
                made = select(SIGNATURES.c.places).where(SAME, SIGNATURES.c.assumed == assumed)
                others.append(and_(WINDOWS.c.wheelset == wheelset, WINDOWS.c.vehicle == vehicle, ~made.exists()))
            list_due(self.connection, STAGE, and_(WINDOWS.c.samples_purged_ns.is_(None), or_(*others)))

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
        statement = select(SIGNATURES, newest.c.mileage_km).join_from(
            SIGNATURES, newest, same_window(newest, SIGNATURES)
        )
        statement = statement.where(newest.c.age <= NEWEST)
        rows = self.connection.execute(statement.order_by(SIGNATURES.c.wheelset, SIGNATURES.c.start_ns))
        readable, damaged = [], []
        for row in rows:
            try:
                signatures = unpack_signatures(row.packed, row.wheelset, row.start_ns)
                of_window = value_of_row(WindowSignatures, row, signatures=signatures)
                readable.append(KnownSignatures(of_window, row.mileage_km))
            except DamagedError as error:
                damaged.append((row.wheelset, row.start_ns, str(error)))
        return StoredSignatures(readable, damaged)

    def drop(self, keys: Sequence[WindowKey]) -> None:
        """Remove what is stored of windows, so that it is made again where their samples are there."""
        if keys:
            self.connection.execute(delete(SIGNATURES).where(KEY.in_(keys)))
            windows_changed(self.connection, keys, (STAGE,))


def _values(window: WindowSignatures) -> dict[str, object]:
    first = window.signatures[0] if window.signatures else None
    place = None if first is None else first.place
    return columns_of(window, "signatures") | {
        "section": None if place is None else place.section,
        "speed_band_m_s": None if first is None else SPEED_BAND * int(first.speed // SPEED_BAND),
        "places": len(window.signatures),
        "packed": pack_signatures(window.signatures),
    }

"""Numbers of track sections that are given up, so that another section can have them."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, func, select, update

from estimation.values.track import TrackSectionRecord
from fleet_db.locks import Subject, serialise
from fleet_db.registry_events import Decision, RecordAction, RecordKind
from fleet_db.rows import table_of
from fleet_db.stores.registry_history import RecordKey, RegistryHistoryStore
from fleet_db.tables import TrackSectionRow

SECTIONS = table_of(TrackSectionRow)


def free_numbers(history: RegistryHistoryStore, records: Sequence[TrackSectionRecord], recorded_ns: int | None) -> None:
    """Give up the numbers of sections that will get another one: sections may exchange theirs."""
    connection = history.connection
    serialise(connection, Subject.TRACKS)
    for record in records:
        was = connection.execute(select(SECTIONS).where(SECTIONS.c.code == record.code)).mappings().first()
        if was is not None and was["number"] > 0 and was["number"] != record.number:
            key = RecordKey(RecordKind.SECTION, record.code)
            decision = Decision(recorded_ns=recorded_ns)
            history.note(key, RecordAction.CHANGED, dict(was), decision)
            give_up_number(connection, record.code)


def give_up_number(connection: Connection, code: str) -> None:
    """Give a section a number that is on no bus."""
    lowest = connection.scalar(select(func.min(SECTIONS.c.number))) or 0
    connection.execute(update(SECTIONS).where(SECTIONS.c.code == code).values(number=min(lowest, 0) - 1))

"""Epochs of sections, and which version of an alignment each window is estimated on."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Select,
    Update,
    and_,
    bindparam,
    case,
    delete,
    func,
    insert,
    or_,
    select,
    update,
)

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import EpochMember, EpochNews, FoldState, FoundOfVehicles, TrackEpoch
from estimation.values.windows import WindowKey, WindowRecord, WindowState
from fleet_db.changes import Changes
from fleet_db.rows import insert_new, replace, table_of, upsert
from fleet_db.stores.window_marks import BATCH, keys_given
from fleet_db.stores.windows import to_window_record
from fleet_db.tables import (
    TrackEpochRow,
    TrackEpochVehicleRow,
    TrackEpochWindowRow,
    WindowBinTableRow,
    WindowPositionRow,
    WindowRow,
)

EPOCHS, MEMBERS, WINDOWS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow), table_of(WindowRow)
VEHICLES = table_of(TrackEpochVehicleRow)
POSITIONS, TABLES = table_of(WindowPositionRow), table_of(WindowBinTableRow)
OF_WINDOW = and_(MEMBERS.c.wheelset == WINDOWS.c.wheelset, MEMBERS.c.start_ns == WINDOWS.c.start_ns)
OF_EPOCH = and_(MEMBERS.c.section == EPOCHS.c.section, MEMBERS.c.epoch == EPOCHS.c.number)
PLACED = and_(
    POSITIONS.c.wheelset == MEMBERS.c.wheelset,
    POSITIONS.c.start_ns == MEMBERS.c.start_ns,
    POSITIONS.c.content_digest == MEMBERS.c.content_digest,
)
OF_TABLE = and_(TABLES.c.wheelset == WINDOWS.c.wheelset, TABLES.c.start_ns == WINDOWS.c.start_ns)
WITH_SAMPLES = WINDOWS.c.samples_purged_ns.is_(None)
SAME_CONTENT = WINDOWS.c.content_digest == MEMBERS.c.content_digest
BY_ALIGNMENT = (
    ReasonCode.ALIGNMENT_UNKNOWN,
    ReasonCode.NO_USABLE_SAMPLE,
    ReasonCode.INTERRUPTED,
    ReasonCode.TOO_FEW_USABLE,
    ReasonCode.IN_CURVES,
    ReasonCode.OUTSIDE_BINS,
)
"""Why a window may be refused on one version of an alignment and not on another."""

_LAST = EPOCHS.alias("last_epochs")
_NEWEST = (
    select(_LAST.c.section, func.max(_LAST.c.number).label("number"))
    .group_by(_LAST.c.section)
    .subquery("newest_epochs")
)
_FINAL = EPOCHS.alias("final_epochs")
_OF_VEHICLE = (
    select(func.max(VEHICLES.c.version))
    .where(VEHICLES.c.section == MEMBERS.c.section, VEHICLES.c.vehicle == MEMBERS.c.vehicle)
    .correlate(MEMBERS)
    .scalar_subquery()
)
_CHAIN = (
    MEMBERS.join(EPOCHS, OF_EPOCH)
    .join(_NEWEST, _NEWEST.c.section == MEMBERS.c.section)
    .join(_FINAL, and_(_FINAL.c.section == _NEWEST.c.section, _FINAL.c.number == _NEWEST.c.number))
)


def _newer(first: ColumnElement[Any], second: ColumnElement[Any]) -> ColumnElement[Any]:
    return case((first.is_(None), second), (second.is_(None), first), (first > second, first), else_=second)


_WANTED = _newer(_newer(EPOCHS.c.estimated_on, _FINAL.c.same_since), _OF_VEHICLE)


@cache
def _wanted() -> Select[Any]:
    columns = (MEMBERS.c.wheelset, MEMBERS.c.start_ns, _WANTED.label("wanted"))
    return select(*columns).select_from(_CHAIN).where(keys_given(MEMBERS))


@cache
def _refused() -> Update:
    this = (MEMBERS.c.wheelset == bindparam("of_wheelset"), MEMBERS.c.start_ns == bindparam("of_start_ns"))
    return update(MEMBERS).where(*this).values(estimated_version=bindparam("version"))


@dataclass(frozen=True, slots=True)
class EpochStore:
    """Implements ``estimation.storage.Epochs``."""

    connection: Connection
    changes: Changes

    def list(self, section: str) -> Sequence[TrackEpoch]:
        """Return the epochs of a section as they were computed last, in order."""
        rows = self.connection.execute(select(EPOCHS).where(EPOCHS.c.section == section).order_by(EPOCHS.c.number))
        return [_epoch(row) for row in rows]

    def news(self, section: str) -> EpochNews:
        """Return what has changed under the epochs of a section since they were computed."""
        return EpochNews(self._changed_from(section), frozenset({*self._unplaced(section), *self._torn(section)}))

    def remaining(self, section: str, number: int, limit: int) -> Sequence[WindowRecord]:
        """Return the first windows of a section that no epoch before ``number`` holds, by start and wheelset.

        Those whose samples have been purged are left out.
        """
        statement = (
            select(WINDOWS)
            .select_from(WINDOWS.outerjoin(MEMBERS, OF_WINDOW))
            .where(WINDOWS.c.track_section == section, WITH_SAMPLES)
            .where(or_(MEMBERS.c.epoch.is_(None), MEMBERS.c.section != section, MEMBERS.c.epoch >= number))
            .order_by(WINDOWS.c.start_ns, WINDOWS.c.wheelset)
            .limit(limit)
        )
        return self._records(statement)

    def windows(self, section: str, numbers: Collection[int]) -> Sequence[WindowRecord]:
        """Return the windows of some epochs, by start and wheelset."""
        statement = (
            select(WINDOWS)
            .join_from(WINDOWS, MEMBERS, OF_WINDOW)
            .where(MEMBERS.c.section == section, MEMBERS.c.epoch.in_(sorted(numbers)))
            .order_by(WINDOWS.c.start_ns, WINDOWS.c.wheelset)
        )
        return self._records(statement)

    def contexts(self, section: str) -> Sequence[tuple[str, str, str]]:
        """Return vehicle, wheelset and digest of what was on file of them, of the windows of all epochs."""
        columns = (MEMBERS.c.vehicle, MEMBERS.c.wheelset, MEMBERS.c.context)
        statement = select(*columns).where(MEMBERS.c.section == section).distinct().order_by(*columns)
        return [(row.vehicle, row.wheelset, row.context) for row in self.connection.execute(statement)]

    def members(self, section: str, vehicle: str, wheelset: str) -> Sequence[EpochMember]:
        """Return the windows of one wheelset on one vehicle, as the epochs hold them, oldest first."""
        statement = (
            select(WINDOWS, MEMBERS.c.context, MEMBERS.c.assumed)
            .join_from(WINDOWS, MEMBERS, OF_WINDOW)
            .where(MEMBERS.c.section == section, MEMBERS.c.vehicle == vehicle, MEMBERS.c.wheelset == wheelset)
            .order_by(WINDOWS.c.start_ns)
        )
        rows = self.connection.execute(statement)
        return [EpochMember(to_window_record(row), row.context, row.assumed) for row in rows]

    def note_context(self, section: str, vehicle: str, wheelset: str, context: str) -> None:
        """Record that what is on file of a wheelset changes nothing for the windows of a section."""
        same = (MEMBERS.c.section == section, MEMBERS.c.vehicle == vehicle, MEMBERS.c.wheelset == wheelset)
        self.connection.execute(update(MEMBERS).where(*same).values(context=context))

    def put(self, epoch: TrackEpoch, members: Sequence[EpochMember]) -> None:
        """Store an epoch with its windows, in the place of what was known of it; no other epoch holds them then.

        Its windows count as placed where their positions are stored.
        """
        self.changes.on_section(epoch.section)
        upsert(self.connection, EPOCHS, _values(epoch))
        of_epoch = and_(MEMBERS.c.section == epoch.section, MEMBERS.c.epoch == epoch.number)
        held = self.connection.execute(select(MEMBERS.c.wheelset, MEMBERS.c.start_ns).where(of_epoch))
        gone = {(row.wheelset, row.start_ns) for row in held}
        gone -= {(member.record.wheelset, member.record.start_ns) for member in members}
        for wheelset, start_ns in sorted(gone):
            self.connection.execute(
                delete(MEMBERS).where(MEMBERS.c.wheelset == wheelset, MEMBERS.c.start_ns == start_ns)
            )
        for member in members:
            self._put_member(epoch, member)
        self.note_placed(epoch.section)

    def put_found(self, section: str, number: int, found: FoundOfVehicles | None) -> None:
        """Store of which vehicles an epoch has found what matters for them alone, in the place of what was known."""
        self.changes.on_section(section)
        of_epoch = (VEHICLES.c.section == section, VEHICLES.c.epoch == number)
        self.connection.execute(delete(VEHICLES).where(*of_epoch))
        if found is None:
            return
        for vehicle, ratio in found.stiffness_ratio.items():
            values = {"section": section, "epoch": number, "vehicle": vehicle, "version": found.version}
            self.connection.execute(insert(VEHICLES).values(**values, stiffness_ratio=ratio))

    def found(self, section: str, number: int, since: int) -> Mapping[str, float]:
        """Return the stiffness ratios that epochs before ``number`` have found of vehicles in versions after ``since``.

        Of each vehicle the newest.
        """
        statement = (
            select(VEHICLES.c.vehicle, VEHICLES.c.stiffness_ratio)
            .where(VEHICLES.c.section == section, VEHICLES.c.epoch < number, VEHICLES.c.version > since)
            .order_by(VEHICLES.c.epoch)
        )
        return {row.vehicle: row.stiffness_ratio for row in self.connection.execute(statement)}

    def note_placed(self, section: str) -> None:
        """Record of the windows of all epochs of a section whose positions are stored that they are."""
        placed = select(POSITIONS.c.wheelset).where(PLACED).exists()
        self.connection.execute(
            update(MEMBERS).where(MEMBERS.c.section == section, ~MEMBERS.c.placed, placed).values(placed=True)
        )

    def start_again(self, section: str, number: int = 0) -> int:
        """Forget the epochs of a section behind ``number``, so that they are computed again; return of how many.

        What they have made stays in force until then.
        """
        self.changes.on_section(section)
        for table in (MEMBERS, VEHICLES):
            self.connection.execute(delete(table).where(table.c.section == section, table.c.epoch > number))
        behind = delete(EPOCHS).where(EPOCHS.c.section == section, EPOCHS.c.number > number)
        return int(self.connection.execute(behind).rowcount)

    def alignment_version(self, wheelset: str, start_ns: int, in_force: int | None) -> int | None:
        """Return the version of the alignment that a window is estimated on; ``in_force`` where no epoch holds it.

        It is that of its epoch, or the oldest from which the last does not differ materially, if that is newer, or the
        newest that holds what was found of its vehicle alone.
        """
        return self.alignment_versions([(wheelset, start_ns)]).get((wheelset, start_ns), in_force)

    def alignment_versions(self, keys: Sequence[WindowKey]) -> Mapping[WindowKey, int | None]:
        """Return by wheelset and start the versions of :meth:`alignment_version` of those windows that epochs hold."""
        found = {}
        for first in range(0, len(keys), BATCH):
            for row in self.connection.execute(_wanted(), {"keys": keys[first : first + BATCH]}):
                found[row.wheelset, row.start_ns] = row.wanted
        return found

    def note_refused(self, wheelset: str, start_ns: int, version: int | None) -> None:
        """Record on which version of the alignment a window has been refused."""
        self.note_all_refused({(wheelset, start_ns): version})

    def note_all_refused(self, versions: Mapping[WindowKey, int | None]) -> None:
        """Record by wheelset and start on which versions of their alignments windows have been refused."""
        rows = [{"of_wheelset": key[0], "of_start_ns": key[1], "version": version} for key, version in versions.items()]
        if rows:
            self.connection.execute(_refused(), rows)

    def outdated(self, sections: Collection[str]) -> Sequence[tuple[str, int]]:
        """Return (wheelset, start) of windows on some sections that were estimated on another version than wanted."""
        table = and_(
            WINDOWS.c.state == WindowState.ESTIMATED.value,
            WINDOWS.c.table_purged_ns.is_(None),
            TABLES.c.track_version.is_distinct_from(_WANTED),
        )
        refused = and_(
            WINDOWS.c.state == WindowState.REFUSED.value,
            WINDOWS.c.reason_code.in_([code.value for code in BY_ALIGNMENT]),
            MEMBERS.c.estimated_version.is_distinct_from(_WANTED),
        )
        statement = (
            select(WINDOWS.c.wheelset, WINDOWS.c.start_ns)
            .select_from(_CHAIN.join(WINDOWS, and_(OF_WINDOW, SAME_CONTENT)).outerjoin(TABLES, OF_TABLE))
            .where(MEMBERS.c.section.in_(sorted(sections)))
            .where(or_(table, refused), or_(WITH_SAMPLES, WINDOWS.c.passed_over.is_(None)))
            .order_by(WINDOWS.c.wheelset, WINDOWS.c.start_ns)
        )
        return [(row.wheelset, row.start_ns) for row in self.connection.execute(statement)]

    def _put_member(self, epoch: TrackEpoch, member: EpochMember) -> None:
        record = member.record
        values = {
            "wheelset": record.wheelset,
            "start_ns": record.start_ns,
            "section": epoch.section,
            "epoch": epoch.number,
            "vehicle": record.vehicle,
            "content_digest": record.content_digest,
            "mileage_km": record.mileage_km,
            "context": member.context,
            "assumed": member.assumed,
            "placed": False,
        }
        if not insert_new(self.connection, MEMBERS, values):
            same = (MEMBERS.c.wheelset == record.wheelset, MEMBERS.c.start_ns == record.start_ns)
            self.changes.on_section(self.connection.scalar(select(MEMBERS.c.section).where(*same)))
            replace(self.connection, MEMBERS, values)

    def _changed_from(self, section: str) -> int | None:
        """Return the start of the first window that is new, changed or gone.

        What comes so late that samples of later windows have been purged joins the next epoch, and none is computed
        again for it.
        """
        changed = or_(
            MEMBERS.c.wheelset.is_(None),
            MEMBERS.c.section != section,
            MEMBERS.c.content_digest != WINDOWS.c.content_digest,
            MEMBERS.c.mileage_km != WINDOWS.c.mileage_km,
            MEMBERS.c.vehicle != WINDOWS.c.vehicle,
        )
        come = (
            select(func.min(WINDOWS.c.start_ns))
            .select_from(WINDOWS.outerjoin(MEMBERS, OF_WINDOW))
            .where(WINDOWS.c.track_section == section, changed, WITH_SAMPLES)
        )

        gone = (
            select(func.min(MEMBERS.c.start_ns))
            .select_from(MEMBERS.outerjoin(WINDOWS, OF_WINDOW))
            .where(MEMBERS.c.section == section, WINDOWS.c.track_section.is_distinct_from(section))
        )
        found = [self.connection.scalar(statement) for statement in (come, gone)]
        if found[0] is not None:
            purged = select(func.max(WINDOWS.c.start_ns)).where(WINDOWS.c.track_section == section, ~WITH_SAMPLES)
            horizon_ns = self.connection.scalar(purged)
            if horizon_ns is not None and found[0] <= horizon_ns:
                held = or_(WINDOWS.c.start_ns > horizon_ns, MEMBERS.c.wheelset.is_not(None))
                found[0] = self.connection.scalar(come.where(held))
        return min((start_ns for start_ns in found if start_ns is not None), default=None)

    def _unplaced(self, section: str) -> set[int]:
        """Return the epochs with windows whose positions have been forgotten."""
        statement = (
            select(MEMBERS.c.epoch)
            .select_from(MEMBERS.outerjoin(POSITIONS, PLACED))
            .where(MEMBERS.c.section == section, MEMBERS.c.placed, POSITIONS.c.wheelset.is_(None))
            .distinct()
        )
        return set(self.connection.scalars(statement))

    def _torn(self, section: str) -> set[int]:
        """Return the epochs that have lost windows to others."""
        counted = func.count(MEMBERS.c.wheelset)
        statement = (
            select(EPOCHS.c.number)
            .select_from(EPOCHS.outerjoin(MEMBERS, OF_EPOCH))
            .where(EPOCHS.c.section == section)
            .group_by(EPOCHS.c.number, EPOCHS.c.windows)
            .having(counted != EPOCHS.c.windows)
        )
        return set(self.connection.scalars(statement))

    def _records(self, statement: Select[Any]) -> Sequence[WindowRecord]:
        return [to_window_record(row) for row in self.connection.execute(statement)]


def _values(epoch: TrackEpoch) -> dict[str, Any]:
    survey = epoch.after.survey
    return {
        "section": epoch.section,
        "number": epoch.number,
        "before": epoch.before,
        "input_digest": epoch.input_digest,
        "horizon_ns": epoch.horizon_ns,
        "windows": epoch.windows,
        "waits": epoch.waits,
        "version": epoch.after.version,
        "same_since": epoch.after.same_since,
        "estimated_on": epoch.estimated_on,
        "survey": "" if survey is None else survey.text,
        "survey_code": None if survey is None else survey.code.value,
        "report": epoch.report,
        "recorded_ns": epoch.recorded_ns,
    }


def _epoch(row: Any) -> TrackEpoch:  # noqa: ANN401 - a row of EPOCHS
    survey = None if row.survey_code is None else Reason(ReasonCode(row.survey_code), row.survey)
    return TrackEpoch(
        section=row.section,
        number=row.number,
        before=row.before,
        input_digest=row.input_digest,
        horizon_ns=row.horizon_ns,
        windows=row.windows,
        waits=row.waits,
        after=FoldState(row.version, row.same_since, survey),
        estimated_on=row.estimated_on,
        report=row.report,
        recorded_ns=row.recorded_ns,
    )

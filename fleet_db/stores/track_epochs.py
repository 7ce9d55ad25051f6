"""Epochs of sections, and which version of an alignment each window is estimated on."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Select,
    Update,
    and_,
    bindparam,
    case,
    delete,
    exists,
    func,
    insert,
    or_,
    select,
    tuple_,
    union,
    union_all,
    update,
)

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Facet, SubjectKind
from estimation.values.track import EpochMember, FoldState, FoundOfVehicles, HeldWindow, ListedWindow, TrackEpoch
from estimation.values.windows import DueStage, WindowKey, WindowRecord, WindowState
from fleet_db.due import DUE, OF_WINDOW, list_due, stale_epochs
from fleet_db.rows import batches, columns_of, keys_given, put_rows, same_window, table_of, value_of_row
from fleet_db.stores.window_rows import to_window_record
from fleet_db.subjects import RaisingStore
from fleet_db.tables.track import TrackEpochRow, TrackEpochVehicleRow, TrackEpochWindowRow
from fleet_db.tables.windows import WindowBinTableRow, WindowRow

EPOCHS, MEMBERS, WINDOWS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow), table_of(WindowRow)
VEHICLES = table_of(TrackEpochVehicleRow)
TABLES = table_of(WindowBinTableRow)
OF_EPOCH = and_(MEMBERS.c.section == EPOCHS.c.section, MEMBERS.c.epoch == EPOCHS.c.number)
OF_TABLE = same_window(TABLES, WINDOWS)
WITH_SAMPLES = WINDOWS.c.samples_purged_ns.is_(None)
HELD = [item.name for item in fields(HeldWindow)]
LISTED_AT_ONCE = 64
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


class EpochStore(RaisingStore):
    """Epochs of sections in vehicle time, each as it was computed last, and what has changed under them since."""

    def list(self, section: str) -> Sequence[TrackEpoch]:
        """Return the epochs of a section as they were computed last, in order."""
        epochs = []
        for row in self.connection.execute(select(EPOCHS).where(EPOCHS.c.section == section).order_by(EPOCHS.c.number)):
            survey = None if row.survey_code is None else Reason(ReasonCode(row.survey_code), row.survey)
            epochs.append(value_of_row(TrackEpoch, row, after=FoldState(row.version, row.same_since, survey)))
        return epochs

    def listed(self, section: str) -> Iterator[ListedWindow]:
        """Yield the windows of a section that its epochs may not hold as they are now, oldest first."""
        after = (-1, "")
        while rows := self.connection.execute(_of_listed(section, after)).all():
            after = (rows[-1].due_start_ns, rows[-1].due_wheelset)
            for row in rows:
                record = None if row.wheelset is None else to_window_record(row)
                held = HeldWindow(*(getattr(row, f"held_{name}") for name in HELD))
                yield ListedWindow(row.due_start_ns, record, None if row.held_section is None else held)

    def purged_until(self, section: str) -> int | None:
        """Return the start of the last window of a section whose samples have been purged."""
        purged = select(func.max(WINDOWS.c.start_ns)).where(WINDOWS.c.track_section == section, ~WITH_SAMPLES)
        start_ns: int | None = self.connection.scalar(purged)
        return start_ns

    def list_again(self, section: str, keys: Sequence[WindowKey]) -> None:
        """List windows of a section that are looked at otherwise now, for what is on file of them has changed."""
        for some in batches(keys):
            list_due(self.connection, DueStage.ALIGNMENT, keys_given(WINDOWS), keys=some)
        if keys:
            self.subjects.raised(SubjectKind.SECTION, section, Facet.WINDOWS)

    def remaining(self, section: str, number: int, limit: int) -> Sequence[WindowRecord]:
        """Return the first windows of a section that no epoch before ``number`` holds, by start and wheelset.

        Those whose samples have been purged are left out. Windows that no epoch holds are listed, so that those before
        the first of these and of the epochs behind are not read.
        """
        listed = select(func.min(DUE.c.start_ns).label("start_ns")).where(*_listed(section))
        behind = select(func.min(MEMBERS.c.start_ns)).where(MEMBERS.c.section == section, MEMBERS.c.epoch >= number)
        first_ns = select(func.min(union_all(listed, behind).subquery().c.start_ns)).scalar_subquery()
        statement = (
            select(WINDOWS)
            .select_from(WINDOWS.outerjoin(MEMBERS, OF_WINDOW))
            .where(WINDOWS.c.track_section == section, WINDOWS.c.start_ns >= first_ns, WITH_SAMPLES)
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

        Windows that it held before are listed; another epoch that has held some of its windows is stale.
        """
        self.subjects.places(epoch.section)
        put_rows(self.connection, EPOCHS, [_values(epoch)])
        of_epoch = and_(MEMBERS.c.section == epoch.section, MEMBERS.c.epoch == epoch.number)
        keys = {member.record.key for member in members}
        before = self._held(of_epoch, sorted(keys))
        self._let_go(epoch.section, sorted(before.keys() - keys), of_epoch)
        elsewhere = set(before.values()) - {(epoch.section, epoch.number)}
        for section, _ in sorted(elsewhere):
            self.subjects.places(section)
        stale_epochs(self.subjects, sorted(elsewhere))
        rows = [
            {
                "wheelset": member.record.wheelset,
                "start_ns": member.record.start_ns,
                "section": epoch.section,
                "epoch": epoch.number,
                "vehicle": member.record.vehicle,
                "content_digest": member.record.content_digest,
                "mileage_km": member.record.mileage_km,
                "context": member.context,
                "assumed": member.assumed,
            }
            for member in sorted(members, key=lambda member: member.record.key)
        ]
        put_rows(self.connection, MEMBERS, rows)

    def stale(self, section: str, number: int) -> None:
        """Let an epoch be computed again, where it is there."""
        stale_epochs(self.subjects, [(section, number)])

    def put_found(self, section: str, number: int, of_vehicles: FoundOfVehicles | None) -> None:
        """Store of which vehicles an epoch has found what matters for them alone, in the place of what was known."""
        self.subjects.places(section)
        of_epoch = (VEHICLES.c.section == section, VEHICLES.c.epoch == number)
        self.connection.execute(delete(VEHICLES).where(*of_epoch))
        if of_vehicles is None:
            return
        for vehicle, ratio in of_vehicles.stiffness_ratio.items():
            values = {"section": section, "epoch": number, "vehicle": vehicle, "version": of_vehicles.version}
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

    def start_again(self, section: str, number: int = 0) -> int:
        """Forget the epochs of a section behind ``number``, so that they are computed again; return of how many.

        What they have made stays in force until then.
        """
        self.subjects.places(section)
        self.subjects.raised(SubjectKind.SECTION, section, Facet.WINDOWS)
        behind = (MEMBERS.c.section == section, MEMBERS.c.epoch > number)
        held = and_(WINDOWS.c.track_section == section, WITH_SAMPLES, exists().where(OF_WINDOW, *behind))
        list_due(self.connection, DueStage.ALIGNMENT, held)
        for table in (MEMBERS, VEHICLES):
            self.connection.execute(delete(table).where(table.c.section == section, table.c.epoch > number))
        gone = delete(EPOCHS).where(EPOCHS.c.section == section, EPOCHS.c.number > number)
        return int(self.connection.execute(gone).rowcount)

    def alignment_versions(self, keys: Sequence[WindowKey]) -> Mapping[WindowKey, int | None]:
        """Return by wheelset and start the versions of the alignment on which windows are estimated that epochs hold.

        It is that of its epoch, or the oldest from which the last does not differ materially, if that is newer, or the
        newest that holds what was found of its vehicle alone.
        """
        rows = (row for some in batches(keys) for row in self.connection.execute(_wanted(), {"keys": some}))
        return {(row.wheelset, row.start_ns): row.wanted for row in rows}

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

    def _let_go(self, section: str, keys: Sequence[WindowKey], of_epoch: ColumnElement[bool]) -> None:
        """Forget that an epoch holds some windows; those that are still there are listed."""
        if keys:
            self.subjects.raised(SubjectKind.SECTION, section, Facet.WINDOWS)
        for some in batches(keys):
            there = and_(WINDOWS.c.track_section == section, WITH_SAMPLES, keys_given(WINDOWS))
            list_due(self.connection, DueStage.ALIGNMENT, there, keys=some)
            self.connection.execute(delete(MEMBERS).where(of_epoch, keys_given(MEMBERS)), {"keys": some})

    def _held(self, of_epoch: ColumnElement[bool], keys: Sequence[WindowKey]) -> dict[WindowKey, tuple[str, int]]:
        """Return section and number of the epochs that hold some windows, with all windows of one epoch."""
        columns = (MEMBERS.c.wheelset, MEMBERS.c.start_ns, MEMBERS.c.section, MEMBERS.c.epoch)
        held: dict[WindowKey, tuple[str, int]] = {}
        statement = union(select(*columns).where(of_epoch), select(*columns).where(keys_given(MEMBERS)))
        for some in batches(keys) if keys else [keys]:
            rows = self.connection.execute(statement, {"keys": some})
            held.update({(row.wheelset, row.start_ns): (row.section, row.epoch) for row in rows})
        return held

    def _records(self, statement: Select[Any]) -> Sequence[WindowRecord]:
        return [to_window_record(row) for row in self.connection.execute(statement)]


def _listed(section: str) -> tuple[ColumnElement[bool], ...]:
    return DUE.c.stage == DueStage.ALIGNMENT.value, DUE.c.section == section


def _of_listed(section: str, after: tuple[int, str]) -> Select[Any]:
    """Return the statement of the next listed windows of a section, as they are stored and as epochs hold them."""
    held = [MEMBERS.c[name].label(f"held_{name}") for name in HELD]
    key = (DUE.c.start_ns, DUE.c.wheelset)
    return (
        select(DUE.c.start_ns.label("due_start_ns"), DUE.c.wheelset.label("due_wheelset"), *WINDOWS.columns, *held)
        .select_from(DUE.outerjoin(WINDOWS, same_window(WINDOWS, DUE)).outerjoin(MEMBERS, same_window(MEMBERS, DUE)))
        .where(*_listed(section), tuple_(*key) > tuple_(*after))
        .order_by(*key)
        .limit(LISTED_AT_ONCE)
    )


def _values(epoch: TrackEpoch) -> dict[str, Any]:
    survey = epoch.after.survey
    return {
        **columns_of(epoch, "after"),
        **columns_of(epoch.after, "survey"),
        "stale": False,
        "survey": "" if survey is None else survey.text,
        "survey_code": None if survey is None else survey.code.value,
    }

"""Rows of windows: read and written, and the states of many at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    FromClause,
    Row,
    String,
    and_,
    delete,
    exists,
    literal,
    or_,
    select,
    union_all,
    update,
)

from estimation.errors import NotFoundError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import (
    NO_BLOWS,
    NOT_HUNTING,
    DueStage,
    Hunting,
    PassedOver,
    TurnBlows,
    Window,
    WindowKey,
    WindowMark,
    WindowQuality,
    WindowRecord,
    WindowState,
)
from fleet_db.due import estimated, list_due, list_to_estimate, list_waiting
from fleet_db.rows import (
    batches,
    keys_given,
    nan_if_null,
    null_if_nan,
    reason_columns,
    replace_all,
    same_window,
    stored_reason,
    table_of,
)
from fleet_db.subjects import Subjects
from fleet_db.tables.registry import WheelsetRow
from fleet_db.tables.windows import DOUBTED, PASSED_OVER, REFUSED, WindowBinTableRow, WindowRow

WINDOWS, TABLES, WHEELSETS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(WheelsetRow)
OF_WINDOW = ("wheelset", "start_ns", "length_ns", "vehicle", "axle", "track_section")
NOTED = {  # each by an index of its own, whose condition is word for word the same
    "reason_code": and_(REFUSED),
    "passed_over": and_(PASSED_OVER),
    "implausible_code": and_(DOUBTED),
}
NOTED_OF = "noted of windows"  # kind of what a transaction has read
REALS = (
    "coverage",
    "longest_gap_s",
    "clipped",
    "invalid",
    "speed_min_m_s",
    "speed_max_m_s",
    "position_quality",
)


def noted_columns() -> list[ColumnElement[bool]]:
    """Return for a statement on wheelsets which columns of ``NOTED`` are not null in one of their windows."""
    of_wheelset = WINDOWS.c.wheelset == WHEELSETS.c.serial
    return [exists().where(of_wheelset, condition).label(name) for name, condition in NOTED.items()]


def noted_in(row: Row[Any]) -> frozenset[str]:
    """Return the names of the columns of :func:`noted_columns` in a row that are true."""
    return frozenset(name for name in NOTED if getattr(row, name))


def spans_given(spans: Iterable[tuple[str, int, int | None]]) -> FromClause:
    """Return spans as a table: ``of_wheelset``, ``from_ns`` and ``to_ns``."""
    rows = (
        select(
            literal(wheelset, String).label("of_wheelset"),
            literal(from_ns, BigInteger).label("from_ns"),
            literal(to_ns, BigInteger).label("to_ns"),
        )
        for wheelset, from_ns, to_ns in spans
    )
    return union_all(*rows).subquery("spans")


def mark_all(
    connection: Connection,
    subjects: Subjects,
    marks: Sequence[WindowMark],
    standing: Mapping[WindowKey, WindowRecord],
    tabled: Sequence[WindowKey],
) -> list[WindowMark]:
    """Set states of windows; those that are refused lose their bin tables. Return those that have their states now.

    A window whose samples have been purged stays as it is; that it was to change is noted. NotFoundError: one is gone.
    """
    held, changed, gone = [], [], []
    for mark in marks:
        before = standing.get(mark.key)
        if before is None:
            raise NotFoundError("window", f"{mark.wheelset}@{mark.start_ns}")
        same = before.state is mark.state and before.reason == mark.reason
        if not same and before.samples_purged:
            this = and_(WINDOWS.c.wheelset == mark.wheelset, WINDOWS.c.start_ns == mark.start_ns)
            if pass_over(connection, this, PassedOver.SUPERSEDED):
                subjects.tables(mark.wheelset)
            continue
        held.append(mark)
        if not same:
            subjects.places(before.track_section)
            after = {"state": mark.state.value, **reason_columns(mark.reason)}
            changed.append({"wheelset": mark.wheelset, "start_ns": mark.start_ns, **after})
            if mark.state is WindowState.REFUSED:
                gone.append(mark.key)
            if before.state is not mark.state:
                subjects.tables(mark.wheelset)
            if WindowState.REFUSED in {before.state, mark.state}:  # else the newest usable one stays
                subjects.windows(mark.wheelset)
    replace_all(connection, WINDOWS, changed)
    list_waiting(connection, [mark.key for mark in held if mark.state is WindowState.PENDING])
    made = {mark.key: None for mark in held if mark.state is WindowState.ESTIMATED}
    estimated(connection, list(made), tabled)
    list_for_sums(connection, [key for key in tabled if key not in made])
    remove_tables(connection, subjects, gone)
    return held


def wait_again(subjects: Subjects, chosen: ColumnElement[bool], what: PassedOver) -> None:
    """Let chosen windows wait to be estimated again; those without samples stay, and ``what`` is noted of them."""
    touched = select(WINDOWS.c.wheelset, WINDOWS.c.track_section).where(chosen).distinct()
    for wheelset, section in subjects.connection.execute(touched):
        subjects.tables(wheelset)
        subjects.windows(wheelset)
        subjects.places(section)
    list_to_estimate(subjects.connection, chosen)
    pass_over(subjects.connection, and_(chosen, WINDOWS.c.samples_purged_ns.is_not(None)), what)


def remove_tables(connection: Connection, subjects: Subjects, keys: Sequence[WindowKey]) -> None:
    """Remove the bin tables of some windows, where there are any."""
    for some in batches(keys):
        tabled = [(row.wheelset, row.start_ns) for row in connection.execute(TABLED, {"keys": some})]
        list_for_sums(connection, tabled)
        if tabled:
            connection.execute(delete(TABLES).where(keys_given(TABLES)), {"keys": tabled})
        for wheelset, _ in tabled:
            subjects.tables(wheelset)


def list_for_sums(connection: Connection, keys: Sequence[WindowKey]) -> None:
    """List windows whose bin table or its mileage is another, or is about to be removed: they are summed again."""
    tabled = exists().where(same_window(TABLES, WINDOWS))
    for some in batches(keys):
        list_due(connection, DueStage.SUMS, and_(keys_given(WINDOWS), tabled), keys=some)


def pass_over(connection: Connection, chosen: ColumnElement[bool], what: PassedOver) -> int:
    """Note what would have changed windows that stay as they are; return of how many it was not known.

    That a table is wrong stands before the rest.
    """
    weaker = [cause.value for cause in PassedOver][: list(PassedOver).index(what)]
    open_ = or_(WINDOWS.c.passed_over.is_(None), WINDOWS.c.passed_over.in_(weaker))
    noted = update(WINDOWS).where(chosen, open_).values(passed_over=what.value)
    return connection.execute(noted.execution_options(preserve_rowcount=True)).rowcount


TABLED = select(TABLES.c.wheelset, TABLES.c.start_ns).where(keys_given(TABLES)).order_by(*TABLES.primary_key)


def to_window_record(row: Row[Any]) -> WindowRecord:
    """Return the value of a row of windows."""
    hunting, blows = NOT_HUNTING, NO_BLOWS
    if row.hunting_share:
        hunting = Hunting(row.hunting_share, row.hunting_hz or 0.0, row.hunting_amplitude_m or 0.0)
    if row.blows_share:
        blows = TurnBlows(row.blows_share, row.blows_m_s2 or 0.0, row.blows_turn_m or 0.0, row.blows_side or 0)
    return WindowRecord(
        wheelset=row.wheelset,
        start_ns=row.start_ns,
        length_ns=row.length_ns,
        vehicle=row.vehicle,
        axle=row.axle,
        track_section=row.track_section,
        mileage_km=row.mileage_km,
        quality=WindowQuality(
            **{name: nan_if_null(getattr(row, name)) for name in REALS},
            gaps=row.gaps,
            sensor_fault=row.sensor_fault,
            hunting=hunting,
            blows=blows,
        ),
        state=WindowState(row.state),
        reason=stored_reason(row),
        content_digest=row.content_digest,
        recorded_ns=row.recorded_ns,
        implausible=implausible_reason(row),
        samples_purged=row.samples_purged_ns is not None,
    )


def implausible_reason(row: Any) -> Reason | None:  # noqa: ANN401 - a row of windows, whatever was selected
    """Return why the mileage of a row of windows is not believed; None where it is."""
    return None if row.implausible_code is None else Reason(ReasonCode(row.implausible_code), row.implausible)


def window_values(window: Window, mileage_km: float) -> dict[str, object]:
    """Return what the row of a window that waits to be estimated holds of it, without its file."""
    return {
        **{name: getattr(window, name) for name in OF_WINDOW},
        "mileage_km": mileage_km,
        **{name: null_if_nan(getattr(window.quality, name)) for name in REALS},
        "gaps": window.quality.gaps,
        "sensor_fault": window.quality.sensor_fault,
        "hunting_share": window.quality.hunting.share,
        "hunting_hz": window.quality.hunting.frequency_hz,
        "hunting_amplitude_m": window.quality.hunting.amplitude,
        "blows_share": window.quality.blows.share,
        "blows_m_s2": window.quality.blows.size,
        "blows_turn_m": window.quality.blows.turn_m,
        "blows_side": window.quality.blows.side,
        "state": WindowState.PENDING.value,
        **reason_columns(None),
    }

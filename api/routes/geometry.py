"""What is estimated of a wheelset: bin table and trend; the windows behind them; and both over its life."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fastapi import APIRouter, Response

from api.answers import answer_payload, table_payload
from api.asking import (
    Asked,
    AskedDep,
    AskedListDep,
    AsOf,
    MeasuredFrom,
    MeasuredTo,
    Serial,
    not_in_the_future,
    not_purged,
    require_order,
)
from api.contract import TABLE, Accepted
from api.problems import described
from api.schemas import geometry, trend, windows
from api.schemas.common import Page
from api.schemas.windows import WindowReasons
from api.services import Services
from api.times import to_rfc3339
from estimation.errors import NotFoundError
from estimation.trend.now import NO_TREND
from estimation.values.alerts import LimitNow, MileageNow
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import FleetWear, TrendRecord
from fleet_db.keeping.purge import purged_before
from fleet_db.keeping.retention import Kept
from fleet_db.packed_values import from_document
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.window_counts import window_counts

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])
NOT_KEPT = b""  # stands among the kept representations for one that is made each time


@router.get("/{serial}/geometry", response_model=geometry.Geometry, responses={**described(404, 410), **TABLE})
def get_geometry(asked: AskedDep, accepted: Accepted, serial: Serial, as_of: AsOf = None) -> Response:
    """Return the wheelset's bin table and the conicity that follows; as `text/csv`, the bin table alone."""
    return _at_time(asked, accepted, serial, as_of, _geometry_now, _geometry_then)


def _at_time(
    asked: Asked,
    media_type: str,
    serial: str,
    as_of_ns: int | None,
    now: Callable[[SqlUnitOfWork, Services, str, str], bytes],
    then: Callable[[SqlUnitOfWork, str, str, int], bytes],
) -> Response:
    not_in_the_future(as_of_ns, asked.services.clock.now_ns())
    with asked.read() as unit:
        if as_of_ns is None:
            payload = now(unit, asked.services, serial, media_type)
        else:
            payload = then(unit, serial, media_type, as_of_ns)
    return answer_payload(asked.request, payload, media_type)


def _geometry_now(unit: SqlUnitOfWork, services: Services, serial: str, media_type: str) -> bytes:
    """Return what is estimated now; that nothing is changes with the windows, and is not kept."""
    version = unit.geometries.version(serial)
    if version is not None:
        key = ("geometry", serial, media_type, version, unit.trends.version(serial))
        payload = services.cache.get_or_make(key, partial(_estimated_geometry, unit, serial, media_type))
        if payload != NOT_KEPT:
            return payload
    current = unit.geometries.current(serial)
    with_windows = current is not None and current.geometry.windows > 0
    why = WindowReasons(unit).without_estimate(serial, current.geometry.reason if with_windows and current else None)
    if current is not None:
        return table_payload(geometry.geometry(current, why, _fleet(unit, current)), media_type, geometry.table)
    baseline = len(unit.registry.wheelset(serial).reprofilings)
    return table_payload(geometry.no_geometry(serial, baseline, why.reason, why), media_type, geometry.table)


def _estimated_geometry(unit: SqlUnitOfWork, serial: str, media_type: str) -> bytes:
    current = unit.geometries.current(serial)
    if current is None or current.geometry.status is Status.UNESTIMATED:
        return NOT_KEPT
    return table_payload(geometry.geometry(current, fleet=_fleet(unit, current)), media_type, geometry.table)


def _fleet(unit: SqlUnitOfWork, record: GeometryRecord, as_of_ns: int | None = None) -> FleetWear | None:
    """Return what the trend of a wheelset knows of those like it; None where it is of another profile."""
    latest = unit.trends.latest(record.wheelset, as_of_ns)
    return latest.trend.fleet if latest is not None and latest.baseline == record.baseline else None


def _geometry_then(unit: SqlUnitOfWork, serial: str, media_type: str, as_of_ns: int) -> bytes:
    baseline = _baseline(unit, serial, as_of_ns)
    then = unit.geometries.current(serial, as_of_ns)
    if then is None:
        reason = _nothing_until("geometry", as_of_ns)
        return table_payload(geometry.no_geometry(serial, baseline, reason), media_type, geometry.table)
    fleet = _fleet(unit, then, as_of_ns)
    return table_payload(geometry.geometry(then, fleet=fleet), media_type, geometry.table)


@router.get("/{serial}/trend", response_model=trend.Trend, responses={**described(404, 410), **TABLE})
def get_trend(asked: AskedDep, accepted: Accepted, serial: Serial, as_of: AsOf = None) -> Response:
    """Return the wheelset's trend since its last reprofiling; as `text/csv`, its points alone."""
    return _at_time(asked, accepted, serial, as_of, _trend_now, _trend_then)


def _trend_now(unit: SqlUnitOfWork, services: Services, serial: str, media_type: str) -> bytes:
    """Return the trend now; why there is no geometry for one changes with the windows, and is not kept."""
    version, document = unit.trends.version(serial), _row(unit, serial)
    if version[0] is not None:
        key = ("trend", serial, media_type, version, document)
        payload = services.cache.get_or_make(key, partial(_trend_of_geometry, unit, serial, media_type, document))
        if payload != NOT_KEPT:
            return payload
    baseline, now = len(unit.registry.wheelset(serial).reprofilings), _believed(document)
    current = unit.geometries.current(serial)
    latest = _of_profile(unit.trends.latest(serial), current)
    has_windows = current is not None and current.geometry.windows > 0
    why = None if has_windows else WindowReasons(unit).without_estimate(serial)
    if latest is not None:
        return table_payload(trend.trend(latest, current, now, why), media_type, trend.table)
    reason = NO_TREND if why is None else why.reason
    return table_payload(trend.no_trend(serial, baseline, reason, current, now, why), media_type, trend.table)


def _row(unit: SqlUnitOfWork, serial: str) -> str | None:
    """Return the row of the worklist; None of a voided wheelset, which has none."""
    try:
        return unit.worklist.row(serial)
    except NotFoundError:
        return None


def _believed(document: str | None) -> LimitNow | None:
    return None if document is None else from_document(document).state


def _trend_of_geometry(unit: SqlUnitOfWork, serial: str, media_type: str, document: str | None) -> bytes:
    current = unit.geometries.current(serial)
    latest = _of_profile(unit.trends.latest(serial), current)
    if latest is None or current is None or not current.geometry.windows:
        return NOT_KEPT
    return table_payload(trend.trend(latest, current, _believed(document)), media_type, trend.table)


def _of_profile(latest: TrendRecord | None, current: GeometryRecord | None) -> TrendRecord | None:
    """Return the latest trend; None where the geometry is of a later profile already."""
    # times on file are the vehicle's, and ``as_of`` is ours: what was recorded says which profile is the present one
    return None if latest is None or (current is not None and latest.baseline < current.baseline) else latest


def _trend_then(unit: SqlUnitOfWork, serial: str, media_type: str, as_of_ns: int) -> bytes:
    baseline = _baseline(unit, serial, as_of_ns)
    current = unit.geometries.current(serial, as_of_ns)
    then = _of_profile(unit.trends.latest(serial, as_of_ns), current)
    mileage = _mileage_then(unit, serial, as_of_ns)
    if then is not None:
        return table_payload(trend.trend(then, current, mileage), media_type, trend.table)
    reason, baseline = _nothing_until("trend", as_of_ns), max(baseline, 0 if current is None else current.baseline)
    return table_payload(trend.no_trend(serial, baseline, reason, current, mileage), media_type, trend.table)


def _mileage_then(unit: SqlUnitOfWork, serial: str, as_of_ns: int) -> MileageNow | None:
    """Return the newest mileage that was believed at a time, of what is believed of it today."""
    mounted = [mounting for mounting in unit.registry.mountings(serial) if mounting.from_ns <= as_of_ns]
    mileages = [MileageNow(mounting.wheelset_mileage_km, mounting.from_ns) for mounting in mounted]
    newest = unit.windows.mileage_then(serial, as_of_ns)
    return max([*mileages, *([] if newest is None else [newest])], key=lambda mileage: mileage.at_ns, default=None)


def _baseline(unit: SqlUnitOfWork, serial: str, as_of_ns: int) -> int:
    """Return the baseline of a time; refuse one of which not everything is kept: of the present everything is."""
    wheelset = unit.registry.wheelset(serial)
    not_purged(as_of_ns, purged_before(unit.connection, Kept.SUPERSEDED_ESTIMATES))
    return sum(reprofiling.at_ns <= as_of_ns for reprofiling in wheelset.reprofilings)


def _nothing_until(what: str, as_of_ns: int) -> Reason:
    return Reason(ReasonCode.NO_GEOMETRY, f"no {what} had been recorded until {to_rfc3339(as_of_ns)}")


@router.get("/{serial}/windows", response_model=Page[windows.Window], responses=described(400, 404))
def list_windows(
    asked: AskedListDep, serial: Serial, measured_from: MeasuredFrom = None, measured_to: MeasuredTo = None
) -> Response:
    """List the wheelset's windows that begin in `[from, to)`, oldest first, with their quality and state."""
    require_order(measured_from, measured_to)
    filters = {"wheelset": serial, "from": measured_from, "to": measured_to}
    after = asked.after_time(filters, measured_from)
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        records = unit.windows.page(serial, after, asked.limit + 1)
        rows = [record for record in records if measured_to is None or record.start_ns < measured_to]
        why = WindowReasons(unit).of_records(rows[: asked.limit])
    return asked.page(filters, rows, lambda row: row.start_ns, lambda row: windows.window(row, why[row.key]))


MOST_STRETCHES = 100


@router.get("/{serial}/intervals", response_model=Page[geometry.Interval], responses=described(400, 404))
def list_intervals(asked: AskedListDep, serial: Serial) -> Response:
    """List what was estimated from each mileage interval of the wheelset, over all reprofilings, oldest first."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        intervals = [interval for interval in unit.geometries.intervals(serial) if interval.geometry.windows]
        latest = unit.trends.latest(serial)
    intervals.sort(key=lambda interval: interval.mileage_km)
    fleets = {} if latest is None else {latest.baseline: latest.trend.fleet}
    return asked.numbered(
        {"wheelset": serial},
        intervals,
        lambda interval: interval.from_ns,
        lambda interval: geometry.interval(interval, fleets.get(interval.baseline)),
    )


@router.get("/{serial}/data-quality", response_model=geometry.DataQuality, responses=described(404))
def get_data_quality(asked: AskedDep, serial: Serial) -> Response:
    """Return how many windows of the wheelset are accepted over time, and why the others are not."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        counts = window_counts(unit.connection, serial, MOST_STRETCHES)
        waiting = WindowReasons(unit).waiting(wheelset=serial)
    return asked.answer(geometry.data_quality(serial, counts, waiting))

"""Step: what the alert rules need of a wheelset is read: the newest geometries and windows, conicities of all."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.data_quality import DataQualityRule
from estimation.alerts.rules.hunting import HuntingRule
from estimation.alerts.rules.intervals import LOOK_BACK as INTERVALS
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.alerts.rules.sensor_fault import SensorFaultRule
from estimation.alerts.rules.standing import LOOK_BACK, reach_km, within_reach
from estimation.alerts.rules.wheel_flat import WheelFlatRule
from estimation.alerts.step_causes import StepSurroundings
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps.identities import identity_change
from estimation.jobs.steps.trend_steps import step_of, surroundings
from estimation.storage import UnitOfWork
from estimation.trend.steps import behind_step
from estimation.values.alerts import Alert
from estimation.values.geometry import GeometryRecord, IntervalConicities
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.trend import since_change
from estimation.values.windows import WindowRecord

FIRST_LOOK_NS = 3_600_000_000_000


def facts_of(
    unit: UnitOfWork,
    wheelset: WheelsetRecord,
    vehicle: VehicleRecord | None,
    book: RuleBook,
    settings: JobSettings,
) -> WheelsetFacts:
    """Return what the rules need of a wheelset, but for what is found beside the others of its fleet.

    Args:
        unit: Geometries, trends, windows, dampers, alerts and exchanges of sensors are read.
        wheelset, vehicle: The vehicle that it runs in; None where it is in none.
        book: Of its fleet and class: it says how far back its rules look.
        settings: Of all jobs.
    """
    mounting = wheelset.mounting
    alerts: Sequence[Alert] = unit.alerts.all_open(wheelset.serial)
    if mounting is None:
        return WheelsetFacts(wheelset=wheelset, vehicle=None, geometry=None, trend=None, windows=(), open_alerts=alerts)
    trend = unit.trends.latest(wheelset.serial)
    step = step_of(trend, wheelset)
    conicities = behind_step(_conicities(unit, wheelset, mounting.from_ns), step)
    around = StepSurroundings() if step is None else surroundings(unit, wheelset, mounting.vehicle, conicities)
    windows = _latest_windows(unit, wheelset.serial, mounting.from_ns, *windows_wanted(book))
    return WheelsetFacts(
        wheelset=wheelset,
        vehicle=vehicle,
        geometry=unit.geometries.current(wheelset.serial),
        trend=trend,
        step_surroundings=around,
        windows=windows,
        hunted=hunted_beside(unit, mounting.vehicle, windows),
        intervals=_newest(unit, wheelset.serial, conicities, book),
        conicities=conicities,
        open_alerts=alerts,
        trend_parameters=settings.trend,
        damper=unit.dampers.gear(mounting.vehicle, mounting.axle),
        profiles_measured_km=_profiles_measured_km(unit, wheelset),
        sensors_changed_ns=max(unit.sensor_changes.at_axle(mounting.vehicle, mounting.axle), default=None),
    )


def _profiles_measured_km(unit: UnitOfWork, wheelset: WheelsetRecord) -> float | None:
    """Return the mileage at which the profiles were last measured; None if not since the last reprofiling."""
    newest = unit.registry.newest_measurement(wheelset.serial)
    turned_ns = max((one.at_ns for one in wheelset.reprofilings), default=None)
    return None if newest is None or (turned_ns is not None and newest[0] < turned_ns) else newest[1]


def hunted_beside(unit: UnitOfWork, vehicle: str, windows: Sequence[WindowRecord]) -> frozenset[int]:
    """Return in which windows a wheelset of the vehicle hunts; empty where nothing clips that it could explain."""
    clipped = [window.start_ns for window in windows if window.quality.clipped > 0.0]
    return unit.windows.hunted(vehicle, min(clipped)) if clipped else frozenset()


def _conicities(unit: UnitOfWork, wheelset: WheelsetRecord, since_ns: int) -> Sequence[IntervalConicities]:
    stored = unit.geometries.conicities(wheelset.serial, len(wheelset.reprofilings))
    known = since_change(stored, identity_change(unit, wheelset.serial))
    held = [one for one in known if one.windows and one.to_ns > since_ns]
    return sorted(held, key=lambda one: one.to_ns)


def _newest(
    unit: UnitOfWork, serial: str, conicities: Sequence[IntervalConicities], book: RuleBook
) -> Sequence[GeometryRecord]:
    """Return the geometries of the newest intervals, as many as any rule looks at."""
    if not conicities:
        return ()
    far_km = max(reach_km(rule.delays) for rule in book.rules)
    wanted = conicities[-within_reach([one.mileage_km for one in conicities], INTERVALS, far_km) :]
    numbers = [one.interval for one in wanted if one.interval is not None]
    found = unit.geometries.intervals(serial, wanted[0].baseline, first=min(numbers), last=max(numbers))
    by_number = {record.interval: record for record in found}
    return [by_number[number] for number in numbers]


def windows_wanted(book: RuleBook) -> tuple[int, float]:
    """Return how many windows and how many kilometres the rules look back."""
    rules = (book.rule(SensorFaultRule), book.rule(HuntingRule), book.rule(DataQualityRule))
    flats = book.rule(WheelFlatRule)
    wanted = max(flats.latest_windows, *(rule.latest_windows for rule in rules))
    return LOOK_BACK * wanted, max(reach_km(rule.delays) for rule in (*rules, flats))


def _latest_windows(unit: UnitOfWork, serial: str, since_ns: int, wanted: int, far_km: float) -> Sequence[WindowRecord]:
    """Return the latest ``wanted`` windows since a time and all of the last kilometres; looks back as far as needed."""
    newest = unit.windows.latest(serial)
    if newest is None or newest.start_ns < since_ns:
        return ()
    look_back = FIRST_LOOK_NS
    while True:
        from_ns = max(since_ns, newest.start_ns - look_back)
        found = unit.windows.list(serial, from_ns)
        mileages = [None if window.implausible else window.mileage_km for window in found]
        known = [at for at in mileages if at is not None]
        as_far = far_km <= 0.0 or (bool(known) and known[0] < known[-1] - far_km)
        if (len(found) >= wanted and as_far) or from_ns == since_ns:
            return found[-within_reach(mileages, wanted, far_km) :] if found else ()
        look_back *= 8

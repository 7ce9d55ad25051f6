"""Step: what the alert rules need of wheelsets is read: the newest geometries and windows, conicities of all."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter
from typing import TypeVar

import numpy as np

from estimation.accuracy.wheel_contact import RailShare
from estimation.alerts.identity import IDENTITY_EVENT, IdentityEvent
from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.rule import WheelsetFacts, reach_km, within_reach
from estimation.alerts.rules.running_gear import HuntingRule
from estimation.alerts.rules.sensor_data import DataQualityRule, SensorFaultRule
from estimation.alerts.rules.wheels import WheelFlatRule
from estimation.jobs.parameters import JOBS, WORK
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps.assumptions import identity_changes
from estimation.rails.cell import conicity_on_rails, designed_wheel
from estimation.storage import UnitOfWork
from estimation.trend.trend import behind_step
from estimation.values.alerts import Alert, MileageNow
from estimation.values.geometry import GeometryRecord, IntervalConicities
from estimation.values.opinions import GEAR_DAMPERS, GearDamper
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.trend import (
    IDENTITY,
    SUSPENSION,
    TREND,
    IdentityChange,
    StepSurroundings,
    SuspensionShown,
    TrendRecord,
    TrendStep,
    since_change,
)
from estimation.values.windows import WindowRecord

T = TypeVar("T")
RESULTS = (TREND, IDENTITY_EVENT, SUSPENSION, GEAR_DAMPERS)


def facts_of(unit: UnitOfWork, serials: Sequence[str], settings: JobSettings) -> Mapping[str, WheelsetFacts]:
    """Return what the rules need of some wheelsets, by serial: few statements for all."""
    read = _Read.of(unit, serials, settings)
    histories = {wheelset.serial: _history(read, wheelset) for wheelset in read.wheelsets}
    wanted = {serial: _looked_at(intervals, read.books[serial]) for serial, intervals in histories.items() if intervals}
    spans = {serial: (intervals[0].baseline, *_span(intervals)) for serial, intervals in wanted.items()}
    unit.geometries.read_intervals(spans)
    return {
        wheelset.serial: _facts(unit, read, wheelset, histories[wheelset.serial], wanted.get(wheelset.serial, ()))
        for wheelset in read.wheelsets
    }


@dataclass(frozen=True, slots=True)
class _Read:
    """What was read of some wheelsets and their vehicles together."""

    settings: JobSettings
    wheelsets: Sequence[WheelsetRecord]
    vehicles: Mapping[str, VehicleRecord]
    books: Mapping[str, RuleBook]  # of the fleet and class of each wheelset: they say how far back their rules look
    mounted: Mapping[str, Sequence[str]]  # serials of the wheelsets of each vehicle, by axle
    alerts: Mapping[str, Sequence[Alert]]
    geometries: Mapping[str, GeometryRecord]
    conicities: Mapping[str, Sequence[IntervalConicities]]
    trends: Mapping[str, TrendRecord]
    steps: Mapping[str, Sequence[TrendStep | None]]  # steps of the trends beside each wheelset whose own trend has one
    rails: frozenset[RailShare]
    changes: Mapping[str, IdentityChange]
    identities: Mapping[str, IdentityEvent]
    suspensions: Mapping[str, SuspensionShown]
    windows: Mapping[str, tuple[Sequence[WindowRecord], MileageNow | None]]
    dampers: Mapping[tuple[str, int], GearDamper]
    measured: Mapping[str, tuple[int, float]]
    sensors_changed: Mapping[tuple[str, int], int]
    rejected: Mapping[str, Mapping[str, int]]

    @classmethod
    def of(cls, unit: UnitOfWork, serials: Sequence[str], settings: JobSettings) -> _Read:
        """Read what is stored of some wheelsets."""
        wheelsets = unit.registry.wheelsets_of(serials)
        codes = sorted({wheelset.mounting.vehicle for wheelset in wheelsets if wheelset.mounting is not None})
        vehicles, mounted = unit.registry.vehicles_of(codes), _by(unit.registry.mounted_on(codes), lambda m: m.vehicle)
        places = {code: [mounting.wheelset for mounting in mountings] for code, mountings in mounted.items()}
        books = {wheelset.serial: _book(settings.rules, wheelset, vehicles) for wheelset in wheelsets}
        unit.geometries.read_with(RESULTS, dict.fromkeys([*serials, *codes]))
        trends = unit.trends.of(serials)
        steps = _steps_beside(unit, wheelsets, places, trends)
        results = unit.results
        return cls(
            settings=settings,
            wheelsets=wheelsets,
            vehicles=vehicles,
            books=books,
            mounted=places,
            alerts=_by(unit.alerts.open_of(serials, IDENTITY), lambda alert: str(alert.wheelset)),
            geometries=unit.geometries.current_of(serials),
            conicities=unit.geometries.conicities_of({item.serial: len(item.reprofilings) for item in wheelsets}),
            trends=trends,
            steps=steps,
            rails=rails_of(unit.tracks.sections()) if steps else frozenset(),
            changes=identity_changes(unit, serials),
            identities={r.subject: r.value for r in results.in_force(IDENTITY_EVENT, serials) if r.value},
            suspensions={r.subject: r.value for r in results.in_force(SUSPENSION, codes) if r.value},
            windows=_latest_windows(unit, books),
            dampers={(damper.vehicle, damper.first_axle): damper for damper in unit.dampers.of_vehicles(codes)},
            measured=unit.registry.newest_measurement_of(serials),
            sensors_changed=unit.sensor_changes.newest(codes),
            rejected=unit.plausibility.rejected(codes),
        )


def _by(records: Iterable[T], key: Callable[[T], str]) -> dict[str, list[T]]:
    grouped: dict[str, list[T]] = {}
    for record in records:
        grouped.setdefault(key(record), []).append(record)
    return grouped


def _book(rules: RuleBook, wheelset: WheelsetRecord, vehicles: Mapping[str, VehicleRecord]) -> RuleBook:
    mounting = wheelset.mounting
    return rules.of(wheelset.fleet, None if mounting is None else vehicles[mounting.vehicle].vehicle_class)


def _steps_beside(
    unit: UnitOfWork,
    wheelsets: Sequence[WheelsetRecord],
    mounted: Mapping[str, Sequence[str]],
    trends: Mapping[str, TrendRecord],
) -> Mapping[str, Sequence[TrendStep | None]]:
    """Return the steps of the trends beside wheelsets whose own trend has a step, by serial."""
    stepped = [wheelset for wheelset in wheelsets if step_of(trends.get(wheelset.serial), wheelset) is not None]
    beside = {
        record.serial: sorted(other for other in mounted[record.mounting.vehicle] if other != record.serial)
        for record in stepped
        if record.mounting is not None
    }
    others = sorted({serial for serials in beside.values() for serial in serials})
    if not others:
        return dict.fromkeys(beside, ())
    stored, on_file = unit.trends.of(others), {item.serial: item for item in unit.registry.wheelsets_of(others)}
    return {
        record.serial: [
            step_of(stored[serial], on_file[serial])
            for serial in beside.get(record.serial, ())
            if serial in stored and on_file[serial].fleet == record.fleet
        ]
        for record in stepped
    }


def _facts(
    unit: UnitOfWork,
    read: _Read,
    wheelset: WheelsetRecord,
    conicities: Sequence[IntervalConicities],
    looked_at: Sequence[IntervalConicities],
) -> WheelsetFacts:
    serial, mounting, alerts = wheelset.serial, wheelset.mounting, tuple(read.alerts.get(wheelset.serial, ()))
    if mounting is None:
        return WheelsetFacts(
            wheelset=wheelset,
            vehicle=None,
            geometry=None,
            trend=None,
            windows=(),
            open_alerts=alerts,
        )
    trend, (windows, mileage) = read.trends.get(serial), read.windows[serial]
    step = step_of(trend, wheelset)
    around = StepSurroundings()
    if step is not None:
        around = surroundings(wheelset, conicities, read.steps[serial], read.rails)
    first = read.mounted[mounting.vehicle][0] == serial  # alerts are of wheelsets: what is of the vehicle is said there
    shown = read.suspensions.get(mounting.vehicle, SuspensionShown(None, stands=False))
    return WheelsetFacts(
        wheelset=wheelset,
        vehicle=read.vehicles[mounting.vehicle],
        geometry=read.geometries.get(serial),
        trend=trend,
        step_surroundings=around,
        windows=tuple(windows),
        mileage=mileage or MileageNow(mounting.wheelset_mileage_km, mounting.from_ns),
        hunted=hunted_beside(unit, mounting.vehicle, windows),
        intervals=tuple(_geometries(unit, serial, looked_at)),
        conicities=tuple(conicities),
        open_alerts=alerts,
        identity=read.identities.get(serial),
        suspension=shown if first else None,
        trend_parameters=read.settings.trend,
        damper=read.dampers.get((mounting.vehicle, mounting.axle)),
        rejected_recordings=read.rejected.get(mounting.vehicle, {}) if first else {},
        profiles_measured_km=_profiles_measured_km(wheelset, read.measured.get(serial)),
        sensors_changed_ns=read.sensors_changed.get((mounting.vehicle, mounting.axle)),
    )


def _profiles_measured_km(wheelset: WheelsetRecord, newest: tuple[int, float] | None) -> float | None:
    """Return the mileage at which the profiles were last measured; None if not since the last reprofiling."""
    turned_ns = max((reprofiling.at_ns for reprofiling in wheelset.reprofilings), default=None)
    return None if newest is None or (turned_ns is not None and newest[0] < turned_ns) else newest[1]


def hunted_beside(unit: UnitOfWork, vehicle: str, windows: Sequence[WindowRecord]) -> frozenset[int]:
    """Return in which windows a wheelset of the vehicle hunts; empty where nothing clips that it could explain."""
    clipped = [window.start_ns for window in windows if window.quality.clipped > 0.0]
    return unit.windows.hunted(vehicle, min(clipped)) if clipped else frozenset()


def _history(read: _Read, wheelset: WheelsetRecord) -> Sequence[IntervalConicities]:
    """Return the conicities in the present mounting since the last change of identity and the last step."""
    serial, mounting = wheelset.serial, wheelset.mounting
    if mounting is None:
        return ()
    intervals = since_change(read.conicities[serial], read.changes.get(serial))
    with_data = (entry for entry in intervals if entry.windows and entry.to_ns > mounting.from_ns)
    held = sorted(with_data, key=attrgetter("to_ns"))
    return behind_step(held, step_of(read.trends.get(serial), wheelset))


def _looked_at(conicities: Sequence[IntervalConicities], book: RuleBook) -> Sequence[IntervalConicities]:
    """Return the newest intervals, as many as any rule looks at."""
    far_km = max(reach_km(rule.delays) for rule in book.rules)
    mileages = [conicity.mileage_km for conicity in conicities]
    return conicities[-within_reach(mileages, FINDINGS.look_back_intervals, far_km) :]


def _span(intervals: Sequence[IntervalConicities]) -> tuple[int, int]:
    numbers = [interval.interval for interval in intervals if interval.interval is not None]
    return min(numbers), max(numbers)


def _geometries(unit: UnitOfWork, serial: str, wanted: Sequence[IntervalConicities]) -> Sequence[GeometryRecord]:
    if not wanted:
        return ()
    first, last = _span(wanted)
    records = unit.geometries.intervals(serial, wanted[0].baseline, first=first, last=last)
    by_number = {record.interval: record for record in records}
    return [by_number[entry.interval] for entry in wanted if entry.interval is not None]


def windows_wanted(book: RuleBook) -> tuple[int, float]:
    """Return how many windows and how many kilometres the rules look back."""
    rules = (book.rule(SensorFaultRule), book.rule(HuntingRule), book.rule(DataQualityRule))
    flats = book.rule(WheelFlatRule)
    wanted = max(flats.latest_windows, *(rule.latest_windows for rule in rules))
    return FINDINGS.look_back_factor * wanted, max(reach_km(rule.delays) for rule in (*rules, flats))


def _latest_windows(
    unit: UnitOfWork, books: Mapping[str, RuleBook]
) -> Mapping[str, tuple[Sequence[WindowRecord], MileageNow | None]]:
    """Return the latest windows in the present mounting that any rule looks at, all of the last kilometres; mileage."""
    wanted = {serial: windows_wanted(book) for serial, book in books.items()}
    latest: dict[str, tuple[Sequence[WindowRecord], MileageNow | None]] = {}
    count = max((windows for windows, _ in wanted.values()), default=0)
    while wanted:
        read = unit.windows.in_service(list(wanted), count)
        for serial, (least, far_km) in list(wanted.items()):
            windows = read.get(serial, ())
            mileages = [None if window.implausible else window.mileage_km for window in windows]
            believed, newest = [at for at in mileages if at is not None], newest_mileage(windows)
            as_far = newest is not None and (far_km <= 0.0 or believed[0] < believed[-1] - far_km)
            if as_far or len(windows) < count:
                latest[serial] = windows[-within_reach(mileages, least, far_km) :] if windows else (), newest
                del wanted[serial]
        count *= WORK.windows_factor
    return latest


def newest_mileage(windows: Sequence[WindowRecord]) -> MileageNow | None:
    """Return the newest mileage of windows, oldest first, that is believed; None where none is."""
    believed = (window for window in reversed(windows) if window.implausible is None)
    return next((MileageNow(window.mileage_km, window.start_ns) for window in believed), None)


def step_of(record: TrendRecord | None, wheelset: WheelsetRecord) -> TrendStep | None:
    """Return the newest step of the present profile; None where there is none."""
    return None if record is None or record.baseline != len(wheelset.reprofilings) else record.trend.step


def surroundings(
    wheelset: WheelsetRecord,
    behind: Sequence[IntervalConicities],
    beside: Sequence[TrendStep | None],
    rails: Collection[RailShare],
) -> StepSurroundings:
    """Return what is known about the time of a step: the design of the wheel, and trends of wheelsets ``beside`` it."""
    newest = max(behind, key=lambda record: record.to_ns, default=None)
    return StepSurroundings(() if newest is None else newest.known, _designed(wheelset, rails), tuple(beside))


def rails_of(sections: Iterable[TrackSectionRecord]) -> frozenset[RailShare]:
    """Return the kinds of rails that there are."""
    return frozenset(map(RailShare.of, sections))


def _designed(wheelset: WheelsetRecord, rails: Collection[RailShare]) -> Mapping[float, float] | None:
    if len(rails) != 1:
        return None  # on several kinds of rails no one conicity is that of the design
    conicities = _conicities(wheelset.wheel_profile, wheelset.nominal_radius_m, next(iter(rails)))
    by_amplitude = zip(JOBS.design_amplitudes, conicities, strict=True)
    return {amplitude: value for amplitude, value in by_amplitude if np.isfinite(value)} or None


@lru_cache(64)
def _conicities(profile: str, radius: float, rails: RailShare) -> tuple[float, ...]:
    wheel = designed_wheel(profile, radius)
    if wheel is None:
        return (float("nan"),) * len(JOBS.design_amplitudes)
    return tuple(conicity_on_rails(wheel, rails, np.array(JOBS.design_amplitudes))[0].tolist())

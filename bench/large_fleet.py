"""A seeded fleet that has run for a year: daily geometry of every wheelset, its trend, its alerts; no samples."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from sqlalchemy import Insert, func, insert, literal, select

from bench.made_values import UNKNOWN, made_geometry
from bench.put_values import put_geometry, put_trend
from estimation.trend.trend import TrendPoint, refresh
from estimation.values.alerts import Alert, AlertEventKind, Condition, Severity, estimate_evidence, unknown_evidence
from estimation.values.geometry import (
    GEOMETRY,
    BinStatus,
    BinValues,
    GeometryRecord,
    WheelsetGeometry,
    result_of_geometry,
)
from estimation.values.quantities import Estimate, with_interval
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord, WearTrend
from estimation.values.units import DAY_NS
from fleet_db.storage import SqlStorage
from fleet_db.stores.results import RESULTS

AXLES = 4
VARIANTS = 40
"""Different courses of wear; the wheelsets share them, at mileages of their own."""
KM_A_DAY = 400.0
BINS = 20
LIMIT = 0.4
STD = 0.008
WORST_OF = 8
"""One wheelset in so many has an alert."""


@dataclass(frozen=True)
class FleetSize:
    """How large the fleet is, and for how long it has run."""

    fleets: int = 10
    vehicles: int = 1000
    days: int = 365

    @property
    def wheelsets(self) -> int:
        """Number of wheelsets."""
        return self.vehicles * AXLES

    def serial(self, number: int) -> str:
        """Return the serial of a wheelset."""
        return f"WS-{number:05d}"

    def vehicle(self, number: int) -> str:
        """Return the code of a vehicle."""
        return f"V-{number:04d}"

    def fleet(self, vehicle: int) -> str:
        """Return the fleet of a vehicle."""
        return f"F-{vehicle % self.fleets:02d}"


@dataclass(frozen=True)
class _Course:
    """One course of wear: the geometry of each day, and the trend at its end."""

    geometries: tuple[WheelsetGeometry, ...]
    trend: WearTrend


@dataclass(frozen=True)
class _Drawn:
    """What is drawn of a fleet: by wheelset the number of its course, and its mileage when the year begins, km."""

    size: FleetSize
    courses: list[_Course]
    chosen: np.ndarray
    mileages: np.ndarray
    now_ns: int

    @property
    def from_ns(self) -> int:
        return self.now_ns - self.size.days * DAY_NS


def populate(storage: SqlStorage, size: FleetSize, seed: int, now_ns: int) -> float:
    """Fill an empty database with the fleet; return how long it took, in seconds."""
    began = time.perf_counter()
    random = np.random.default_rng(seed)
    courses = [_course(random, size.days, now_ns) for _ in range(VARIANTS)]
    chosen = random.integers(VARIANTS, size=size.wheelsets)
    drawn = _Drawn(size, courses, chosen, np.round(random.uniform(20e3, 900e3, size.wheelsets), 1), now_ns)
    for store in (_register, _store_history, _store_results, _store_alerts):
        store(storage, drawn)
    return time.perf_counter() - began


def _course(random: np.random.Generator, days: int, now_ns: int) -> _Course:
    """Return the year of one kind of wheelset: from a new profile or a worn one, wearing fast or slowly."""
    begin, growth = random.uniform(0.05, 0.35), random.uniform(0.0, 0.2)
    true = begin + growth * np.linspace(0.0, 1.0, days)
    seen = true + STD * random.standard_normal(days)
    points = [
        TrendPoint(KM_A_DAY * day, now_ns - (days - 1 - day) * DAY_NS, float(seen[day]), STD) for day in range(days)
    ]
    return _Course(tuple(_geometry(float(value)) for value in np.round(seen, 3)), refresh(points, LIMIT))


def _geometry(conicity: float) -> WheelsetGeometry:
    """Return a geometry of this conicity; its bins beyond 4 mm have too few samples."""
    edges = np.linspace(-8e-3, 8e-3, BINS + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    seen = np.abs(middle) < 5e-3
    status = tuple(BinStatus.ESTIMATED if one else BinStatus.TOO_FEW for one in seen)

    def values(found: np.ndarray, std: float) -> BinValues:
        return BinValues(np.where(seen, found, np.nan), np.where(seen, std, np.nan), status)

    amplitude = np.arange(1.0, 9.0) * 1e-3
    conicities = tuple(_estimate(conicity * (0.8 + 0.067 * a * 1e3)) if a < 5e-3 else UNKNOWN for a in amplitude)
    return made_geometry(
        *(edges, values(2.0 * conicity * middle, 1e-4), amplitude),
        samples=np.where(seen, 12_000.0, 3.0),
        rolling_radius_sum=values(0.92 + 0.0 * middle, 2e-4),
        contact_angle_sum=values(0.05 + 0.0 * middle, 1e-2),
        contact_angle_difference=values(20.0 * conicity * middle, 1e-2),
        conicity=conicities,
        reported_amplitude=3e-3,
        equivalent_conicity=_estimate(conicity),
        nonlinearity=_estimate(0.01),
        zero_crossing=_estimate(0.1e-3),
        windows=30,
    )


def _estimate(value: float) -> Estimate:
    return with_interval(value, STD, count=30.0)


def _register(storage: SqlStorage, drawn: _Drawn) -> None:
    size = drawn.size
    with storage.write() as unit:
        for number in range(size.fleets):
            unit.registry.add_fleet(FleetRecord(f"F-{number:02d}", f"Fleet {number}"))
        for number in range(size.vehicles):
            fleet = size.fleet(number)
            unit.registry.add_vehicle(
                VehicleRecord(size.vehicle(number), fleet, "emu", AXLES, 44.4, (0.0, 2.5, 17.0, 19.5))
            )
            for axle in range(1, AXLES + 1):
                wheelset = number * AXLES + axle - 1
                serial = size.serial(wheelset)
                run = float(drawn.mileages[wheelset])
                mounting = Mounting(serial, size.vehicle(number), axle, drawn.from_ns, None, run, run)
                unit.registry.add_wheelset(WheelsetRecord(serial, fleet, "S1002", 0.46, mounting))


def _record(
    wheelset: str, interval: int | None, mileage_km: float, from_ns: int, to_ns: int, geometry: WheelsetGeometry
) -> GeometryRecord:
    """Return a geometry as the jobs would have stored it, of an interval or the current one."""
    digest = hashlib.sha256(f"{wheelset} {interval}".encode()).hexdigest()
    later_ns = to_ns + 3600 * 10**9
    half_life = {"half_life_km": 10_000.0}
    return GeometryRecord(
        *(wheelset, 0, interval, mileage_km, from_ns, to_ns, geometry, digest, {}, half_life, "bench", later_ns)
    )


def _store_history(storage: SqlStorage, drawn: _Drawn) -> None:
    """Store the daily geometry of every wheelset: made once for each course, and copied for those that share it."""
    size, chosen = drawn.size, drawn.chosen
    models = {int(course): int(np.argmax(chosen == course)) for course in np.unique(chosen)}
    with storage.write() as unit:
        for course, wheelset in models.items():
            run, serial, records = float(drawn.mileages[wheelset]), size.serial(wheelset), []
            for day, geometry in enumerate(drawn.courses[course].geometries):
                at_ns = drawn.from_ns + (day + 1) * DAY_NS
                records.append(_record(serial, day, run + KM_A_DAY * day, at_ns - DAY_NS, at_ns, geometry))
            unit.results.put_all(GEOMETRY, [result_of_geometry(record) for record in records])
    for wheelsets in _batches(size.wheelsets, 500):
        with storage.write() as unit:
            for wheelset in wheelsets:
                model = models[int(chosen[wheelset])]
                if wheelset != model:
                    unit.connection.execute(_copied(size.serial(model), size.serial(wheelset)))


def _copied(model: str, serial: str) -> Insert:
    """Return a statement that gives a wheelset the geometries of another."""
    made_from = literal(serial) + func.substr(RESULTS.c.made_from, len(serial) + 1)
    own = {"subject": literal(serial), "made_from": made_from}
    names = [column.name for column in RESULTS.columns if column.name != "result_id"]
    source = select(*(own.get(name, RESULTS.c[name]) for name in names)).where(RESULTS.c.subject == model)
    return insert(RESULTS).from_select(names, source)


def _batches(count: int, size: int) -> Iterator[range]:
    for begin in range(0, count, size):
        yield range(begin, min(count, begin + size))


def _store_results(storage: SqlStorage, drawn: _Drawn) -> None:
    """Store what the jobs would leave: the current geometry and the trend of each wheelset."""
    size, now_ns = drawn.size, drawn.now_ns
    for wheelsets in _batches(size.wheelsets, 500):
        with storage.write() as unit:
            for wheelset in wheelsets:
                course, run = drawn.courses[drawn.chosen[wheelset]], float(drawn.mileages[wheelset])
                serial, last_km = size.serial(wheelset), run + KM_A_DAY * (size.days - 1)
                put_geometry(unit, _record(serial, None, last_km, drawn.from_ns, now_ns, course.geometries[-1]))
                trend = replace(course.trend, mileage_km=course.trend.mileage_km + run)
                put_trend(unit, TrendRecord(serial, 0, trend, f"{wheelset:064x}", "bench", now_ns))


def _store_alerts(storage: SqlStorage, drawn: _Drawn) -> None:
    size, now_ns = drawn.size, drawn.now_ns
    last = np.array([drawn.courses[course].trend.fitted.value for course in drawn.chosen])
    worst = np.argsort(-last, kind="stable")[: size.wheelsets // WORST_OF]
    for number, wheelset in enumerate(worst):
        with storage.write() as unit:
            value = float(last[wheelset])
            alert = Alert(
                alert_id=0,
                fleet=size.fleet(int(wheelset) // AXLES),
                wheelset=size.serial(int(wheelset)),
                kind="conicity_limit",
                severity=Severity.CRITICAL if value > LIMIT else Severity.WARNING,
                condition=Condition.ACTIVE,
                opened_ns=now_ns - number * 10**9,
                last_seen_ns=now_ns,
                occurrence_count=3,
                probability=0.97,
                evidence={
                    "quantity": "equivalent_conicity",
                    "amplitude_mm": 3.0,
                    "conicity": estimate_evidence(_estimate(value)),
                    "current": estimate_evidence(_estimate(value)),
                    "windows": 30,
                    "limit": LIMIT,
                    **unknown_evidence(None),
                },
                action="reprofile",
                raise_limit=LIMIT,
                clear_limit=LIMIT - 0.03,
            )
            unit.alerts.save(alert, [AlertEventKind.RAISED], now_ns)

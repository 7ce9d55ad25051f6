"""A wheelset's life as stored: registry, windows, geometries; and a clock that is set by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from paper_class import paper_class

from bench.put_values import put_geometry
from estimation.storage import Storage
from estimation.values.geometry import BinStatus, BinValues, GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.windows import NOT_HUNTING, Hunting, Window, WindowQuality, WindowRecord, WindowState

DAY_NS = 86_400_000_000_000
WINDOW_NS = 30_000_000_000
START_NS = 19_000 * DAY_NS
SENSOR = Reason(ReasonCode.SENSOR_FAULT, "sensor fault")


@dataclass(slots=True)
class SetClock:
    at_ns: int

    def now_ns(self) -> int:
        return self.at_ns


def known(value: float, std: float) -> Estimate:
    return Estimate(value, std, value - 1.96 * std, value + 1.96 * std, 5.0, Status.ESTIMATED)


def quality(*, sensor_fault: bool = False, clipped: float = 0.0, invalid: float = 0.0) -> WindowQuality:
    return WindowQuality(1.0, 0.0, 0, clipped, invalid, 15.0, 20.0, 1.0, sensor_fault)


GOOD = quality()


def window_record(
    wheelset: str, number: int, *, sensor_fault: bool = False, clipped: float = 0.0, invalid: float = 0.0
) -> WindowRecord:
    return WindowRecord(
        wheelset=wheelset,
        start_ns=START_NS + number * WINDOW_NS,
        length_ns=WINDOW_NS,
        vehicle="V1",
        axle=1,
        track_section="S",
        mileage_km=float(number),
        quality=quality(sensor_fault=sensor_fault, clipped=clipped, invalid=invalid),
        state=WindowState.ESTIMATED,
        reason=None,
        content_digest=f"{number}",
        recorded_ns=1,
    )


def geometry_of(
    *,
    conicity: float,
    std: float = 0.008,
    offset: float = 0.0,
    even: float = 0.0,
    known_from: float = -5e-3,
    windows: int = 8,
) -> WheelsetGeometry:
    """Return a geometry with R = 2 conicity y + offset + even y^2 (mm) on bins of 0.5 mm."""
    edges = np.linspace(-4e-3, 4e-3, 17)
    y = 0.5 * (edges[1:] + edges[:-1])
    R = 2.0 * conicity * y + offset + even * (y * 1e3) ** 2 * 1e-3
    seen = y >= known_from
    status = tuple(BinStatus.ESTIMATED if s else BinStatus.TOO_FEW for s in seen)
    radius = BinValues(np.where(seen, R, np.nan), np.where(seen, 2e-5, np.nan), status)
    nothing = BinValues(np.full(16, np.nan), np.full(16, np.nan), (BinStatus.UNOBSERVABLE,) * 16)
    headline = known(conicity, std)
    return WheelsetGeometry(
        bin_edges=edges,
        samples=np.full(16, 1000.0),
        rolling_radius_sum=nothing,
        rolling_radius_difference=radius,
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=np.array([1e-3, 2e-3, 3e-3]),
        conicity=(headline, headline, headline),
        reported_amplitude=3e-3,
        equivalent_conicity=headline,
        nonlinearity=known(0.0, 0.01),
        zero_crossing=Estimate.unknown(
            Reason(ReasonCode.OFFSET_NOT_OBSERVABLE, "band-passed sensors do not see an offset")
        ),
        windows=windows,
        parameter_key="k",
        status=Status.ESTIMATED,
    )


def geometry_record(
    wheelset: str, interval: int | None, day: float, conicity: float, *, baseline: int = 0, recorded_ns: int = 1
) -> GeometryRecord:
    to_ns = START_NS + round(day * DAY_NS)
    return GeometryRecord(
        wheelset=wheelset,
        baseline=baseline,
        interval=interval,
        mileage_km=1000.0 * day,
        from_ns=to_ns - DAY_NS,
        to_ns=to_ns,
        geometry=geometry_of(conicity=conicity),
        input_digest=f"{baseline}/{interval}/{day}/{conicity}",
        track_versions={"S": (1,)},
        parameters={"bin_mm": 0.5},
        code_version="test",
        recorded_ns=recorded_ns,
    )


def register(storage: Storage, *wheelsets: str, vehicle: str = "V1") -> None:
    """Put wheelsets under a vehicle of 100 km/h, from START_NS on."""
    with storage.write() as unit:
        unit.registry.add_vehicle_class(paper_class("metro"), 1)
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.registry.add_vehicle(VehicleRecord(vehicle, "F", "metro", 4, 100.0 / 3.6, (0.0, 2.5, 15.0, 17.5)))
        for axle, serial in enumerate(wheelsets, start=1):
            unit.registry.add_wheelset(WheelsetRecord(serial, "F", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(serial, vehicle, axle, START_NS, None, 0.0, 0.0))


def wear(storage: Storage, wheelset: str, days: int, *, rate: float = 0.003, baseline: int = 0, first: int = 1) -> None:
    """Store an interval geometry for every fourth of some days and the current one."""
    rng = np.random.default_rng(17)
    with storage.write() as unit:
        for day in range(first, first + days, 4):
            noise = 0.008 * float(rng.standard_normal())
            conicity = 0.15 + rate * (day - first) + noise
            put_geometry(unit, geometry_record(wheelset, day, day, conicity, baseline=baseline))
        last = first + days - 1
        put_geometry(
            unit,
            geometry_record(wheelset, None, last, 0.15 + rate * (last - first), baseline=baseline, recorded_ns=last),
        )


def sample_window(
    wheelset: str, start_ns: int, *, odometer_m: float = 0.0, quality: WindowQuality = GOOD, samples: int = 4
) -> Window:
    """Return a window of vehicle V1 with hardly any samples."""
    return Window(
        wheelset=wheelset,
        vehicle="V1",
        axle=1,
        start_ns=start_ns,
        length_ns=WINDOW_NS,
        sample_interval_s=WINDOW_NS / 1e9 / samples,
        lateral_acceleration=np.zeros(samples),
        yaw_acceleration=np.zeros(samples),
        roll_acceleration=np.zeros(samples),
        mass_lateral_acceleration=np.zeros(samples),
        speed=np.full(samples, 20.0),
        distance=np.linspace(0.0, 450.0, samples),
        valid=np.ones(samples, dtype=bool),
        resolution=(1e-3, 1e-3, 1e-3, 1e-3),
        track_section=None,
        odometer_m=odometer_m,
        quality=quality,
    )


def run_windows(
    storage: Storage,
    wheelset: str,
    day: float,
    count: int,
    *,
    faulty: bool = False,
    hunting: Hunting = NOT_HUNTING,
) -> None:
    """Store windows of a day; faulty ones are refused, the others estimated."""
    start = (START_NS + round(day * DAY_NS)) // WINDOW_NS * WINDOW_NS
    with storage.write() as unit:
        for number in range(count):
            window = sample_window(
                wheelset,
                start + number * WINDOW_NS,
                odometer_m=1e6 * day,
                quality=replace(quality(sensor_fault=faulty), hunting=hunting),
            )
            unit.windows.put(window, 1000.0 * day, 1)
            state = WindowState.REFUSED if faulty else WindowState.ESTIMATED
            unit.windows.mark(wheelset, window.start_ns, state, SENSOR if faulty else None)

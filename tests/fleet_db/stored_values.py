"""Values to store: valid, irregular, and different wherever a mistake could hide behind sameness."""

from __future__ import annotations

import math
import struct
from dataclasses import fields as dataclass_fields
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np

from estimation.contact.profiles import MeasuredProfiles, Profile
from estimation.storage import Storage
from estimation.values.alerts import Alert, Condition, Severity
from estimation.values.geometry import (
    BinStatus,
    BinTable,
    BinValues,
    Centre,
    CentreOrigin,
    GeometryRecord,
    WheelsetGeometry,
)
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackAlignment, TrackLayout, TrackSectionRecord
from estimation.values.trend import TrendRecord, WearTrend
from estimation.values.windows import Window, WindowQuality
from fleet_db.records import ChunkRecord, ChunkState

SECOND = 1_000_000_000
LENGTH = 20 * SECOND
START = 1_790_000_000 * SECOND
MOUNTING = Mounting("WS-1", "V-1", 1, START, None, 1000.5, 2000.25)
SECTION = TrackSectionRecord("S-7", 7, "by the river", "56E1", 0.05, 1.435, 12_345.5)
NOT_COVERED, NO_CROSSING, SO = (Reason(ReasonCode.NOT_FINITE, text) for text in ("not covered", "no crossing", "so"))
CHUNK = ChunkRecord("c" * 64, "V-1", ".blf", 123, ChunkState.STORED, None, None, None, 0, {}, START, START + 1)
ALERT = Alert(
    0, "F-1", "WS-1", "conicity_limit", Severity.WARNING, Condition.ACTIVE, 10, 10, 1, 0.9,
    {"value": 0.31, "windows": [1, 2], "limit": None}, "reprofile", 0.3, 0.25,
)  # fmt: skip


def layout(seed: int) -> TrackLayout:
    """Return a layout with a curve, different for every seed."""
    s = np.array([0.0, 100.25 + seed, 180.5, 700.0, 780.125])
    curvature, cant = np.array([0.0, 0.0, 1 / 800, 1 / 800, 0.0]), np.array([0.0, 0.0, 0.08, 0.08, -0.0])
    return TrackLayout("S-7", 0, s, curvature, cant)


def wheel(name: str, seed: int) -> Profile:
    """Return a wheel profile of noise, with a minus zero."""
    y, z, slope = np.random.default_rng(seed).normal(size=(3, 40 + seed)) * 1e-3
    slope[3] = -0.0
    return Profile("wheel", name, np.sort(y), z, slope)


def measured_profiles(at_ns: int, seed: int = 0) -> MeasuredProfiles:
    """Return a measurement of WS-1, its two wheels with different numbers of points."""
    return MeasuredProfiles("WS-1", at_ns, 152_000.125, wheel("left", seed), wheel("right", seed + 1), 0.1e-3)


def same(first: object, second: object) -> bool:
    """Whether two values hold the same bits, whatever is nested in them; NaN equals NaN, 0.0 is not -0.0."""
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and first.shape == second.shape and first.tobytes() == second.tobytes()
    if is_dataclass(first):
        return type(first) is type(second) and all(
            same(getattr(first, field.name), getattr(second, field.name)) for field in dataclass_fields(first)
        )
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, float) and isinstance(second, float):
        return struct.pack("<d", first) == struct.pack("<d", second) or (math.isnan(first) and math.isnan(second))
    return bool(first == second)


def populate(storage: Storage) -> None:
    """Store a fleet: two vehicles of four axles, wheelsets WS-1 and WS-2 mounted, WS-3 on the shelf."""
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("F-1", "Fleet one"))
        for number in (1, 2):
            vehicle = VehicleRecord(f"V-{number}", "F-1", "regional", 4, 44.4, (0.0, 2.5, 17.0, 19.5))
            unit.registry.add_vehicle(vehicle)
        unit.registry.add_wheelset(WheelsetRecord("WS-1", "F-1", "P8", 0.45, MOUNTING))
        unit.registry.add_wheelset(WheelsetRecord("WS-2", "F-1", "S1002", 0.46, second_mounting()))
        unit.registry.add_wheelset(WheelsetRecord("WS-3", "F-1", "P8", 0.42, None))
        unit.tracks.add_section(SECTION)


def second_mounting() -> Mounting:
    """Return where WS-2 runs."""
    return replace(MOUNTING, wheelset="WS-2", axle=3, wheelset_mileage_km=77.0, reversed=True)


def window(index: int = 0, *, seed: int = 0, samples: int = 200, **fields: object) -> Window:
    """Return a window of noise in whole counts, with a hole."""
    random = np.random.default_rng([seed, index])
    resolution = (0.0049, 0.00031, 0.00017, 0.0012)
    counts = random.integers(-32767, 32768, (4, samples))
    valid = np.ones(samples, bool)
    valid[5:9] = False
    speed = 20.0 + np.cumsum(random.normal(0.0, 1e-3, samples))
    values: dict[str, Any] = {
        "wheelset": "WS-1",
        "vehicle": "V-1",
        "axle": 1,
        "start_ns": START + index * LENGTH,
        "length_ns": LENGTH,
        "sample_interval_s": 0.1,
        "speed": speed,
        "distance": 100.0 + np.cumsum(speed) * 0.1,
        "valid": valid,
        "resolution": resolution,
        "track_section": "S-7",
        "odometer_m": 1.25e6 + 400.0 * index,
        "quality": WindowQuality(
            0.98, 0.4, 1, 0.001, 0.02, float(speed.min()), float(speed.max()), 0.9, sensor_fault=False
        ),
    }
    names = (
        "lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration",
    )  # fmt: skip
    for name, row, step in zip(names, counts, resolution, strict=True):
        values[name] = np.where(valid, row * step, np.nan)
    return Window(**(values | fields))


def bin_table(seed: int = 0, groups: int = 5, bins: int = 9) -> BinTable:
    """Return a table with empty cells, a weight without Gram matrix, and a minus zero."""
    random = np.random.default_rng(seed)
    filled = random.random((groups, bins)) < 0.4
    weight = np.where(filled, random.random((groups, bins)) * 100, 0.0)
    lateral, yaw = (np.where(filled[:, :, None], random.normal(size=(groups, bins, 15)), 0.0) for _ in range(2))
    lateral[0, 0, 3] = -0.0
    weight[1, 1] = 2.0
    return BinTable(f"key-{seed}", np.linspace(-7e-3, 8e-3, bins + 1), weight, lateral, yaw, 4999 + seed, 1)


def alignment(seed: int = 0, points: int = 40) -> TrackAlignment:
    """Return an alignment; its version says nothing yet."""
    random = np.random.default_rng(seed)
    columns = [random.normal(size=points) * 1e-3 for _ in range(4)]
    return TrackAlignment("S-7", 0, np.arange(points) * 0.5, *columns, random.integers(0, 9, points), Status.ESTIMATED)


def estimate(seed: int) -> Estimate:
    """Return an estimate with five different numbers."""
    value, std, count = np.random.default_rng(seed).random(3)
    low, high = value - 2 * std, value + 2 * std
    return Estimate(float(value), float(std), float(low), float(high), float(count), Status.ESTIMATED)


def geometry(seed: int = 0, bins: int = 9) -> WheelsetGeometry:
    """Return a geometry with bins that are not estimated and a minus zero."""
    random = np.random.default_rng(seed)
    status = tuple(list(BinStatus)[index] for index in random.integers(0, 4, bins))
    known = np.array([one is BinStatus.ESTIMATED for one in status])
    combinations = [
        BinValues(*(np.where(known, random.normal(size=bins) * scale, np.nan) for scale in (1e-3, 1e-5)), status)
        for _ in range(4)
    ]
    samples = random.random(bins) * 1e4
    samples[0] = -0.0
    return WheelsetGeometry(
        np.linspace(-7e-3, 8e-3, bins + 1), samples, *combinations, np.array([1e-3, 2e-3, 3e-3]),
        (estimate(seed), Estimate.unknown(NOT_COVERED), estimate(seed + 1)), 3e-3, estimate(seed + 2),
        estimate(seed + 3), Estimate.unknown(NO_CROSSING, 3.0, Status.INVALID), 12, "parameters", Status.ESTIMATED,
        centre=Centre(-0.0, seed * 1e-4, CentreOrigin.MEAN_RUNNING_POSITION) if seed else None,
    )  # fmt: skip


def geometry_record(seed: int = 0, recorded_ns: int = 100, **fields: object) -> GeometryRecord:
    """Return the current geometry of WS-1, unless ``fields`` say otherwise."""
    record = GeometryRecord(
        "WS-1", 0, None, 12_345.6, START, START + LENGTH, geometry(seed), f"{seed:064x}", {"S-7": (3, 5)},
        {"forgetting": 0.5, "bins": [1, 2], "mode": None}, "0.1.0", recorded_ns,
    )  # fmt: skip
    return replace(record, **fields)


def trend(seed: int = 0, points: int = 6) -> WearTrend:
    """Return a trend whose date has a whole number of nanoseconds, beyond what a float64 holds."""
    random = np.random.default_rng(seed)
    return WearTrend(
        "equivalent_conicity", np.cumsum(random.random(points)), START + np.arange(points), random.random(points),
        random.random(points), random.random(points), estimate(seed), estimate(seed + 1), estimate(seed + 2), 0.3,
        Forecast(0.0, 1234.5, None), Forecast(START + 1, START + 3.5, None), 0.25, Status.ESTIMATED, SO,
    )  # fmt: skip


def trend_record(seed: int = 0, recorded_ns: int = 100, **fields: object) -> TrendRecord:
    """Return a trend of WS-1, unless ``fields`` say otherwise."""
    return replace(TrendRecord("WS-1", 0, trend(seed), f"{seed:064x}", "0.1.0", recorded_ns), **fields)

"""From the columns of an exchange to the messages of a vehicle on its clock, in the axes and units of the product.

The messages are those of a bus of its own: signed 64-bit counts of 2^-20 (a micrometre, or a micrometre per second
squared), kinds and names as in the shipped catalogue, identifiers that no CAN frame has. So windows are cut from an
exchange by the code that cuts them from a log.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import numpy as np
import scipy.special

from estimation.errors import ExchangeError
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.registry import MAX_AXLES
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS
from ingest.align.clock import AlignCounts, AlignedFrames, TickedValues, TimeFrames
from ingest.catalogue import ACCELERATION, MOTION, POSITION, SYNC, VEHICLE_NODE, Catalogue, MessagePlan, SignalPlan
from ingest.codec import FrameCounts
from ingest.exchange.description import SIGNALS, Column, ExchangeFile, read_description, unit
from ingest.exchange.table import PARQUET, SUFFIXES, ExchangeTable, read_table, read_table_apart
from ingest.file_value import read_value
from ingest.input_file import read_json
from ingest.units import DERIVATIVES, Quantity, derivative

RATE_TOLERANCE = 1e-3  # how far the rate of the table may be from the declared one
TIME_TOLERANCE = 0.3
"""How far a time may be from its place in the uniform series, in sampling intervals: printed times are rounded."""

FLAT, STOPPED = 0.36, 0.64
"""End of the flat band and begin of the stop band of the filter, as shares of the lower of the two rates."""

ATTENUATION_DB = 80.0
BETA = 0.1102 * (ATTENUATION_DB - 8.7)  # Kaiser 1974
CHUNK = 2048
FEWEST = 3


@dataclass(frozen=True, slots=True)
class UniformTime:
    """``count`` samples every ``interval_s`` from ``start_s``."""

    start_s: float
    interval_s: float
    count: int


def uniform_time(table: ExchangeTable, column: str, factor: float, rate_hz: float) -> UniformTime:
    """Return the uniform series that the times of a table are."""
    times = table.columns[column] * factor
    if len(times) < FEWEST:
        raise table.error(f"the table has {len(times)} rows", 0, column)
    steps = np.diff(times)
    back = np.flatnonzero(steps <= 0.0)
    if len(back):
        raise table.error("the time does not increase", int(back[0]) + 1, column)
    typical = float(np.median(steps))
    gaps = np.flatnonzero(steps > 1.5 * max(typical, 1.0 / rate_hz))
    if len(gaps) and abs(typical * rate_hz - 1.0) < TIME_TOLERANCE:
        missing = round(steps[gaps[0]] * rate_hz) - 1
        reason = f"a gap: {missing} samples are missing before it; make one exchange of every part without gaps"
        raise table.error(reason, int(gaps[0]) + 1, column)
    interval = float((times[-1] - times[0]) / (len(times) - 1))
    if abs(interval * rate_hz - 1.0) > RATE_TOLERANCE:
        reason = f"the times come at {1.0 / interval:.6g} Hz, declared are {rate_hz:g} Hz (or the unit is another)"
        raise table.error(reason, 0, column)
    away = np.abs(times - times[0] - interval * np.arange(len(times))) / interval
    worst = int(np.argmax(away))
    if away[worst] > TIME_TOLERANCE:
        raise table.error(f"not uniform: {away[worst]:.2f} sampling intervals from where it should be", worst, column)
    return UniformTime(float(times[0]), interval, len(times))


def ticks_of(time: UniformTime, start_ns: int, interval_ns: int) -> tuple[IntArray, FloatArray]:
    """Return sampling instants (n,) of the vehicle's clock, and where they are in the series, (n,) in its samples.

    The first sample is put on the instant nearest to it; all signals of a run share that shift.
    """
    first = round((start_ns + round(time.start_s * 1e9)) / interval_ns)
    ratio = interval_ns * 1e-9 / time.interval_s
    if abs(ratio - 1.0) < RATE_TOLERANCE / time.count:
        ratio = 1.0
    count = int((time.count - 1) / ratio + 1e-9) + 1
    return np.asarray(first + np.arange(count), np.int64), np.asarray(ratio * np.arange(count))


def resampled(values: FloatArray, at: FloatArray) -> FloatArray:
    """Return uniform samples (n, m) at other uniform places (k,), in samples, band-limited to the lower of both rates.

    A windowed sinc (Kaiser), flat to 0.36 and 80 dB down from 0.64 of the lower rate. Places that are samples, one
    after the other, are these samples. NaN where its reach goes beyond the signals.
    """
    step = float(at[1] - at[0]) if len(at) > 1 else 1.0
    if step == 1.0 and float(at[0]).is_integer():
        return values[at.astype(np.int64)]
    lower = min(1.0, 1.0 / step)  # of the two rates, per sample
    half = (ATTENUATION_DB - 8.0) / (2.0 * 2.285 * 2.0 * np.pi * (STOPPED - FLAT) * lower)  # Kaiser 1974
    reach = int(np.ceil(half))
    result = np.full((len(at), values.shape[1]), np.nan)
    inside = np.flatnonzero((at - half >= 0.0) & (at + half <= len(values) - 1))
    for part in np.array_split(inside, -(-len(inside) // CHUNK) or 1):
        nearest = np.rint(at[part]).astype(np.int64)
        index = nearest[:, None] + np.arange(-reach, reach + 1)
        distance = index - at[part, None]
        shape = scipy.special.i0(BETA * np.sqrt(np.clip(1.0 - (distance / half) ** 2, 0.0, None)))
        weights = np.where(np.abs(distance) <= half, shape, 0.0) * np.sinc((FLAT + STOPPED) * lower * distance)
        weights = np.asarray(weights / weights.sum(axis=1, keepdims=True))
        result[part] = np.einsum("kt,ktm->km", weights, values[np.clip(index, 0, len(values) - 1)])
    return result


INTERVAL_NS = 4_000_000
COUNT = 2.0**-20
FIRST_IDENTIFIER = 0x1000  # behind those of 11 bits
_LARGEST = 1 << 62
LARGEST: Mapping[str, float] = MappingProxyType(
    {"lateral": 1e3, "yaw": 1e4, "roll": 1e4, "mass_lateral": 1e3, "speed": 150.0, "position": 1e7}
)
"""Magnitudes in SI that no vehicle has: beyond them a unit is wrong."""

LONGEST_S = 5e9  # seconds from ``start`` to the first row: 1970 may be the start
RUN_SHARE, RUN_M = 0.05, 2.0
"""How far the change of position may be from the integral of the speed: share of the distance run, and m."""


@dataclass(frozen=True, slots=True)
class RegistryFacts:
    """What of the registry an exchange needs: on the bus of a vehicle its node would send it."""

    section_number: int
    axle_offset_m: float  # of the axle whose position is given, behind the reference point; 0 for that point
    measures_gravity: bool  # lateral accelerations of the vehicle's windows are specific forces


@dataclass(frozen=True, slots=True)
class ExchangeRun(FrozenArrays):
    """A run at the sampling instants of the vehicle's clock; x forward, y left, z up."""

    tick: Annotated[IntArray, "n"]  # sampling intervals since 1970
    distance: Annotated[FloatArray, "n"]  # m along the section, of the vehicle's reference point
    speed: Annotated[FloatArray, "n"]  # m/s
    odometer_m: Annotated[FloatArray, "n"]
    accelerations: Mapping[int, FloatArray]  # by axle, (n, 4) in the order of ACCELERATIONS


def exchange_run(file: ExchangeFile, table: ExchangeTable, facts: RegistryFacts) -> ExchangeRun:
    """Return the run that a table describes."""
    time = uniform_time(table, file.time.column, unit("time", file.time).factor, file.sampling.rate_hz)
    if abs(time.start_s) > LONGEST_S:
        raise table.error(f"{time.start_s:g} s from the start of the run: another unit?", 0, file.time.column)
    tick, at = ticks_of(time, file.run.start_ns, INTERVAL_NS)
    position, speed = _values(table, "position", file.position), _values(table, "speed", file.speed)
    _check_speed(table, file.position.column, file.speed.column, (position, speed), time.interval_s)
    forward = -1.0 if position[-1] < position[0] else 1.0
    samples = np.arange(time.count)
    distance = np.interp(at, samples, position) + forward * facts.axle_offset_m
    speed = np.interp(at, samples, speed)
    run = np.concatenate([[0.0], np.cumsum(0.5 * INTERVAL_NS * 1e-9 * (speed[1:] + speed[:-1]))])
    accelerations = _accelerations(file, table, at, measures_gravity=facts.measures_gravity)
    kept = np.logical_and.reduce([~np.isnan(v).any(axis=1) for v in accelerations.values()])  # filters lose both ends
    if not kept.any():
        raise ExchangeError(f"is too short: {time.count} samples", file=table.path)
    return ExchangeRun(
        tick[kept],
        distance[kept],
        speed[kept],
        1e3 * file.run.odometer_km + run[kept],
        {axle: values[kept] for axle, values in accelerations.items()},
    )


def _values(table: ExchangeTable, name: str, column: Column) -> FloatArray:
    """Return a column in SI; a sensor that was turned is turned back."""
    values = table.columns[column.column] * ((-1.0 if column.turned else 1.0) * unit(name, column).factor)
    if name in LARGEST and unit(name, column).quantity is not Quantity.ANGLE:
        worst = int(np.argmax(np.abs(values)))
        if abs(values[worst]) > LARGEST[name]:
            reason = f"{table.columns[column.column][worst]:g} {column.unit} is no {name} of a vehicle: another unit?"
            raise table.error(reason, worst, column.column)
    return np.asarray(np.unwrap(values) if unit(name, column).quantity is Quantity.ANGLE else values)


def _check_speed(
    table: ExchangeTable, place: str, rate: str, values: tuple[FloatArray, FloatArray], interval_s: float
) -> None:
    position, speed = values
    backwards = np.flatnonzero(speed < 0.0)
    if len(backwards):
        reason = "is negative: x must point in the direction of running; turn x and y, and give the speed as positive"
        raise table.error(reason, int(backwards[0]), rate)
    run = interval_s * float(0.5 * (speed[1:] + speed[:-1]).sum())
    moved = abs(float(position[-1] - position[0]))
    if abs(moved - run) > RUN_M + RUN_SHARE * run:
        reason = f"the position changes by {moved:.1f} m, the speed gives {run:.1f} m: is a unit another?"
        raise table.error(reason, len(speed) - 1, place)


def _accelerations(
    file: ExchangeFile, table: ExchangeTable, at: FloatArray, *, measures_gravity: bool
) -> Mapping[int, FloatArray]:
    """Return the accelerations (k, 4) of each axle at places of the series; rates and angles are differentiated there.

    Lateral ones are as the sensors of the vehicle's class have them: y'' + g phi of a node that rolls by phi, or y''.
    """
    sensors = [(axle.axle, name, getattr(axle, name)) for axle in file.axles for name in SIGNALS]
    signals = [_values(table, name, column) for _, name, column in sensors]
    for values, (_, name, column) in zip(signals, sensors, strict=True):
        if values.min() == values.max():
            raise table.error(f"has one value only: no {name} was measured", 0, column.column)
    sampled = resampled(np.column_stack(signals), at)
    found = {axle.axle: np.empty((len(at), len(SIGNALS))) for axle in file.axles}
    for values, (axle, name, column) in zip(sampled.T, sensors, strict=True):
        times = DERIVATIVES.get(unit(name, column).quantity, 0)
        signal = derivative(values, INTERVAL_NS * 1e-9, times)
        found[axle][:, SIGNALS.index(name)] = file.axes.signs[name] * signal
    if file.run.lateral_includes_gravity != measures_gravity:
        sign = 1.0 if measures_gravity else -1.0
        for values in found.values():
            gravity = sign * GRAVITY * _angle(values[:, SIGNALS.index("roll")])
            values[:, SIGNALS.index("lateral")] += gravity
            values[:, SIGNALS.index("mass_lateral")] += gravity
    return found


def _angle(acceleration: FloatArray) -> FloatArray:
    """Return the angle (n,) of an angular acceleration, without its mean and its straight line; NaN where that is."""
    measured = ~np.isnan(acceleration)
    if measured.sum() < FEWEST:
        return np.full(len(acceleration), np.nan)
    angle = acceleration[measured]
    t = np.arange(len(angle)) - (len(angle) - 1) / 2.0
    for _ in range(2):
        angle = np.concatenate([[0.0], np.cumsum(0.5 * INTERVAL_NS * 1e-9 * (angle[1:] + angle[:-1]))])
        angle -= angle.mean()
    angle -= t * (t @ angle) / (t @ t)
    result = np.full(len(acceleration), np.nan)
    result[measured] = angle
    return result


@cache
def exchange_catalogue() -> Catalogue:
    """Return the messages of exchanges; no frame carries them."""
    plans = [
        _plan(MOTION, VEHICLE_NODE, 0, {"speed": COUNT, "odometer": COUNT}),
        _plan(POSITION, VEHICLE_NODE, 1, {"track_section": 1.0, "distance": COUNT, "position_quality": COUNT}),
        _plan(SYNC, None, 2, {"counter": 1.0}),
    ]
    plans += [_plan(ACCELERATION, n, 2 + n, dict.fromkeys(ACCELERATIONS, COUNT)) for n in range(1, MAX_AXLES + 1)]
    return Catalogue(MappingProxyType({plan.arbitration_id: plan for plan in plans}), INTERVAL_NS)


def _plan(kind: str, node: int | None, place: int, counts: Mapping[str, float]) -> MessagePlan:
    signals = tuple(
        SignalPlan(name, 0, 64, True, count, 0.0, "", -_LARGEST, _LARGEST, None, False)  # noqa: FBT003 - a record's fields
        for name, count in counts.items()
    )
    name = kind if node is None else f"{kind}_{node}"
    return MessagePlan(name, kind, node, FIRST_IDENTIFIER + place, 0, 0, signals)


def aligned_run(run: ExchangeRun, facts: RegistryFacts, position_quality: float) -> AlignedFrames:
    """Return a run as messages on the vehicle's clock."""
    catalogue = exchange_catalogue()
    motion = np.column_stack([run.speed, run.odometer_m])
    position = np.column_stack(
        [np.full(len(run.tick), float(facts.section_number)), run.distance, np.full(len(run.tick), position_quality)]
    )
    tables = {catalogue.find(MOTION, VEHICLE_NODE): motion, catalogue.find(POSITION, VEHICLE_NODE): position}
    tables |= {catalogue.find(ACCELERATION, axle): values for axle, values in run.accelerations.items()}
    never = np.zeros(len(run.tick), dtype=np.bool_)
    messages = {}
    for plan, values in tables.items():
        raw = np.rint(values / [signal.scale for signal in plan.signals]).astype(np.int64)
        messages[plan.arbitration_id] = TickedValues(plan, raw, run.tick, never)
    ends = run.tick[[0, -1]] * INTERVAL_NS
    counts = AlignCounts(samples=len(run.tick) * len(run.accelerations))
    return AlignedFrames(MappingProxyType(messages), TimeFrames(ends, ends), FrameCounts(), counts)


SUFFIX = ".exchange"
DESCRIPTION, TABLE, FACTS = "exchange.toml", "table", "registry.json"
TIMESTAMP = (1980, 1, 1, 0, 0, 0)
LARGEST_BYTES = 4 << 30


def read_run(file: ExchangeFile, table: Path, facts: RegistryFacts) -> ExchangeRun:
    """Return the run of an exchange."""
    names = [column.column for _, column in file.columns]
    read = read_table_apart if table.suffix.lower() == PARQUET else read_table
    return exchange_run(file, read(table, file.csv, names), facts)


def write_bundle(path: Path, description: Path, table: Path, facts: RegistryFacts) -> None:
    """Write an exchange as one file."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as bundle:
        _add(bundle, DESCRIPTION, description)
        _add(bundle, TABLE + table.suffix.lower(), table)
        bundle.writestr(zipfile.ZipInfo(FACTS, TIMESTAMP), json.dumps(asdict(facts), sort_keys=True))


def _add(bundle: zipfile.ZipFile, name: str, path: Path) -> None:
    with path.open("rb") as source, bundle.open(zipfile.ZipInfo(name, TIMESTAMP), "w", force_zip64=True) as target:
        shutil.copyfileobj(source, target, 1 << 20)


def read_bundle(path: Path) -> tuple[ExchangeFile, ExchangeRun, RegistryFacts]:
    """Return description, run and facts of a stored exchange."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-exchange-") as name:
        folder = Path(name)
        table = _unpack(path, folder)
        file, _ = read_description(folder / DESCRIPTION)
        facts = read_value(read_json(folder / FACTS, ExchangeError), RegistryFacts)
        return file, read_run(file, table, facts), facts


def _unpack(path: Path, folder: Path) -> Path:
    try:
        with zipfile.ZipFile(path) as bundle:
            names = {item.filename: item for item in bundle.infolist()}
            tables = [name for name in names if name in {TABLE + suffix for suffix in SUFFIXES}]
            if len(tables) != 1 or set(names) != {DESCRIPTION, FACTS, tables[0]}:
                raise ExchangeError("is no stored exchange", file=path)
            if sum(item.file_size for item in names.values()) > LARGEST_BYTES:
                raise ExchangeError("is too large", file=path)
            bundle.extractall(folder)
    except (OSError, zipfile.BadZipFile, EOFError) as error:
        raise ExchangeError(f"is no stored exchange: {error}", file=path) from error
    return folder / tables[0]

"""From the uniform samples of a table to sampling instants of the vehicle's clock, without folding back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from estimation.values.arrays import FloatArray, IntArray
from ingest.exchange.table import ExchangeTable

RATE_TOLERANCE = 1e-3
"""How far the rate of the table may be from the declared one."""

TIME_TOLERANCE = 0.3
"""How far a time may be from its place in the uniform series, in sampling intervals: printed times are rounded."""

FLAT, STOPPED = 0.36, 0.64
"""End of the flat band and begin of the stop band of the filter, as shares of the lower of the two rates."""

ATTENUATION_DB = 80.0
CHUNK = 2048
FEWEST = 3


@dataclass(frozen=True, slots=True)
class UniformTime:
    """``count`` samples every ``interval_s`` from ``start_s``."""

    start_s: float
    interval_s: float
    count: int


def uniform_time(table: ExchangeTable, column: str, factor: float, rate_hz: float) -> UniformTime:
    """Return the uniform series that the times of a table are.

    Args:
        factor: Of its unit, to seconds.

    Raises:
        ExchangeError: Times do not increase, have a gap, are not uniform, or come at another rate; names the line.
    """
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

    Args:
        start_ns: Vehicle time at which its time is 0, ns.
        interval_ns: Interval of the instants, ns.
    """
    first = round((start_ns + round(time.start_s * 1e9)) / interval_ns)
    ratio = interval_ns * 1e-9 / time.interval_s
    if abs(ratio - 1.0) < RATE_TOLERANCE / time.count:
        ratio = 1.0
    count = int((time.count - 1) / ratio + 1e-9) + 1
    return np.asarray(first + np.arange(count), np.int64), np.asarray(ratio * np.arange(count))


def resampled(values: FloatArray, at: FloatArray) -> FloatArray:
    """Return signals (n, m) of uniform samples at other places (k, m), band-limited to the lower of the two rates.

    A windowed sinc (Kaiser), flat to 0.36 and 80 dB down from 0.64 of the lower rate. Places that are samples, one
    after the other, are these samples. NaN where its reach goes beyond the signals.

    Args:
        values: (n, m) uniform samples.
        at: (k,) places, uniform, increasing, in samples.
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
        weights = _weights(index - at[part, None], half, lower)
        result[part] = np.einsum("kt,ktm->km", weights, values[np.clip(index, 0, len(values) - 1)])
    return result


def _weights(distance: FloatArray, half: float, lower: float) -> FloatArray:
    """Return the weights (k, t) of samples at distances (k, t) from each place; each row adds up to 1."""
    beta = 0.1102 * (ATTENUATION_DB - 8.7)  # Kaiser 1974
    shape = scipy.special.i0(beta * np.sqrt(np.clip(1.0 - (distance / half) ** 2, 0.0, None)))
    weights = np.where(np.abs(distance) <= half, shape, 0.0) * np.sinc((FLAT + STOPPED) * lower * distance)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))

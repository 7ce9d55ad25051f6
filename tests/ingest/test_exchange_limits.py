"""Limits that decide whether an exchange is read, and the filter that resamples it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimation.errors import ExchangeError
from estimation.values.arrays import FloatArray
from ingest.exchange.run import UniformTime, _check_speed, resampled, ticks_of, uniform_time
from ingest.exchange.table import ExchangeTable
from ingest.own_bus.decoding import stamp_clock

RATE_HZ = 500.0


def table(**columns: FloatArray) -> ExchangeTable:
    return ExchangeTable(Path("run.csv"), columns, first_line=2)


def times(change: float = 0.0, at: int = 100, rate: float = RATE_HZ) -> ExchangeTable:
    t = np.arange(1000) / rate
    t[at] += change / RATE_HZ
    return table(t=t)


def test_a_time_may_be_off_by_three_tenths_of_an_interval() -> None:
    assert uniform_time(times(0.29), "t", 1.0, RATE_HZ).count == 1000
    with pytest.raises(ExchangeError, match=r"not uniform: 0\.31 sampling intervals"):
        uniform_time(times(0.31), "t", 1.0, RATE_HZ)


def test_a_rate_may_be_off_by_a_thousandth() -> None:
    found = uniform_time(times(rate=RATE_HZ * 1.0009), "t", 1.0, RATE_HZ)
    assert found.interval_s == pytest.approx(1.0 / (1.0009 * RATE_HZ))
    with pytest.raises(ExchangeError, match=r"come at 500\.55 Hz, declared are 500 Hz"):
        uniform_time(times(rate=RATE_HZ * 1.0011), "t", 1.0, RATE_HZ)


def test_times_of_another_unit_are_another_rate() -> None:
    with pytest.raises(ExchangeError, match=r"declared are 500 Hz \(or the unit is another\)"):
        uniform_time(times(), "t", 1e-3, RATE_HZ)


@pytest.mark.parametrize(("scale", "good"), [(1.0, True), (1.048, True), (1.055, False), (0.952, True), (0.945, False)])
def test_the_position_goes_with_the_speed_within_five_percent(scale: float, *, good: bool) -> None:
    speed = np.full(50_001, 20.0)
    position = scale * 0.04 * np.arange(50_001)
    columns = table(s=position, v=speed)
    if good:
        _check_speed(columns, "s", "v", (position, speed), 2e-3)
    else:
        with pytest.raises(ExchangeError, match="is a unit another"):
            _check_speed(columns, "s", "v", (position, speed), 2e-3)


def test_two_metres_of_position_error_are_none_of_the_unit() -> None:
    speed, position = np.full(501, 1.0), 2e-3 * np.arange(501)
    position[-1] += 1.99
    _check_speed(table(s=position, v=speed), "s", "v", (position, speed), 2e-3)
    position[-1] += 0.1
    with pytest.raises(ExchangeError, match="is a unit another"):
        _check_speed(table(s=position, v=speed), "s", "v", (position, speed), 2e-3)


@pytest.mark.parametrize(("hertz", "least", "most"), [(85.0, 0.999, 1.001), (120.0, 0.55, 0.7), (165.0, 0.0, 2e-4)])
def test_the_filter_is_flat_to_90_hz_and_shut_from_160(hertz: float, least: float, most: float) -> None:
    t = np.arange(10_000) / 1000.0
    tone = np.column_stack([np.cos(2 * np.pi * hertz * t), np.sin(2 * np.pi * hertz * t)])
    at = 4.0 * np.arange(2500)
    found = resampled(tone, at)
    known = ~np.isnan(found[:, 0])
    assert 2500 - known.sum() == pytest.approx(18, abs=2)
    phase = 2 * np.pi * hertz * at[known] / 1000.0
    gain = np.hypot((found[known, 0] * np.cos(phase)).mean() * 2, (found[known, 0] * np.sin(phase)).mean() * 2)
    assert least <= gain <= most


def test_a_run_is_put_on_the_nearest_sampling_instants() -> None:
    tick, at = ticks_of(UniformTime(0.0019, 0.002, 1000), 8_000_000_000, 4_000_000)
    assert tick[0] == 2000
    assert at.tolist() == (2.0 * np.arange(500)).tolist()
    assert ticks_of(UniformTime(0.0021, 0.002, 1000), 8_000_000_000, 4_000_000)[0][0] == 2001


def test_stamps_with_jitter_mark_one_instant_each() -> None:
    rng = np.random.default_rng(1)
    for phase in (0.0, 0.3, 0.49, 0.8):
        true = np.arange(2000) + 1000
        jitter = 0.08 * np.clip(rng.standard_normal(2000), -3, 3)
        stamps = np.rint(5e6 * (true + phase + jitter)).astype(np.int64)
        clock, counts = stamp_clock(stamps, 5_000_000)
        assert len(clock.tick) == 2000
        assert np.all(np.diff(clock.tick) == 1)
        assert abs(clock.tick[0] * 5_000_000 - stamps[0]) <= 0.8 * 5_000_000
        assert counts.syncs_missing == counts.syncs_unplaced == 0
    lost, counts = stamp_clock(np.delete(stamps, slice(500, 503)), 5_000_000)
    assert counts.syncs_missing == 3
    assert lost.tick[500] - lost.tick[499] == 4

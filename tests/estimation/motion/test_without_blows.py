"""A flat is taken out of the signals of its wheelset; single blows are left in, and are no samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from striking import INTERVAL, Struck, once_a_turn, struck_at

from estimation.motion.checks import high_pass_running_mean
from estimation.motion.without_blows import find_turn_blows, without_blows
from estimation.values.windows import Window, WindowQuality


def window_of(signals: Struck, limit: float = np.inf) -> Window:
    """Return a window as ingest makes it; samples beyond a limit, and those beside them, are lost."""
    n = len(signals.speed)
    over = np.abs(signals.lateral) >= limit
    valid = ~(over | np.roll(over, 1) | np.roll(over, -1))
    lateral, roll = (np.where(valid, values, np.nan) for values in (signals.lateral, signals.roll))
    quiet = np.where(valid, 0.0, np.nan)
    blows = find_turn_blows(np.clip(signals.lateral, -limit, limit), signals.roll, signals.speed, INTERVAL)
    quality = replace(WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 20.0, 20.0, 1.0, sensor_fault=False), blows=blows)
    run = np.asarray(20.0 * INTERVAL * np.arange(n), np.float64)
    return Window(
        "W", "V", 1, 0, n * 4_000_000, INTERVAL, lateral, quiet, roll, quiet, signals.speed, run, valid,
        (1e-3,) * 4, "S", 0.0, quality,
    )  # fmt: skip


@pytest.mark.parametrize(("size", "limit"), [(15.0, np.inf), (30.0, np.inf), (60.0, 41.0)])
def test_a_flat_is_taken_out_and_its_samples_are_bridged(size: float, limit: float) -> None:
    signals = struck_at(once_a_turn(2.83), size, 20.0)
    window = window_of(signals, limit)
    clean = without_blows(window)
    assert clean.valid.all()
    assert clean.bridged is not None
    assert 0.1 < clean.bridged.mean() < 0.45
    left = clean.lateral_acceleration - struck_at(np.empty(0), 0.0, 20.0).lateral
    struck_before = signals.lateral - struck_at(np.empty(0), 0.0, 20.0).lateral
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(struck_before**2))
    velocity, before = (
        high_pass_running_mean(INTERVAL * np.cumsum(values - values.mean()), 250) for values in (left, struck_before)
    )
    assert velocity.std() < 0.4 * before.std()


def test_what_was_not_struck_is_the_window_as_it_was() -> None:
    window = window_of(struck_at(np.empty(0), 0.0, 20.0))
    assert without_blows(window) is window


def test_single_blows_stay_in_the_integrals_and_are_no_samples() -> None:
    window = window_of(struck_at(np.arange(100.0, 1200.0, 150.0), 30.0, 20.0))
    clean = without_blows(window)
    assert np.array_equal(clean.lateral_acceleration, window.lateral_acceleration)
    assert np.array_equal(clean.valid, window.valid)
    assert clean.bridged is not None
    assert 0.001 < clean.bridged.mean() < 0.02


def test_long_gaps_are_not_bridged() -> None:
    signals = struck_at(once_a_turn(2.83), 20.0, 20.0)
    window = window_of(signals)
    valid = window.valid.copy()
    valid[3000:3015], valid[6000:6016] = False, False
    clean = without_blows(replace(window, valid=valid))
    assert clean.valid[3000:3015].all()
    assert not clean.valid[6000:6016].any()

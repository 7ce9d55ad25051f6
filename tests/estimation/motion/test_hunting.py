"""Hunting is found, also where it clips; rough track, impacts, curves and rigid bodies are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import hunting_blocks
from swaying import Swaying, rough_track, sway

from estimation.motion.hunting import find_hunting, hunting_reason, in_place_of_quality
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.windows import NOT_HUNTING, Hunting, WindowQuality

SECONDS = 20.0
QUALITY = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 15.0, 25.0, 1.0, sensor_fault=False)


def found(motion: Swaying) -> Hunting:
    return find_hunting(motion.lateral, motion.yaw, motion.speed, motion.interval_s)


@pytest.fixture(scope="module", params=[(30.0, 0.4, 0.5e6), (40.0, 0.2, 0.2e6), (55.0, 0.15, 0.2e6)], ids=str)
def hunting(request: pytest.FixtureRequest) -> Swaying:
    """Return motion above the critical speed on rough track."""
    speed, conicity, stiffness = request.param
    return sway(speed, conicity, stiffness, rough_track(speed, SECONDS, 1e-3))


def test_hunting_is_found_with_its_frequency_and_amplitude(hunting: Swaying) -> None:
    whole = found(hunting)
    assert whole.share == 1.0
    assert 3.5 < hunting.speed[0] / whole.frequency_hz < 15.0
    assert 5e-3 < whole.amplitude < 8e-3


@pytest.mark.parametrize("limit", [10.0, 5.0])
def test_hunting_is_found_where_it_drives_the_sensor_to_its_limits(hunting: Swaying, limit: float) -> None:
    whole, cut = found(hunting), found(hunting.clipped(limit))
    assert cut.share >= 0.75
    assert cut.frequency_hz == pytest.approx(whole.frequency_hz, rel=0.02)
    assert 2.5e-3 <= cut.amplitude <= 1.05 * whole.amplitude


def test_a_stable_wheelset_on_rough_track_does_not_hunt() -> None:
    for seed in range(3):
        assert found(sway(25.0, 0.2, 2.5e6, rough_track(25.0, SECONDS, 2e-3, seed))).share <= 0.25
        assert found(sway(15.0, 0.3, 2.5e6, rough_track(15.0, SECONDS, 2e-3, seed))).share <= 0.25


def test_what_resembles_hunting_in_part_is_none() -> None:
    n, interval = 5000, 0.004
    at = interval * np.arange(n)
    speed = np.full(n, 25.0)
    omega, amplitude = 2.0 * np.pi * 4.0, 5e-3
    lateral = -(omega**2) * amplitude * np.cos(omega * at)
    yaw = omega**3 * amplitude / 25.0 * np.sin(omega * at)
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, n))

    def share(a: np.ndarray, b: np.ndarray, v: np.ndarray = speed) -> float:
        return find_hunting(a + noise[0], b + noise[1], v, interval).share

    assert share(lateral, yaw) == 1.0
    assert share(0.49 * lateral, 0.49 * yaw) == 0.0  # not far enough
    assert share(lateral, -yaw) == 0.0  # out of phase
    assert share(lateral, 0.2 * yaw) == share(lateral, 4.0 * yaw) == 0.0  # a body that sways, a yaw without sway
    assert share(lateral, yaw, np.full(n, 7.9)) == 0.0
    assert share(lateral, yaw, np.full(n, 4.0 * 41.0)) == share(lateral, yaw, np.full(n, 4.0 * 3.4)) == 0.0
    envelope = np.abs(np.sin(2.0 * np.pi * 0.9 * at))  # comes and goes
    assert share(lateral * envelope * 2.0, yaw * envelope * 2.0) == 0.0
    beats = (1.0 + np.cos(2.0 * np.pi * 0.5 * at)) / np.sqrt(1.5)  # three lines within the width of one
    assert share(0.9 * lateral * beats, 0.9 * yaw * beats) == 0.0
    assert share(1.1 * lateral * beats, 1.1 * yaw * beats) == 1.0  # from flange to flange
    impacts = np.zeros(n)
    impacts[::90] = 60.0
    assert share(impacts, impacts) == 0.0
    curve = 0.8 * np.tanh(at - 10.0)
    assert share(curve, 0.0 * curve) == 0.0
    missing = lateral.copy()
    missing[np.arange(n) % 10 < 6] = np.nan
    assert share(missing, yaw) == 1.0
    missing[np.arange(n) % 10 < 8] = np.nan
    assert share(missing, yaw) == 0.0
    half = np.where(at < 10.0, 1.0, 0.02)
    assert share(lateral * half, yaw * half) == 0.5
    assert find_hunting(lateral[:100], yaw[:100], speed[:100], interval) == NOT_HUNTING


@given(
    seed=st.integers(0, 2**32 - 1),
    gain=st.sampled_from([0.0, 0.45, 0.5, 0.9, 1.0, 1.1]),
    noise=st.sampled_from([0.0, 0.01, 1.0]),
    missing=st.sampled_from([0.0, 0.3, 0.69, 0.8, 1.0]),
)
def test_blocks_that_are_not_looked_at_closer_are_none_of_hunting(
    seed: int, gain: float, noise: float, missing: float
) -> None:
    rng = np.random.default_rng(seed)
    n, interval = 2100, 0.01
    at = interval * np.arange(n)
    omega, velocity = 2.0 * np.pi * rng.uniform(0.7, 6.0), rng.uniform(7.0, 40.0)
    speed = np.full(n, velocity)
    speed[rng.random(n) < 1e-4] = np.nan
    wave = gain * 5e-3 * (1.0 + rng.uniform(0.0, 0.6) * np.cos(2.0 * np.pi * 0.4 * at))
    lateral = -(omega**2) * wave * np.cos(omega * at) + noise * rng.standard_normal(n)
    yaw = omega**3 * wave / velocity * np.sin(omega * at) + noise * rng.standard_normal(n)
    for signal in (lateral, yaw):
        signal[rng.random(n) < missing * rng.choice([0.0, 1.0])] = np.nan
    assert find_hunting(lateral, yaw, speed, interval) == hunting_blocks.find_hunting(lateral, yaw, speed, interval)


@pytest.mark.parametrize("below", [1e-9, 1e-7])
def test_a_block_that_is_just_enough_is_looked_at_closer(below: float) -> None:
    n, interval = 500, 0.01
    at, omega, speed = interval * np.arange(n), 2.0 * np.pi * 4.0, np.full(n, 25.0)
    lateral, yaw = -(omega**2) * np.cos(omega * at), omega**3 / 25.0 * np.sin(omega * at)
    amplitude = find_hunting(lateral, yaw, speed, interval).amplitude
    for factor in (1.0 + below, 1.0 - below):
        scale = 2.5e-3 / amplitude * factor
        found = find_hunting(scale * lateral, scale * yaw, speed, interval)
        assert found == hunting_blocks.find_hunting(scale * lateral, scale * yaw, speed, interval)
        assert found.share == float(factor > 1.0)


def test_the_reason_names_hunting_in_place_of_what_hunting_does_to_the_samples() -> None:
    hunts = replace(QUALITY, hunting=Hunting(0.5, 4.0, 5e-3))
    assert code_of(hunting_reason(hunts)) is ReasonCode.HUNTING
    assert "4.0 Hz" in str(hunting_reason(hunts))
    assert hunting_reason(replace(QUALITY, hunting=Hunting(0.49, 4.0, 5e-3))) is None
    clipped = Reason(ReasonCode.TOO_FEW_SAMPLES, "0% of the samples are there")
    replaced = in_place_of_quality(clipped, hunts)
    assert replaced.code is ReasonCode.HUNTING
    assert "0% of the samples" in replaced.text
    assert in_place_of_quality(clipped, QUALITY) == clipped
    other = Reason(ReasonCode.SENSOR_FAULT, "a fault")
    assert in_place_of_quality(other, hunts) == other

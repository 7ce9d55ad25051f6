"""Sensors: noise by its spectrum, filter by tones, clipping, offset and drift by their numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_contact import smooth_pair
from scipy.interpolate import CubicSpline
from scipy.signal import welch

from estimation.values.arrays import FloatArray
from estimation.values.windows import ACCELERATIONS
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.sensors import VELOCITIES, Channel, SensorNode, draw_offsets, ideal_node, measure
from ingest.simulator.track import TrackRecipe, make_track

QUIET = Channel()
NONE = np.zeros(4)


@pytest.fixture(scope="module")
def motion() -> WheelsetMotion:
    track = make_track(TrackRecipe(length=300.0), np.random.SeedSequence(3))
    return simulate_gear(RunningGear(), [smooth_pair()], track, np.full(10_000, 20.0), 20.0)[0]


def with_signal(motion: WheelsetMotion, values: FloatArray) -> WheelsetMotion:
    """Return a motion of any length whose four accelerations are 1, 2, 3 and 4 times ``values``, velocities too."""
    n = len(values)
    t = STEP * np.arange(n, dtype=np.float64)
    velocity = CubicSpline(t, values).antiderivative()(t)
    names = [name for name in WheelsetMotion.__slots__ if name not in {"outside", "path_accelerations", "frame_yaw"}]
    blank: dict[str, FloatArray] = dict.fromkeys(names, np.zeros(n))
    blank |= {name: factor * values for factor, name in enumerate(ACCELERATIONS, start=1)}
    blank |= {name: factor * velocity for factor, name in enumerate(VELOCITIES, start=1)}
    return replace(motion, outside=0, **blank)


def test_ideal_sensors_give_the_true_values(motion: WheelsetMotion) -> None:
    record = measure(motion, ideal_node(), np.random.default_rng(1), NONE)
    for place, name in enumerate(ACCELERATIONS):
        np.testing.assert_array_equal(record.values[:, place], getattr(motion, name))
    assert not record.clipped.any()


@pytest.mark.parametrize("rate", [250, 500, 1000])
def test_noise_has_the_density_of_the_data_sheet(motion: WheelsetMotion, rate: int) -> None:
    still = with_signal(motion, np.zeros(400_000))
    node = SensorNode(Channel(9.8e-4), Channel(2e-3), Channel(1e-3), Channel(5e-4), rate_hz=rate)
    record = measure(still, node, np.random.default_rng(2), NONE)
    frequency, power = welch(record.values, rate, nperseg=1024, axis=0)
    flat = (frequency > 2.0) & (frequency < 0.33 * rate)
    for place, channel in enumerate(node.channels):
        assert np.sqrt(power[flat, place].mean()) == pytest.approx(channel.noise_density, rel=0.02)
    assert np.abs(np.corrcoef(record.values.T) - np.eye(4)).max() < 0.02


@pytest.mark.parametrize(("frequency", "gain"), [(0.3, 1.0), (10.0, 1.0), (85.0, 1.0), (165.0, 0.0), (240.0, 0.0)])
def test_the_filter_passes_what_the_rate_carries_without_delay(
    motion: WheelsetMotion, frequency: float, gain: float
) -> None:
    t = STEP * np.arange(8001)
    tone = with_signal(motion, np.sin(2.0 * np.pi * frequency * t))
    record = measure(tone, SensorNode(QUIET, QUIET, QUIET, QUIET, rate_hz=250), np.random.default_rng(1), NONE)
    wanted = gain * np.sin(2.0 * np.pi * frequency * record.t)
    inner = slice(50, -50)
    np.testing.assert_allclose(record.values[inner, 0], wanted[inner], atol=3e-3)
    np.testing.assert_allclose(record.values[inner, 3], 4.0 * wanted[inner], atol=12e-3)


def test_a_pulse_between_two_samples_is_seen(motion: WheelsetMotion) -> None:
    """Where a narrow contact jump is passed within a sample the velocity steps, and no acceleration shows it."""
    still = with_signal(motion, np.zeros(4000))
    velocity = np.where(np.arange(4000) > 2000, 0.01, 0.0)
    stepped = replace(still, yaw_rate=velocity)
    node = SensorNode(QUIET, QUIET, QUIET, QUIET)
    record = measure(stepped, node, np.random.default_rng(1), NONE, short_pulses=True)
    assert record.values[:, 1].sum() * 0.004 == pytest.approx(0.01, rel=1e-3)
    for other, short in ((ideal_node(), True), (node, False)):
        points = measure(stepped, other, np.random.default_rng(1), NONE, short_pulses=short)
        np.testing.assert_array_equal(points.values, 0.0)


def test_samples_stand_at_multiples_of_the_interval(motion: WheelsetMotion) -> None:
    record = measure(motion, SensorNode(QUIET, QUIET, QUIET, QUIET, rate_hz=200), np.random.default_rng(1), NONE)
    np.testing.assert_allclose(record.t, 0.005 * np.arange(2000), atol=1e-12)


def test_beyond_its_limit_a_sensor_clips_and_says_so(motion: WheelsetMotion) -> None:
    t = STEP * np.arange(10_000)
    peak = with_signal(motion, 10.0 * np.exp(-(((t - 5.0) / 0.05) ** 2)))
    clipping = Channel(limit=4.0)
    record = measure(peak, SensorNode(clipping, QUIET, QUIET, QUIET), np.random.default_rng(1), NONE)
    over = np.abs(record.t - 5.0) < 0.04
    assert record.clipped[over, 0].all()
    assert not record.clipped[np.abs(record.t - 5.0) > 0.06, 0].any()
    assert not record.clipped[:, 1:].any()
    assert record.values[:, 0].max() == pytest.approx(4.0, rel=0.05)
    assert record.values[:, 1].max() == pytest.approx(20.0, rel=0.01)


def test_one_sample_at_the_limit_is_reported_with_the_next_output(motion: WheelsetMotion) -> None:
    values = np.zeros(4000)
    values[1001] = 9.0
    record = measure(
        with_signal(motion, values),
        SensorNode(Channel(limit=4.0), QUIET, QUIET, QUIET),
        np.random.default_rng(1),
        NONE,
    )
    assert np.flatnonzero(record.clipped[:, 0]).tolist() == [251]  # samples 1001 to 1004 end in output 251


def test_offset_is_constant_and_drift_grows_with_the_root_of_time(motion: WheelsetMotion) -> None:
    still = with_signal(motion, np.zeros(100_001))
    node = SensorNode(Channel(drift=3e-3), Channel(offset=0.2), QUIET, QUIET)
    ends, rng = [], np.random.default_rng(7)
    for _ in range(60):
        record = measure(still, node, rng, np.array([0.0, 0.7, 0.0, 0.0]))
        ends.append(record.values[-1, 0])
        np.testing.assert_allclose(record.values[:, 1], 0.7, atol=1e-9)
    assert np.std(ends) == pytest.approx(3e-3 * 10.0, rel=0.3)
    drawn = np.array([draw_offsets(node, rng) for _ in range(500)])
    np.testing.assert_allclose(drawn.std(axis=0), [0.0, 0.2, 0.0, 0.0], atol=0.02)


def test_the_same_seed_gives_the_same_samples(motion: WheelsetMotion) -> None:
    node = SensorNode(*[Channel(1e-3, 0.1, 1e-3, 5.0)] * 4)
    first, again, other = (measure(motion, node, np.random.default_rng(seed), NONE).values for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)

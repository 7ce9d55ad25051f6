"""Errors of sensors: what is drawn, turned axes, skew of a tone, vibration by its band, gyroscopes, and their keys."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_contact import smooth_pair
from scenario_text import SMALL
from scipy.signal import welch

from estimation.errors import ScenarioError
from estimation.values.arrays import FloatArray
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS
from ingest.simulator.campaign import odometer_scale, vehicle_run
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import read_scenario
from ingest.simulator.sensor_errors import (
    NodeErrors,
    SensorErrors,
    Vibration,
    draw_node_errors,
    in_sensor_axes,
    sampled_late,
    turned_axes,
    vibration_of,
)
from ingest.simulator.sensors import Channel, SensorNode, ideal_node, measure
from ingest.simulator.track import TrackRecipe, make_track

NONE = np.zeros(4)
PERFECT = NodeErrors(np.ones(4), np.zeros(3), np.zeros(3), 0.0, NONE, NONE, None)


@pytest.fixture(scope="module")
def motion() -> WheelsetMotion:
    track = make_track(TrackRecipe(length=300.0), np.random.SeedSequence(3))
    speed = np.linspace(18.0, 22.0, 10_000)  # 0.4 m/s2
    return simulate_gear(RunningGear(), [smooth_pair()], track, speed, 20.0)[0]


def measured(motion: WheelsetMotion, errors: NodeErrors, node: SensorNode | None = None) -> FloatArray:
    return measure(motion, node or ideal_node(), np.random.default_rng(1), NONE, errors).values


def true_values(motion: WheelsetMotion) -> FloatArray:
    return np.column_stack([getattr(motion, name) for name in ACCELERATIONS])


def test_what_is_drawn_has_the_stated_standard_deviations() -> None:
    plan = SensorErrors(0.01, 0.03, 2e-3, (1e-4, 2e-4, 2e-4, 3e-4), 0.02)
    rng = np.random.default_rng(4)
    drawn = [draw_node_errors(plan, rng, rng) for _ in range(3000)]
    for name, std in (("scale", 0.01), ("axle_box", 0.03), ("mass", 0.03), ("skew", 2e-3), ("scale_drift", 0.02)):
        values = np.array([getattr(item, name) for item in drawn])
        np.testing.assert_allclose(values.std(axis=0), std, rtol=0.06)
        np.testing.assert_allclose(values.mean(axis=0), 1.0 if name == "scale" else 0.0, atol=0.06 * std)
    np.testing.assert_allclose(np.std([item.offset_slope for item in drawn], axis=0), plan.offset_slope, rtol=0.06)


def test_a_node_keeps_its_errors_and_has_another_temperature_in_every_campaign() -> None:
    plan = SensorErrors(0.01, 0.03, 2e-3, (1e-4, 2e-4, 2e-4, 3e-4), 0.02)
    one, two = (draw_node_errors(plan, np.random.default_rng(7), np.random.default_rng(k)) for k in (1, 2))
    assert np.array_equal(one.scale, two.scale)
    assert np.array_equal(one.axle_box, two.axle_box)
    assert one.skew == two.skew
    assert not np.array_equal(one.offset_slope, two.offset_slope)


def test_without_errors_the_values_are_the_true_ones(motion: WheelsetMotion) -> None:
    np.testing.assert_allclose(measured(motion, PERFECT), true_values(motion), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("angles", "vector", "turned"),
    [
        ((np.pi / 2, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),  # its y is up
        ((0.0, np.pi / 2, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)),  # its x is down
        ((0.0, 0.0, np.pi / 2), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),  # its x is to the left
    ],
)
def test_axes_are_turned_as_right_hands_say(
    angles: tuple[float, ...], vector: tuple[float, ...], turned: tuple[float, ...]
) -> None:
    np.testing.assert_allclose(turned_axes(np.array(angles)) @ vector, turned, atol=1e-15)


def test_a_turned_transducer_measures_gravity_traction_and_the_other_rotation(motion: WheelsetMotion) -> None:
    angle = np.radians(2.0)
    true = true_values(motion)
    rolled = measured(motion, replace(PERFECT, axle_box=np.array([angle, 0.0, 0.0])), gravity_node())
    lateral = true[:, 0] + GRAVITY * motion.roll
    np.testing.assert_allclose(rolled[:, 0], np.cos(angle) * lateral + GRAVITY * np.sin(angle), rtol=1e-9)
    np.testing.assert_allclose(rolled[:, 1], np.cos(angle) * true[:, 1], atol=1e-12)
    pitched = measured(motion, replace(PERFECT, axle_box=np.array([0.0, angle, 0.0])))
    np.testing.assert_allclose(pitched[:, 1], np.cos(angle) * true[:, 1] + np.sin(angle) * true[:, 2], atol=1e-12)
    np.testing.assert_allclose(pitched[:, 2], np.cos(angle) * true[:, 2] - np.sin(angle) * true[:, 1], atol=1e-12)
    yawed = measured(motion, replace(PERFECT, mass=np.array([0.0, 0.0, angle])))
    along = np.gradient(motion.speed, STEP)
    np.testing.assert_allclose(yawed[:, 3], np.cos(angle) * true[:, 3] - np.sin(angle) * along, atol=1e-12)
    np.testing.assert_allclose(yawed[:, :3], true[:, :3], atol=1e-12)


def gravity_node() -> SensorNode:
    return replace(ideal_node(), measures_gravity=True)


def test_gravity_is_measured_with_the_roll_and_upwards(motion: WheelsetMotion) -> None:
    above = replace(motion, mass_roll=0.5 * motion.roll)
    values = measure(above, gravity_node(), np.random.default_rng(1), NONE).values
    np.testing.assert_array_equal(values[:, 0], motion.lateral_acceleration + GRAVITY * motion.roll)
    np.testing.assert_array_equal(values[:, 3], motion.mass_lateral_acceleration + 0.5 * GRAVITY * motion.roll)
    signals = in_sensor_axes(np.zeros((4, 3)), np.zeros(3), PERFECT, gravity=True)
    np.testing.assert_array_equal(signals, np.zeros((4, 3)))


def test_a_late_node_sees_a_tone_later() -> None:
    t = STEP * np.arange(4000)
    tone = np.sin(2.0 * np.pi * 5.0 * t)[None, :]
    for skew in (2e-3, 1.3e-3, -2.4e-3):
        seen = sampled_late(tone, skew)[0]
        inner = slice(10, -10)
        np.testing.assert_allclose(seen[inner], np.sin(2.0 * np.pi * 5.0 * (t + skew))[inner], atol=2e-4)


def test_scale_and_its_drift_act_on_each_channel(motion: WheelsetMotion) -> None:
    errors = replace(PERFECT, scale=np.array([1.1, 1.0, 0.9, 1.0]), scale_drift=np.array([0.0, 0.2, 0.0, -0.2]))
    values, true = measured(motion, errors), true_values(motion)
    passed = np.linspace(0.0, 0.2, len(true))
    factors = np.column_stack([np.full(len(true), 1.1), 1.0 + passed, np.full(len(true), 0.9), 1.0 - passed])
    np.testing.assert_allclose(values, factors * true, rtol=1e-9, atol=1e-12)


def test_an_offset_grows_with_time(motion: WheelsetMotion) -> None:
    errors = replace(PERFECT, offset_slope=np.array([0.01, 0.0, 0.0, -0.02]))
    grown = measured(motion, errors) - true_values(motion)
    np.testing.assert_allclose(grown[-1], [0.01 * 9.999, 0.0, 0.0, -0.02 * 9.999], atol=1e-12)


def test_vibration_has_its_root_mean_square_and_its_band() -> None:
    vibration = Vibration(10.0, 4.0, 0.1, 20.0, 400.0)
    values = vibration_of(vibration, 300_000, np.random.default_rng(3))
    np.testing.assert_allclose(values[:, 1000:].std(axis=1), [10.0, 4.0, 4.0, 1.0], rtol=0.02)
    frequency, power = welch(values[0], 1000.0, nperseg=2000)
    assert power[frequency < 8.0].max() < 1e-3 * power[(frequency > 40.0) & (frequency < 300.0)].mean()
    assert np.abs(np.corrcoef(values) - np.eye(4)).max() < 0.02


def test_the_filter_takes_out_the_vibration_above_its_band(motion: WheelsetMotion) -> None:
    long = replace_length(motion, 200_000)
    errors = replace(PERFECT, vibration=Vibration(lateral=10.0))
    quiet = SensorNode(Channel(), Channel(), Channel(), Channel())
    rms = measured(long, errors, quiet)[500:].std(axis=0)
    assert rms[0] == pytest.approx(10.0 * np.sqrt((125.0 - 20.0) / 380.0), rel=0.05)
    assert rms[3] == pytest.approx(0.1 * rms[0], rel=0.05)


def replace_length(motion: WheelsetMotion, count: int) -> WheelsetMotion:
    """Return a motion of ``count`` samples at rest."""
    names = [name for name, value in named(motion).items() if isinstance(value, np.ndarray)]
    return replace(motion, outside=0, **dict.fromkeys(names, np.zeros(count)))


def named(motion: WheelsetMotion) -> dict[str, object]:
    return {name: getattr(motion, name) for name in WheelsetMotion.__slots__}


def test_a_gyroscope_gives_the_slope_of_its_rate_with_the_noise_of_the_rate(motion: WheelsetMotion) -> None:
    perfect, true = Channel(gyroscope=True), true_values(motion)
    node = SensorNode(Channel(), perfect, perfect, Channel(), rate_hz=1000, anti_alias=False)
    smooth = measured(motion, PERFECT, node)
    np.testing.assert_allclose(smooth[5:-5, 1], true[5:-5, 1], atol=0.02 * np.abs(true[:, 1]).max())
    still = replace_length(motion, 200_000)
    noisy = Channel(noise_density=1e-4, gyroscope=True)
    values = measured(still, PERFECT, replace(node, yaw=noisy, rate_hz=250, anti_alias=True))
    frequency, power = welch(values[:, 1], 250.0, nperseg=2000)
    for at in (5.0, 20.0):
        band = np.abs(frequency - at) < 1.0
        assert np.sqrt(power[band].mean()) == pytest.approx(1e-4 * 2.0 * np.pi * at, rel=0.1)
    assert np.abs(values[:, 2]).max() == 0.0


def test_a_gyroscope_clips_at_its_rate(motion: WheelsetMotion) -> None:
    rate = float(np.abs(motion.yaw_rate).max())
    node = SensorNode(Channel(), Channel(limit=0.5 * rate, gyroscope=True), Channel(), Channel())
    record = measure(motion, node, np.random.default_rng(1), NONE)
    assert record.clipped[:, 1].any()
    assert not record.clipped[:, [0, 2, 3]].any()


def scenario_with(folder: Path, sensors: str = "", position: str = "") -> Scenario:
    path = folder / "scenario.toml"
    text = SMALL.replace('kind = "mems"', f'kind = "mems"\n{sensors}') + f"\n[position]\n{position}\n"
    path.write_text(text)
    return read_scenario(path)


def test_keys_are_read_in_si_units(tmp_path: Path) -> None:
    keys = """scale_error_std_percent = 1.0
mounting_error_std_deg = 2.0
skew_std_ms = 2.0
offset_drift_std_mg_per_min = 6.0
angular_offset_drift_std_rad_s2_per_min = 0.6
scale_drift_std_percent = 0.5
axle_box_vibration_m_s2 = 10.0
axle_box_vibration_rad_s2 = 3.0
gyroscopes = false"""
    errors = scenario_with(tmp_path, keys).sensors.errors
    assert (errors.scale, errors.skew, errors.scale_drift) == (0.01, 0.002, 0.005)
    assert errors.mounting == pytest.approx(np.pi / 90.0)
    np.testing.assert_allclose(errors.offset_slope, [9.80665e-4, 0.01, 0.01, 9.80665e-4])
    assert errors.vibration == Vibration(10.0, 3.0)
    assert scenario_with(tmp_path).sensors.errors == SensorErrors()
    with pytest.raises(ScenarioError, match="vibration_to_hz"):
        scenario_with(tmp_path, "vibration_from_hz = 100.0\nvibration_to_hz = 50.0")


def test_positions_are_off_by_a_fixed_length_and_odometers_by_a_scale(tmp_path: Path) -> None:
    plain = scenario_with(tmp_path)
    scenario = scenario_with(tmp_path, position="offset_m = 5.0\nodometer_scale_std_percent = 0.3")
    track = make_track(TrackRecipe(length=700.0), np.random.SeedSequence(3))
    vehicle = scenario.vehicles[0]
    runs = [vehicle_run(replace(scenario, seed=seed), track, vehicle, 0) for seed in range(12)]
    offsets = {round(float((run.reported - run.distance)[0]), 9) for run in runs}
    assert offsets == {-5.0, 5.0}
    assert odometer_scale(plain, vehicle) == 1.0
    scales = [odometer_scale(replace(scenario, seed=seed), vehicle) - 1.0 for seed in range(300)]
    assert np.std(scales) == pytest.approx(0.003, rel=0.15)

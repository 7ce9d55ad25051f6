"""Friction, cross level, load, wheels and traction of a scenario: drawn as its keys say, refused where impossible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from bench.wheelset_motion import wheelset_motion
from estimation.errors import ScenarioError
from ingest.simulator.axle_motion import averaged, axle_motions, contact_of, running_gear
from ingest.simulator.campaign import friction_along, scenario_track, vehicle_run, with_stretches
from ingest.simulator.running import STRETCH_END, CreepLaw, CreepPlan, FrictionStretch, WheelsPlan
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import read_scenario

RUNNING = """[creep]
law = "vermeulen_johnson"
lowest_friction = 0.15
highest_friction = 0.5
correlation_m = 20.0
campaign_std_percent = 20.0
[wheels]
out_of_round_mm = 0.1
contact_half_width_mm = 0.5
[traction]
driven_axles = [2]
[section.cross_level]
std_mm = 2.0
[section.load_variation]
std_percent = 10.0
[fleet]"""

STRETCH = """[[creep.stretches]]
from_m = 250.0
to_m = 400.0
friction = 0.05
from_campaign = 2
[wheels]"""


def scenario_of(folder: Path, text: str) -> Scenario:
    path = folder / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    return read_scenario(path)


def test_every_key_gets_into_the_running_gear_and_the_track(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, SMALL.replace("[fleet]", RUNNING))
    track, vehicle = scenario_track(scenario), scenario.vehicles[0]
    assert track.surface is not None
    assert track.surface.roll.std() == pytest.approx(2e-3 / 1.5, rel=0.01)
    assert track.surface.load.std() == pytest.approx(0.1, rel=0.01)
    mean = 0.5 * (0.15 + 0.5)
    assert 0.15 <= mean * track.surface.friction.min() < mean * track.surface.friction.max() <= 0.5
    gears = [running_gear(scenario, vehicle_run(scenario, track, vehicle, campaign), (1,)) for campaign in (0, 1)]
    assert gears[0].creep.law is CreepLaw.VERMEULEN_JOHNSON
    assert gears[0].creep.friction != gears[1].creep.friction
    assert gears[0].wheels[0].amplitude == (1e-4, 1e-4)
    assert gears[0].wheels[0].phase[0] != gears[0].wheels[0].phase[1]
    assert gears[0].traction == (3.0,)
    run = vehicle_run(scenario, track, vehicle, 0)
    motion = wheelset_motion(scenario, track, run, 0)
    line = replace(scenario, traction=None)
    assert not np.array_equal(wheelset_motion(line, track, run, 0).yaw, motion.yaw)


def test_what_is_not_drawn_leaves_track_and_motion_as_they_are(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, SMALL)
    track = scenario_track(scenario)
    assert track.surface is None
    assert (scenario.creep, scenario.wheels, scenario.traction) == (CreepPlan(), WheelsPlan(), None)
    assert scenario.wheels.contact_step == pytest.approx(0.05e-3)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("vermeulen_johnson", "kalker", "'kalker' is none of linear, vermeulen_johnson, polach"),
        ("vermeulen_johnson", "linear", "has no effect with law = 'linear'"),
        ("highest_friction = 0.5", "highest_friction = 0.1", "0.1 is below 'lowest_friction', 0.15"),
        ("highest_friction = 0.5\n", "", "'creep.highest_friction': is missing"),
        ("highest_friction = 0.5", "highest_friction = 0.5\nfriction = 0.3", "cannot be given beside its limits"),
        ("highest_friction = 0.5", "highest_friction = 0.5\nslip_factor = 0.3", "has no effect without law = 'polach'"),
        ("driven_axles = [2]", "driven_axles = [9]", "there is no axle 9"),
        ("[wheels]", STRETCH.replace("to_m = 400.0", "to_m = 9999.0"), r"'creep.stretches\[0\].to_m': 9999 is outside"),
        ("[wheels]", STRETCH.replace("to_m = 400.0", "to_m = 259.0"), "259 m must be 10 m or more behind 'from_m'"),
        ("[wheels]", STRETCH.replace("campaign = 2", "campaign = 3"), "3 is outside the range: at most 2"),
    ],
)
def test_impossible_running_is_refused(tmp_path: Path, old: str, new: str, reason: str) -> None:
    with pytest.raises(ScenarioError, match=reason):
        scenario_of(tmp_path, SMALL.replace("[fleet]", RUNNING.replace(old, new)))


def test_friction_is_spread_evenly_between_its_limits_and_changes_over_its_correlation_length() -> None:
    mu = friction_along(
        CreepPlan(lowest_friction=0.2, highest_friction=0.4, correlation=10.0), 200_000, 0.25, np.random.default_rng(1)
    )
    counts, _ = np.histogram(mu, bins=4, range=(0.2, 0.4))
    np.testing.assert_allclose(counts / len(mu), 0.25, atol=0.03)
    assert np.corrcoef(mu[:-4], mu[4:])[0, 1] > 0.99  # 1 m
    assert abs(np.corrcoef(mu[:-200], mu[200:])[0, 1]) < 0.1  # 50 m


@pytest.mark.parametrize("running", [RUNNING, '[creep]\nlaw = "vermeulen_johnson"\n[wheels]\n[fleet]'])
def test_a_stretch_has_its_friction_from_its_campaign_on_and_nothing_else_changes(tmp_path: Path, running: str) -> None:
    text = SMALL.replace("[fleet]", running)
    (tmp_path / "without").mkdir()
    without = scenario_of(tmp_path / "without", text)
    scenario = scenario_of(tmp_path, text.replace("[wheels]", STRETCH))
    track, vehicle, plan = scenario_track(scenario), scenario.vehicles[0], scenario.creep
    assert plan.stretches == (FrictionStretch(250.0, 400.0, 0.05, 2),)
    runs = [vehicle_run(scenario, track, vehicle, campaign) for campaign in (0, 1)]
    means = [running_gear(scenario, run, (0,)).creep.friction for run in runs]
    assert with_stretches(track, plan, 0, means[0]) is track
    leaves = with_stretches(track, plan, 1, means[1]).surface
    assert leaves is not None
    inside = (track.s >= 250.0 + STRETCH_END) & (track.s <= 400.0 - STRETCH_END)
    beside = (track.s <= 250.0) | (track.s >= 400.0)
    np.testing.assert_allclose(means[1] * leaves.friction[inside], 0.05, rtol=1e-12)
    before = np.ones(len(track.s)) if track.surface is None else track.surface.friction
    np.testing.assert_array_equal(leaves.friction[beside], before[beside])
    assert means[1] * leaves.friction.min() >= 0.05 - 1e-12
    assert abs(np.diff(leaves.friction)).max() < 0.2
    for campaign, alike in ((0, True), (1, False)):
        ran = [wheelset_motion(one, track, runs[campaign], 0) for one in (without, scenario)]
        assert (np.abs(ran[0].yaw - ran[1].yaw).max() < 1e-9) == alike  # tables of another range differ in last bits
    doubled = replace(plan, stretches=(*plan.stretches, FrictionStretch(350.0, 500.0, 0.3)))
    later = with_stretches(track, doubled, 1, means[1]).surface
    assert later is not None
    assert means[1] * later.friction[np.searchsorted(track.s, [300.0, 380.0])] == pytest.approx([0.05, 0.3])


def test_contacts_of_finite_size_smooth_the_table_and_keep_a_cone(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, SMALL)
    track = scenario_track(scenario)
    table = contact_of(scenario, track, scenario.vehicles[0].wheelsets[0], 5e7).table
    smooth = averaged(table, 0.5e-3)
    bends = [np.abs(np.diff(item.rolling_radius_left[:, 0], 2)).max() for item in (smooth, table)]
    assert bends[0] < 0.5 * bends[1]
    assert averaged(table, 0.0) is table
    sloped = replace(table, rolling_radius_left=table.rolling_radius_left * 0.0 + table.lateral_displacement[:, None])
    kept = averaged(sloped, 0.5e-3).rolling_radius_left[20:-20]
    np.testing.assert_allclose(kept, sloped.rolling_radius_left[20:-20], atol=1e-12)


def test_the_contact_step_is_that_of_the_table_and_narrows_its_jumps(tmp_path: Path) -> None:
    ramps = []
    for step in (0.05, 0.01):
        text = SMALL.replace("[fleet]", f"[wheels]\ncontact_step_mm = {step}\n[fleet]")
        scenario = scenario_of(tmp_path, text)
        table = contact_of(scenario, scenario_track(scenario), scenario.vehicles[0].wheelsets[0], 5e7).table
        displacement = table.lateral_displacement
        np.testing.assert_allclose(np.diff(displacement), 1e-3 * step)
        ramps.append(np.max(np.diff(table.rolling_radius_difference[:, 0])) / np.diff(displacement)[0])
    assert ramps[1] > 3.0 * ramps[0]


def test_wheelsets_of_another_radius_get_contact_and_motion_of_that_radius(tmp_path: Path) -> None:
    small = scenario_of(tmp_path, SMALL.replace("[fleet]", "[dynamics]\nnominal_radius = 0.42\n[fleet]"))
    track, vehicle = scenario_track(small), small.vehicles[0]
    assert {item.nominal_radius for item in vehicle.wheelsets} == {0.42}
    run = vehicle_run(small, track, vehicle, 0)
    table = contact_of(small, track, vehicle.wheelsets[0], run.odometer).table
    assert float(table.rolling_radius_left.mean()) == pytest.approx(0.42, abs=5e-3)
    (motion,) = axle_motions(small, track, run, (0,), [table])
    assert motion.outside == 0


def test_a_scenario_can_stop(tmp_path: Path) -> None:
    text = SMALL.replace(
        "lowest_m_s = 15.0", "lowest_m_s = 15.0\nstop_every_s = 12.0\nstop_s = 2.0\nbraking_m_s2 = 1.5"
    )
    scenario = scenario_of(tmp_path, text)
    run = vehicle_run(scenario, scenario_track(scenario), scenario.vehicles[0], 0)
    assert (run.speed == 0.0).sum() == pytest.approx(2000, abs=2)
    assert np.abs(np.diff(run.speed)).max() < 1.6e-3

"""Creep force laws against their published formulas, and what friction, traction and load do to a running gear."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from analytic_contact import HALF, RADIUS, cones, smooth_pair

from estimation.values.units import GRAVITY
from estimation.vehicle.vehicle_class import BogieParameters, VehicleParameters
from ingest.simulator.rates import Wheels
from ingest.simulator.running import Creep, CreepLaw, share_of_linear
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import Curves, Surface, TrackRecipe, TrackTruth, make_track

P = VehicleParameters(load=90e3)
BOGIE = BogieParameters(2.5, frame_mass=2600.0, frame_yaw_inertia=1500.0, body_mass=15e3)
JOHNSON, POLACH = Creep(CreepLaw.VERMEULEN_JOHNSON, 0.3), Creep(CreepLaw.POLACH, 0.3, 0.6, 0.2, 0.4, 0.6)


def level(length: float = 1000.0) -> TrackTruth:
    s = np.arange(0.0, length, 0.5)
    return TrackTruth(s, np.zeros(len(s)), np.zeros(len(s)))


@pytest.mark.parametrize("u", [1e-6, 0.5, 2.5, 2.999, 3.001, 20.0])
def test_vermeulen_and_johnson_saturate_at_three_times_friction(u: float) -> None:
    force = u * share_of_linear(JOHNSON.constants(), u * 1000.0, 1000.0, 0.1)
    expected = 1.0 if u >= 3.0 else 1.0 - (1.0 - u / 3.0) ** 3
    assert force == pytest.approx(expected, rel=1e-9)


def test_polach_goes_from_the_weakened_linear_force_to_sliding_friction() -> None:
    c = POLACH.constants()
    assert share_of_linear(c, 0.0, 1000.0, 0.0) == pytest.approx(0.5 * (0.6 + 0.2))
    bound = 1000.0 * (0.6 * math.exp(-0.6 * 2.0) + 0.4)
    e = 0.25 * math.pi * 5000.0 / bound
    expected = 2.0 * bound / math.pi * (0.6 * e / (1.0 + (0.6 * e) ** 2) + math.atan(0.2 * e))
    assert 5000.0 * share_of_linear(c, 5000.0, 1000.0, 2.0) == pytest.approx(expected)


def test_much_friction_is_the_linear_law_with_wheels_that_roll_freely() -> None:
    track = make_track(TrackRecipe(length=300.0, alignment_std=5e-5), np.random.SeedSequence(2))
    table, speed = cones(0.15), np.full(8000, 20.0)
    (linear,) = simulate_gear(RunningGear(P), [table], track, speed, 20.0)
    (much,) = simulate_gear(RunningGear(P, creep=replace(JOHNSON, friction=1.0)), [table], track, speed, 20.0)
    (little,) = simulate_gear(RunningGear(P, creep=replace(JOHNSON, friction=0.02)), [table], track, speed, 20.0)
    apart = [np.std(m.lateral_displacement - linear.lateral_displacement) for m in (much, little)]
    assert apart[0] < 0.03 * linear.lateral_displacement.std()
    assert apart[1] > 3.0 * apart[0]


def test_less_friction_along_the_track_is_the_same_as_a_smaller_coefficient() -> None:
    track = make_track(TrackRecipe(length=300.0), np.random.SeedSequence(2))
    n, speed = len(track.s), np.full(6000, 20.0)
    slippery = replace(track, surface=Surface(np.zeros(n), np.full(n, 0.5), np.ones(n)))
    tables = [smooth_pair()] * 2
    one = simulate_gear(RunningGear(P, BOGIE, JOHNSON), tables, slippery, speed, 20.0)[1]
    other = simulate_gear(RunningGear(P, BOGIE, replace(JOHNSON, friction=0.15)), tables, track, speed, 20.0)[1]
    np.testing.assert_allclose(one.yaw, other.yaw, atol=1e-9)
    dry = simulate_gear(RunningGear(P, BOGIE, JOHNSON), tables, track, speed, 20.0)[1]
    assert np.abs(dry.yaw - one.yaw).max() > 1e-6


def test_braking_uses_up_the_friction_that_steers() -> None:
    """With the resultant near full slip the steering forces of the same creep are smaller."""
    start = np.zeros(11)
    start[0] = 1e-3
    braked = np.maximum(20.0 - 2.0 * np.arange(3000) * 1e-3, 0.0)  # 2 m/s2 of a friction of 0.3
    gear = RunningGear(P, creep=JOHNSON, traction=(1.0,))
    alone = RunningGear(P, creep=JOHNSON)
    rates = [simulate_gear(item, [cones(0.2)], level(), braked, 20.0, initial=start)[0].yaw for item in (gear, alone)]
    assert np.abs(rates[0][:1500]).max() < 0.95 * np.abs(rates[1][:1500]).max()


def test_cross_level_carries_the_axle_and_pulls_it_down() -> None:
    """On a track that rolls by p everywhere the axle is r0 p beside the rails' middle, and gravity acts on it."""
    p, s = 2e-3, np.arange(0.0, 700.0, 0.5)
    flat = np.ones(len(s))
    track = TrackTruth(s, 0.0 * s, 0.0 * s, surface=Surface(p * flat, flat, flat))
    gamma, slope = 0.1, 20.0
    (motion,) = simulate_gear(RunningGear(P), [cones(gamma, slope)], track, np.full(30_000, 20.0), 10.0)
    x = float(motion.relative_displacement[-1])
    assert motion.alignment[-1] == pytest.approx(-RADIUS * p)
    assert motion.roll[-1] == pytest.approx(p)
    np.testing.assert_allclose(motion.mass_roll, motion.roll)
    # steady state: lateral 2 f22 psi + 2 f23 D/(2 r0) - W (D/2 + p) = 0 with D = 2 slope x: what the mass loses to
    # its own tilt comes back through the spring; yaw -l f11/r0 2 gamma x - 2 f23 psi + (l W gamma - k) psi = 0
    f11, f22, f23 = P.longitudinal_creep_coefficient, P.lateral_creep_coefficient, P.lateral_spin_creep_coefficient
    system = np.array(
        [
            [2.0 * f23 * slope / RADIUS - P.load * slope, 2.0 * f22],
            [-2.0 * HALF * f11 * gamma / RADIUS, HALF * P.load * gamma - P.yaw_stiffness - 2.0 * f23],
        ]
    )
    balanced = np.linalg.solve(system, [P.load * p, 0.0])
    assert x == pytest.approx(float(balanced[0]), rel=0.01)


def test_cross_level_that_is_the_same_everywhere_is_a_cant() -> None:
    """Relative to the track vehicles move, or come to rest, as on straight canted track."""
    p, s, flat, level_line = 2e-3, np.arange(0.0, 500.0, 0.5), np.ones(1000), np.zeros(1000)
    rough = make_track(TrackRecipe(length=500.0, interval=0.5), np.random.SeedSequence(3)).alignment[:1000]
    single = RunningGear(replace(P, load=P.axle_load))
    tied = replace(BOGIE, secondary_lateral_stiffness=2e6, secondary_lateral_damping=0.3e6, secondary_yaw_damping=1e5)
    weight = (P.wheelset_mass + 0.5 * (BOGIE.frame_mass + BOGIE.body_mass)) * GRAVITY
    bogie = RunningGear(replace(P, load=weight, lateral_stiffness=2e6), tied)
    for gear, line, begin in ((single, rough, 0), (bogie, level_line, 19_900)):
        rolled = TrackTruth(s, line, level_line, surface=Surface(p * flat, flat, flat))
        cant = Curves(level_line, -2.0 * P.half_contact_distance * p * flat)
        tables = [cones(0.1)] * gear.axles
        one, other = (
            simulate_gear(gear, tables, track, np.full(20_000, 20.0), 20.0)[0]
            for track in (rolled, TrackTruth(s, line, level_line, cant))
        )
        for name in ("relative_displacement", "yaw"):
            expected = getattr(other, name)[begin:]
            np.testing.assert_allclose(getattr(one, name)[begin:], expected, atol=2e-3 * np.abs(expected).max())


def test_a_wheel_that_is_not_round_turns_once_per_revolution() -> None:
    gear = RunningGear(P, wheels=(Wheels((1e-4, 0.0), (0.3, 0.0)),))
    (motion,) = simulate_gear(gear, [cones(0.1)], level(), np.full(8000, 20.0), 20.0)
    expected = RADIUS + 0.1 * motion.relative_displacement + 1e-4 * np.sin(motion.distance / RADIUS + 0.3)
    np.testing.assert_allclose(motion.rolling_radius_left, expected, atol=1e-9)
    assert motion.roll_acceleration[100:-100].std() == pytest.approx(
        1e-4 / (2.0 * P.half_contact_distance) * (20.0 / RADIUS) ** 2 / math.sqrt(2.0), rel=0.02
    )


def test_wheelsets_of_other_radii_roll_on_their_own() -> None:
    """Each on its own nominal radius: no creep is left of the difference."""
    smaller = replace(cones(0.1), rolling_radius_left=cones(0.1).rolling_radius_left - 0.03)
    smaller = replace(smaller, rolling_radius_right=smaller.rolling_radius_right - 0.03)
    track = make_track(TrackRecipe(length=300.0), np.random.SeedSequence(2))
    gear = RunningGear(P, nominal_radii=(RADIUS - 0.03,))
    (one,) = simulate_gear(gear, [smaller], track, np.full(5000, 20.0), 20.0)
    other = simulate_gear(
        RunningGear(replace(P, nominal_radius=RADIUS - 0.03)), [smaller], track, np.full(5000, 20.0), 20.0
    )[0]
    np.testing.assert_allclose(one.yaw, other.yaw, atol=1e-12)


def test_a_stiff_bogie_runs_at_60_m_per_second_with_all_of_it() -> None:
    track = make_track(TrackRecipe(length=900.0, alignment_std=0.0004), np.random.SeedSequence(6))
    shaken = Surface(1e-3 * np.sin(track.s / 3.0), 1.0 + 0.5 * np.sin(track.s / 9.0), 1.0 + 0.2 * np.cos(track.s))
    stiff = VehicleParameters(yaw_stiffness=62.8e6, lateral_stiffness=9e6, load=110e3)
    coach = replace(BOGIE, secondary_lateral_stiffness=0.3e6, secondary_lateral_damping=60e3, secondary_yaw_damping=1e6)
    wheels = (Wheels((1e-4, 1e-4), (1.0, 2.0)),) * 2
    gear = RunningGear(stiff, coach, replace(POLACH, adhesion=1.0, slip=0.4), wheels, traction=(2.0, 0.0))
    speed = 60.0 + np.sin(np.arange(12_000) / 4000.0)
    for motion in simulate_gear(gear, [cones(0.05)] * 2, replace(track, surface=shaken), speed, 20.0):
        assert np.abs(motion.relative_displacement).max() < 12e-3
        assert motion.outside == 0

"""The running gear against its linear system, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_contact import cones, smooth_pair
from linear_bogie import bogie_system
from scipy.linalg import expm

from estimation.values.arrays import FloatArray
from estimation.values.units import GRAVITY
from estimation.vehicle.vehicle_class import BogieParameters, VehicleParameters
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import Curve, TrackRecipe, TrackTruth, laid_out, make_track

SOFT = VehicleParameters(spin_creep_coefficient=31.0, yaw_damping=900.0, load=90e3, lateral_stiffness=2e6)
STIFF = VehicleParameters(yaw_stiffness=62.8e6, lateral_stiffness=9e6, lateral_damping=20e3, load=110e3)
BOGIE = BogieParameters(
    wheelbase=2.5,
    frame_mass=2600.0,
    frame_yaw_inertia=1500.0,
    body_mass=15e3,
    secondary_lateral_stiffness=0.3e6,
    secondary_lateral_damping=30e3,
    secondary_yaw_stiffness=0.2e6,
    secondary_yaw_damping=5e3,
)


def straight(length: float = 1000.0) -> TrackTruth:
    s = np.arange(0.0, length, 1.0)
    return TrackTruth(s, np.zeros(len(s)), np.zeros(len(s)))


def states(front: WheelsetMotion, rear: WheelsetMotion) -> FloatArray:
    """Return y, y', psi, psi' of both wheelsets (8, n)."""
    return np.stack(
        [
            getattr(item, name)
            for item in (front, rear)
            for name in ("lateral_displacement", "lateral_velocity", "yaw", "yaw_rate")
        ]
    )


@pytest.mark.parametrize("parameters", [SOFT, STIFF])
@pytest.mark.parametrize("speed", [12.0, 60.0])
def test_a_small_disturbance_moves_as_the_linear_system_does(parameters: VehicleParameters, speed: float) -> None:
    start = np.zeros(16)
    start[[0, 2, 5, 7, 10, 12, 14]] = 1e-3, -2e-4, -5e-4, 3e-4, 4e-4, 1e-4, -3e-4
    table = cones(0.15, angle_slope=2.0, roll_slope=0.1)
    gear = RunningGear(parameters, BOGIE)
    front, rear = simulate_gear(gear, [table, table], straight(), np.full(1500, speed), 5.0, initial=start)
    system = bogie_system(parameters, BOGIE, speed, 0.15, 2.0, 0.1)
    picked = [0, 1, 2, 3, 5, 6, 7, 8, 10, 11, 12, 13, 14, 15]  # without the angular velocities of the wheels
    for i in (40, 300, 1499):  # the first steps of the fastest creep modes are coarse, and gone by then
        exact = expm(1e-3 * i * system) @ start[picked]
        np.testing.assert_allclose(states(front, rear)[:, i], exact[:8], rtol=0.0, atol=1e-3 * np.abs(exact).max())
        frame = exact[8] + 1.25 * exact[10]
        assert front.mass_lateral_displacement[i] == pytest.approx(frame, abs=1e-3 * np.abs(exact).max())


def test_the_frame_sensor_of_each_node_measures_its_own_end() -> None:
    track = make_track(TrackRecipe(length=300.0), np.random.SeedSequence(4))
    front, rear = simulate_gear(RunningGear(SOFT, BOGIE), [smooth_pair()] * 2, track, np.full(8000, 20.0), 20.0)
    assert front.frame_yaw is not None
    apart = front.mass_lateral_displacement - rear.mass_lateral_displacement
    np.testing.assert_allclose(apart / BOGIE.wheelbase, front.frame_yaw, atol=1e-12)
    change = np.gradient(np.gradient(front.frame_yaw, 1e-3), 1e-3)[5:-5]
    measured = (front.mass_lateral_acceleration - rear.mass_lateral_acceleration)[5:-5] / BOGIE.wheelbase
    np.testing.assert_allclose(measured, change, atol=0.02 * change.std())
    assert rear.distance[0] == pytest.approx(front.distance[0] - BOGIE.wheelbase)


def test_a_frame_that_nothing_moves_is_the_inertial_space_of_one_wheelset() -> None:
    track = make_track(TrackRecipe(length=400.0), np.random.SeedSequence(5))
    fixed = BogieParameters(2.5, frame_mass=1e12, frame_yaw_inertia=1e12, body_mass=1.0)
    heavy = VehicleParameters(suspended_mass=1e12, load=90e3)
    speed, start = np.full(9000, 20.0), np.zeros(16)
    both = simulate_gear(RunningGear(heavy, fixed), [smooth_pair()] * 2, track, speed, 20.0, initial=start)
    for motion, begin in zip(both, (20.0, 17.5), strict=True):
        alone = simulate_gear(RunningGear(heavy), [smooth_pair()], track, speed, begin, initial=np.zeros(11))[0]
        for name in ("lateral_displacement", "yaw"):
            expected = getattr(alone, name)
            np.testing.assert_allclose(getattr(motion, name), expected, atol=1e-6 * np.abs(expected).max())


def test_in_a_curve_the_bogie_takes_up_the_chord_and_the_uncompensated_acceleration() -> None:
    radius, speed, wheelbase = 800.0, 15.0, BOGIE.wheelbase
    s = np.arange(0.0, 900.0, 0.5)
    curves = laid_out([Curve(100.0, 700.0, radius, 0.05, 80.0)], s)
    track = TrackTruth(s, np.zeros(len(s)), np.zeros(len(s)), curves)
    table = cones(0.2)
    rigid = VehicleParameters(yaw_stiffness=62.8e6, lateral_stiffness=9e6, load=110e3)
    gear = RunningGear(rigid, BOGIE)
    front, rear = simulate_gear(gear, [table, table], track, np.full(40_000, speed), 10.0)
    steady = slice(30_000, 35_000)  # 460 to 535 m
    tilt = 0.05 / (2.0 * rigid.half_contact_distance)
    a = speed**2 / radius - GRAVITY * tilt
    assert front.path_accelerations is not None
    np.testing.assert_allclose(front.path_accelerations[0, steady], a, rtol=1e-3)
    assert np.ptp(front.yaw[steady]) < 1e-6
    frame, wheelsets = float(np.asarray(front.frame_yaw)[30_000]), (front, rear)
    chord, sag = wheelbase / (2.0 * radius), wheelbase**2 / (8.0 * radius)  # of the path between middle and axles
    moments = [
        -rigid.yaw_stiffness * (m.yaw[30_000] + end - frame) for m, end in zip(wheelsets, (chord, -chord), strict=True)
    ]
    deflections = [m.mass_lateral_displacement[30_000] - m.lateral_displacement[30_000] - sag for m in wheelsets]
    forces = [rigid.lateral_stiffness * deflection for deflection in deflections]
    about = 0.5 * wheelbase * (forces[0] - forces[1]) + sum(moments) + BOGIE.secondary_yaw_stiffness * frame
    assert abs(about) < 1e-3 * abs(moments[0])
    assert sum(forces) == pytest.approx(-(BOGIE.frame_mass + BOGIE.body_mass) * a, rel=0.02)
    creep = 2.0 * rigid.lateral_creep_coefficient * front.yaw[30_000]
    spin = -2.0 * rigid.lateral_spin_creep_coefficient / radius
    needed = rigid.wheelset_mass * a - forces[0]  # by the front wheelset: its own share, and that of its spring
    assert creep + spin == pytest.approx(needed, rel=0.02)

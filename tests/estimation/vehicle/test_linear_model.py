"""Modes and responses against textbook formulas and against equations of motion that are written here once more."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate

from estimation.errors import ParameterError
from estimation.vehicle.linear_model import (
    COORDINATES,
    LinearContact,
    critical_speed,
    klingel_wavelength,
    linear_model,
    modes,
    single_wheelset_model,
)
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.plausibility import check_plausible, plausible_ranges
from estimation.vehicle.vehicle_class import Arrangement, BogieParameters, VehicleClass, VehicleParameters

FREE = VehicleParameters(
    yaw_stiffness=1e-3, lateral_stiffness=1e-3, lateral_damping=0.0, lateral_spin_creep_coefficient=0.0, load=1e-3
)
PAPER = VehicleParameters()
BOGIE = BogieParameters(
    wheelbase=2.56,
    frame_mass=2615.0,
    frame_yaw_inertia=3067.0,
    body_mass=16000.0,
    secondary_lateral_stiffness=0.32e6,
    secondary_lateral_damping=64e3,
    secondary_yaw_stiffness=0.32e6,
    secondary_yaw_damping=5e3,
)
WHEELSET = VehicleParameters(
    longitudinal_creep_coefficient=9.46e6,
    lateral_creep_coefficient=8.71e6,
    lateral_spin_creep_coefficient=20e3,
    spin_creep_coefficient=55.0,
    lateral_damping=4e3,
    yaw_damping=30e3,
    yaw_inertia=1120.0,
    pitch_inertia=112.0,
    half_contact_distance=0.75,
    wheelset_mass=1813.0,
    suspended_mass=9307.5,
    lateral_stiffness=7.768e6,
    yaw_stiffness=62.782e6,
    load=109092.0,
    nominal_radius=0.46,
)
COACH = VehicleClass("c", "coach", "test", Arrangement.BOGIE, WHEELSET, BOGIE)
SINGLE = VehicleClass("s", "single", "test", Arrangement.SINGLE_WHEELSET, PAPER)


@pytest.mark.parametrize("conicity", [0.05, 0.2, 0.4])
def test_a_free_wheelset_runs_in_klingels_waves(conicity: float) -> None:
    speed, contact = 1.0, LinearContact(conicity)  # slow: inertia does not count
    (kinematic,) = [mode for mode in modes(single_wheelset_model(FREE, speed, contact)) if mode.name == "kinematic"]
    wavelength = 2 * math.pi * math.sqrt(0.45 * 0.7452 / conicity)
    # the lateral creep of the rolling wheelset turns (1 + conicity r0/l) metres for one: its roll moves the contact
    assert speed / kinematic.frequency_hz == pytest.approx(wavelength, rel=conicity)
    rolling = wavelength * math.sqrt(1 + conicity * 0.45 / 0.7452)
    assert speed / kinematic.frequency_hz == pytest.approx(rolling, rel=2e-3)
    assert klingel_wavelength(FREE, contact) == pytest.approx(wavelength)


def test_the_creep_modes_of_a_wheelset_decay_as_creep_over_inertia() -> None:
    speed = 20.0
    found = {mode.name: mode.growth for mode in modes(single_wheelset_model(FREE, speed, LinearContact(1e-3)))}
    assert found["wheelset lateral, creep"] == pytest.approx(-2 * 6.79e6 / (1250 * speed), rel=1e-2)
    assert found["wheelset yaw, creep"] == pytest.approx(-2 * 0.7452**2 * 7.44e6 / (700 * speed), rel=1e-2)


def test_the_suspended_mass_swings_at_its_own_frequency() -> None:
    stiff_track = replace(PAPER, lateral_creep_coefficient=1e9, longitudinal_creep_coefficient=1e9, lateral_damping=1e3)
    found = {mode.name: mode for mode in modes(single_wheelset_model(stiff_track, 20.0, LinearContact(0.01)))}
    mass = found["mass lateral"]
    assert mass.frequency_hz == pytest.approx(math.sqrt(0.23e6 / 8000) / (2 * math.pi), rel=1e-2)
    assert mass.damping_ratio == pytest.approx(1e3 / (2 * math.sqrt(0.23e6 * 8000)), rel=5e-2)


def bogie_rates(
    q: NDArray[np.float64],
    v: NDArray[np.float64],
    d: NDArray[np.float64],
    dd: NDArray[np.float64],
    V: float,
    gamma: float,
) -> NDArray[np.float64]:
    """Return the accelerations of the bogie, every term written out; contact angles as LinearContact has them."""
    p, b, a = WHEELSET, BOGIE, BOGIE.wheelbase / 2
    yf, psif, yb = q[4:]
    vf, psif_rate, vb = v[4:]
    result = np.zeros(7)
    k2, c2 = b.secondary_lateral_stiffness, b.secondary_lateral_damping
    on_frame = k2 * (yb - yf) + c2 * (vb - vf)
    result[6] = -on_frame / b.body_mass
    moment = -b.secondary_yaw_stiffness * psif - b.secondary_yaw_damping * psif_rate
    for i, arm in enumerate((a, -a)):
        y, psi, vy, psi_rate = q[2 * i], q[2 * i + 1], v[2 * i], v[2 * i + 1]
        x, x_rate = y - d[i], vy - dd[i]
        R, roll, roll_rate = (
            2 * gamma * x,
            gamma * x / p.half_contact_distance,
            gamma * x_rate / p.half_contact_distance,
        )
        D = 67.0 * R
        spring = p.lateral_stiffness * (yf + arm * psif - y) + p.lateral_damping * (vf + arm * psif_rate - vy)
        slip = vy + p.nominal_radius * roll_rate - V * psi
        f11, f22, f23 = p.longitudinal_creep_coefficient, p.lateral_creep_coefficient, p.lateral_spin_creep_coefficient
        lateral = -2 * f22 * slip / V - 2 * f23 * (psi_rate / V - D / (2 * p.nominal_radius)) - p.load * (D / 2 + roll)
        result[2 * i] = (lateral + spring) / p.wheelset_mass
        torsion = p.yaw_stiffness * (psif - psi) + p.yaw_damping * (psif_rate - psi_rate)
        yaw = (
            -p.pitch_inertia * V / p.nominal_radius * roll_rate
            - p.half_contact_distance * f11 * R / p.nominal_radius
            + 2 * f23 * slip / V
            - 2 * p.half_contact_distance**2 * f11 * psi_rate / V
            + p.spin_creep_coefficient * (D / p.nominal_radius - 2 * psi_rate / V)
            + 0.5 * p.half_contact_distance * p.load * 0.1 * psi
        )
        result[2 * i + 1] = (yaw + torsion) / p.yaw_inertia
        on_frame -= spring
        moment -= torsion + arm * spring
    result[4], result[5] = on_frame / b.frame_mass, moment / b.frame_yaw_inertia
    return result


def test_the_bogie_answers_a_sine_as_its_equations_integrated_in_time() -> None:
    speed, frequency, conicity = 20.0, 2.0, 0.2
    omega, delay = 2 * math.pi * frequency, BOGIE.wheelbase / speed

    def rates(t: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        phase = omega * np.array([t, t - delay])
        accelerations = bogie_rates(state[:7], state[7:], np.cos(phase), -omega * np.sin(phase), speed, conicity)
        return np.concatenate([state[7:], accelerations])

    t = np.linspace(5.0, 5.5, 101)[:-1]  # one period, after what swings freely has decayed
    found = integrate.solve_ivp(rates, (0.0, 5.5), np.zeros(14), method="LSODA", t_eval=t, rtol=1e-9, atol=1e-9)
    amplitudes = 2 * np.mean(found.y[:7] * np.exp(-1j * omega * t), axis=1)
    model = linear_model(COACH, speed, LinearContact(conicity))
    assert model.response(np.array([frequency]))[0] == pytest.approx(amplitudes, rel=1e-3, abs=1e-4)


def test_the_bogies_eigenvalues_are_those_of_its_equations_written_out() -> None:
    speed, conicity, none = 30.0, 0.3, np.zeros(2)
    units = np.eye(14)
    written = np.stack(
        [np.concatenate([u[7:], bogie_rates(u[:7], u[7:], none, none, speed, conicity)]) for u in units]
    ).T
    expected = np.sort_complex(np.linalg.eigvals(written))
    model = linear_model(COACH, speed, LinearContact(conicity))
    assert np.sort_complex(np.linalg.eigvals(model.matrix)) == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert model.coordinates == COORDINATES


def test_a_rigid_bogie_runs_in_longer_waves_than_its_wheelsets() -> None:
    # its two wheelsets cannot steer: wavelength times sqrt(1 + (wheelbase / 2l)^2) (Wickens 2003, Chapter 3)
    rigid = replace(
        WHEELSET, yaw_stiffness=1e12, lateral_stiffness=1e12, lateral_damping=1e6, yaw_damping=1e6, load=1.0
    )
    loose = replace(BOGIE, secondary_lateral_stiffness=0.0, secondary_lateral_damping=0.0, secondary_yaw_stiffness=0.0)
    rigid = replace(rigid, lateral_spin_creep_coefficient=0.0, spin_creep_coefficient=0.0)
    loose = replace(loose, secondary_yaw_damping=0.0)
    vehicle = replace(COACH, parameters=rigid, bogie=loose)
    contact = LinearContact(0.1)
    found = [mode for mode in modes(linear_model(vehicle, 1.0, contact)) if mode.name.startswith("kinematic")]
    stretched = klingel_wavelength(rigid, contact) * math.sqrt(1 + (2.56 / 1.5) ** 2)
    assert 1.0 / found[0].frequency_hz == pytest.approx(stretched, rel=0.05)


def test_the_modes_of_the_coach_have_their_names() -> None:
    names = [mode.name for mode in modes(linear_model(COACH, 20.0, LinearContact(0.2)))]
    assert {"body lateral", "frame lateral", "frame yaw", "kinematic, in step"} < set(names)


def test_a_vehicle_hunts_just_above_its_critical_speed_and_not_below() -> None:
    for vehicle in (SINGLE, COACH):
        contact = LinearContact(0.3)
        speed = critical_speed(vehicle, contact)
        assert 10.0 < speed < VEHICLE.highest_speed
        assert modes(linear_model(vehicle, speed + 0.2, contact))[0].growth > 0.0
        assert modes(linear_model(vehicle, speed - 0.2, contact))[0].growth < 0.0


def test_a_higher_conicity_hunts_earlier_and_a_tied_wheelset_never() -> None:
    speeds = [critical_speed(COACH, LinearContact(conicity)) for conicity in (0.1, 0.2, 0.3, 0.4)]
    assert speeds == sorted(speeds, reverse=True)
    tied = replace(SINGLE, parameters=replace(PAPER, yaw_stiffness=1e8))
    assert math.isinf(critical_speed(tied, LinearContact(0.1)))


def test_no_conicity_is_refused() -> None:
    with pytest.raises(ParameterError, match="not positive"):
        LinearContact(0.0)


def test_a_range_is_narrow_enough_to_find_a_factor_of_1000() -> None:
    for vehicle in (SINGLE, COACH):
        check_plausible(vehicle)
        for item in plausible_ranges(vehicle):
            width = item.highest / item.lowest
            assert width <= (math.sqrt(VEHICLE.unit_factor) if item.unit == "Hz" else 2 * VEHICLE.unit_factor), (
                item.name
            )


RANGES = {  # as docs/vehicle-class-file.md has them
    "wheelset lateral on its primary springs": (COACH, 1.0, 30.0),
    "wheelset yaw on its primary springs": (COACH, 2.5, 70.0),
    "frame lateral on the primary springs": (COACH, 2.0, 60.0),
    "frame yaw on the primary springs": (COACH, 3.0, 90.0),
    "body lateral on the secondary springs": (COACH, 0.2, 6.0),
    "frame yaw on the secondary springs": (COACH, 0.3, 9.0),
    "mass lateral on its springs": (SINGLE, 0.2, 6.0),
}


@pytest.mark.parametrize("name", RANGES)
def test_the_range_of_a_mode_is_the_documented_one(name: str) -> None:
    vehicle, lowest, highest = RANGES[name]
    (item,) = [item for item in plausible_ranges(vehicle) if item.name == f"the mode {name!r}"]
    assert (item.lowest, item.highest) == (lowest, highest)
    assert not replace(item, value=0.99 * lowest).holds
    assert not replace(item, value=1.01 * highest).holds
    assert item.holds

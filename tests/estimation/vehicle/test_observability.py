"""What observability computes, against signals that are drawn, disturbed and solved for the combinations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.values.arrays import FloatArray
from estimation.vehicle.linear_model import (
    ComplexArray,
    LinearContact,
    combinations,
    equations,
    filtered,
    linear_model,
    sensor_filters,
    true_signals,
)
from estimation.vehicle.observability import CAUSES, Observed, Running, conicity_shifts, observability
from estimation.vehicle.vehicle_class import SensorChannel, SensorLayout, VehicleClass, VehicleParameters
from ingest.vehicle_class_schema import shipped_class, shipped_classes

RUNNING = Running(speed=20.0, duration=60.0, alignment_std=0.0)


def row(rows: tuple[Observed, ...], name: str) -> Observed:
    return next(item for item in rows if item.name.startswith(name))


@pytest.mark.parametrize("code", shipped_classes())
@pytest.mark.parametrize("speed", [15.0, 30.0])
def test_the_equations_hold_for_the_motion_of_the_linear_model(code: str, speed: float) -> None:
    vehicle, contact = shipped_class(code), LinearContact(0.15)
    s = (2j * np.pi * np.geomspace(0.3, 20.0, 50)).astype(np.complex128)
    u = true_signals(linear_model(vehicle, speed, contact), contact, vehicle.parameters, s)
    wheelbase = vehicle.bogie.wheelbase if vehicle.bogie else None
    terms = filtered(equations(vehicle.parameters, wheelbase, speed, combinations(contact)), s) * u[:, None, :]
    largest = np.abs(terms).max(axis=2)
    assert np.all(np.abs(terms.sum(axis=2)) < 1e-9 * largest)


def drawn(vehicle: VehicleClass, running: Running, rng: np.random.Generator) -> tuple[ComplexArray, ComplexArray]:
    """Return s and the Fourier coefficients of all sensor signals over the duration, drawn line by line."""
    T = running.duration
    lines = np.arange(1, int(running.speed / running.wavelengths[0] * T) + 1) / T
    lines = lines[lines >= running.speed / running.wavelengths[1]]
    s = (2j * np.pi * lines).astype(np.complex128)
    contact = running.contact
    u = true_signals(linear_model(vehicle, running.speed, contact), contact, vehicle.parameters, s)
    density = np.interp(lines, running.frequencies_hz, running.alignment_density)
    d = normal(rng, density / T)
    measured, _ = sensor_filters(vehicle.sensors, s)
    return s, np.asarray((measured @ (u * d[:, None])[:, :, None])[:, :, 0])


def normal(rng: np.random.Generator, variance: FloatArray) -> ComplexArray:
    """Return complex amplitudes of lines whose sines have this mean square."""
    return np.asarray(np.sqrt(variance) * (rng.normal(size=len(variance)) + 1j * rng.normal(size=len(variance))))


def solved_conicity(
    vehicle: VehicleClass, assumed: VehicleParameters, s: ComplexArray, sensors: ComplexArray, d: ComplexArray
) -> float:
    """Return the conicity that makes the yaw equation smallest, with dL + dR free: the equations written out."""
    p, layout = assumed, vehicle.sensors
    assert not layout.yaw_is_gyroscope
    y, psi, phi, mass, other = (sensors / s[:, None] ** 2).T
    if layout.measures_gravity:
        y = y - 9.81 * phi / s**2
    assert vehicle.bogie is not None
    frame = (mass - other) / vehicle.bogie.wheelbase
    half, f11, f23 = p.half_contact_distance, p.longitudinal_creep_coefficient, p.lateral_spin_creep_coefficient
    V, r0, f33 = RUNNING.speed, p.nominal_radius, p.spin_creep_coefficient
    moment = p.yaw_inertia * s**2 * psi + p.pitch_inertia * V / r0 * s * phi + 2 * (half**2 * f11 + f33) * s * psi / V
    moment += (p.yaw_stiffness + p.yaw_damping * s) * (psi - frame) - 2 * f23 / V * (s * (y + r0 * phi) - V * psi)
    x = y - d
    slope = combinations(RUNNING.contact).angle_slope  # known: its moment by f33 is small
    moment -= f33 * slope * x / r0
    columns = np.stack([-half * f11 / r0 * 2 * x, 0.5 * half * p.load * psi], axis=1)
    real = np.concatenate([columns.real, columns.imag])
    solution, *_ = np.linalg.lstsq(real, np.concatenate([moment.real, moment.imag]), rcond=None)
    return float(solution[0])


def test_noise_scatters_and_shifts_the_conicity_as_computed() -> None:
    rng = np.random.default_rng(10)
    density, runs = 0.98e-3, 100
    vehicle = shipped_class("coach")
    channel = SensorChannel(noise_density=density)
    vehicle = replace(vehicle, sensors=SensorLayout(channel, channel, channel, channel))
    expected = row(observability(vehicle, RUNNING), "rL - rR").std_by_cause
    found = []
    for _ in range(runs):
        s, sensors = drawn(vehicle, RUNNING, rng)
        d = alignment_of(vehicle, s, sensors)
        noise = np.stack([normal(rng, np.full(len(s), density**2 / RUNNING.duration)) for _ in range(5)], axis=1)
        found.append(solved_conicity(vehicle, vehicle.parameters, s, sensors + noise, d))
    assert np.std(found) == pytest.approx(expected["noise"], rel=0.2)
    assert abs(np.mean(found) - 0.2) == pytest.approx(expected["dilution"], abs=3 * expected["noise"] / np.sqrt(runs))


def alignment_of(vehicle: VehicleClass, s: ComplexArray, sensors: ComplexArray) -> ComplexArray:
    """Return the alignment that noise-free sensors belong to: y of the wheelset over its response."""
    model = linear_model(vehicle, RUNNING.speed, RUNNING.contact)
    return np.asarray(sensors[:, 1] / s**2 / model.response(s.imag / (2 * np.pi))[:, 1])


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("longitudinal_creep_coefficient", "creep"),
        ("yaw_stiffness", "stiffness"),
        ("half_contact_distance", "lengths"),
        ("nominal_radius", "lengths"),
    ],
)
def test_a_wrong_parameter_shifts_the_conicity_as_computed(name: str, cause: str) -> None:
    vehicle = shipped_class("coach")
    only = dict.fromkeys((*VehicleParameters.__slots__, "wheelbase"), 0.0) | {name: 0.01}
    exact = replace(vehicle, relative_std=only, sensors=SensorLayout())
    computed = row(observability(exact, RUNNING), "rL - rR").std_by_cause
    s, sensors = drawn(exact, replace(RUNNING, duration=600.0), np.random.default_rng(1))
    wrong = replace(exact.parameters, **{name: 1.01 * getattr(exact.parameters, name)})
    d = alignment_of(exact, s, sensors)
    assert solved_conicity(exact, exact.parameters, s, sensors, d) == pytest.approx(0.2, abs=1e-9)
    shift = solved_conicity(exact, wrong, s, sensors, d) - 0.2
    assert 0.01 * conicity_shifts(exact, RUNNING)[name][0] == pytest.approx(shift, rel=0.2)
    assert computed[cause] == pytest.approx(abs(shift), rel=0.2)
    assert all(computed[other] < 1e-3 * abs(shift) for other in CAUSES if other != cause)


def test_four_times_the_running_halves_what_is_random_and_nothing_else() -> None:
    vehicle = shipped_class("coach")
    short, long = (observability(vehicle, Running(duration=T)) for T in (600.0, 2400.0))
    for one, other in zip(short, long, strict=True):
        for cause in CAUSES:
            share = 0.5 if cause in {"noise", "track"} else 1.0
            assert other.std_by_cause[cause] == pytest.approx(share * one.std_by_cause[cause]), (one.name, cause)


def test_the_bound_is_below_what_least_squares_finds() -> None:
    for code in shipped_classes():
        for item in observability(shipped_class(code), Running()):
            assert item.bound <= 1.001 * item.std, (code, item.name)


def test_conicity_is_seen_by_all_and_the_sum_of_radii_by_none() -> None:
    for code in shipped_classes():
        rows = observability(shipped_class(code), Running())
        assert row(rows, "rL - rR").seen
        assert not row(rows, "rL + rR").seen
        assert not row(rows, "dL + dR").seen


def test_a_stiff_primary_suspension_costs_conicity() -> None:
    stds = {code: row(observability(shipped_class(code), Running()), "rL - rR").std for code in shipped_classes()}
    assert stds["paper"] < stds["soft_bogie"] < stds["coach"]


def test_a_gyroscope_is_integrated_once() -> None:
    vehicle = shipped_class("coach")
    density = 1e-4
    gyroscope = replace(vehicle.sensors, yaw=SensorChannel(density), yaw_is_gyroscope=True)
    quiet = replace(vehicle.sensors, yaw=SensorChannel(0.0))
    found = [row(observability(replace(vehicle, sensors=item), Running()), "rL - rR") for item in (gyroscope, quiet)]
    assert found[0].std_by_cause["noise"] > found[1].std_by_cause["noise"]
    s = np.array([2j * np.pi])
    assert abs(sensor_filters(gyroscope, s)[1][0, 1, 1]) == pytest.approx(1 / (2 * np.pi))
    assert abs(sensor_filters(quiet, s)[1][0, 1, 1]) == pytest.approx(1 / (2 * np.pi) ** 2)


def test_a_radius_on_file_that_is_too_large_makes_the_conicity_as_much_too_large() -> None:
    for code in shipped_classes():
        held, learnt = conicity_shifts(shipped_class(code), Running())["nominal_radius"]
        assert held == pytest.approx(0.2, rel=0.02)  # R = -(r0/(l f11)) (moment)
        assert learnt == pytest.approx(0.2, rel=0.05)


def test_what_the_page_on_vehicles_says_of_sensors() -> None:
    vehicle = shipped_class("coach")

    def std(**changed: SensorChannel) -> float:
        layout = replace(vehicle.sensors, **changed, yaw_is_gyroscope="yaw" in changed)
        return row(observability(replace(vehicle, sensors=layout), Running()), "rL - rR").std

    assert std() == pytest.approx(0.022, abs=5e-4)
    assert std(yaw=SensorChannel(8.7e-5, 0.005)) == pytest.approx(0.017, abs=5e-4)
    assert std(mass_lateral=SensorChannel(2.5e-4, 0.005)) == pytest.approx(0.022, abs=5e-4)
    assert std(mass_lateral=SensorChannel(0.98e-3, 0.01)) > std() + 1e-3


def test_seen_is_what_has_a_std_below_a_quarter() -> None:
    causes = dict.fromkeys(CAUSES, 0.0)
    assert Observed("R", "", 1.0, causes | {"noise": 0.249}, 0.0).seen
    assert not Observed("R", "", 1.0, causes | {"noise": 0.251}, 0.0).seen

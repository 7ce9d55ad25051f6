"""The stationary filter and its smoother against the posterior mean of all samples, solved as one system."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bogie_run import SOFT, of_bogie
from paper_class import PAPER_CLASS
from scipy.linalg import block_diag, expm

from estimation.adhesion import stationary_filter as module
from estimation.adhesion.creep_forces import smoothed_states
from estimation.adhesion.parameters import FORCES
from estimation.adhesion.stationary_filter import gear_equations, stationary_filter
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleClass

DT, SPEED = 0.004, 20.0
SAMPLES, SUB_STEPS = 30, 200


def model(vehicle_class: VehicleClass) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return transition, its noise, measured rows and their noise, in scaled states, by summing over sub-steps."""
    gear = gear_equations(vehicle_class.parameters, vehicle_class.bogie)
    rates, noise, scale = module._with_inputs(gear, vehicle_class.parameters.load)
    rates, noise = rates * scale / scale[:, None], noise / np.outer(scale, scale)
    step = expm(rates * DT / SUB_STEPS)
    halfway, process = expm(rates * 0.5 * DT / SUB_STEPS), np.zeros_like(rates)
    for _ in range(SUB_STEPS):
        process = step @ process @ step.T + halfway @ noise @ halfway.T * DT / SUB_STEPS
    wheelbase = None if vehicle_class.bogie is None else vehicle_class.bogie.wheelbase
    corner = 2.0 * math.pi * SPEED / FORCES.corner_wavelength
    variances = module._variances(gear, vehicle_class.sensors, wheelbase, DT, corner)
    return expm(rates * DT), process, module._measured(gear, len(rates), SPEED) * scale, np.diag(variances)


def limit_of(transition: FloatArray, process: FloatArray, rows: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the covariance before a sample that a filter ends at, by recursion."""
    predicted = np.eye(len(transition))
    for _ in range(60_000):
        gain = np.linalg.solve(rows @ predicted @ rows.T + noise, rows @ predicted).T
        kept = np.eye(len(transition)) - gain @ rows
        filtered = kept @ predicted @ kept.T + gain @ noise @ gain.T
        after = transition @ filtered @ transition.T + process
        if np.abs(after - predicted).max() < 1e-11 * np.abs(after).max():
            return after
        predicted = after
    return predicted


@pytest.fixture(scope="module")
def single() -> tuple[FloatArray, ...]:
    found = model(PAPER_CLASS)
    return (*found, limit_of(*found))


def test_the_stationary_gain_is_what_a_filter_ends_at(single: tuple[FloatArray, ...]) -> None:
    transition, _, rows, noise, predicted = single
    made = stationary_filter(PAPER_CLASS, DT, SPEED)
    np.testing.assert_allclose(made.transition, transition, rtol=1e-9, atol=1e-12)
    innovation = rows @ predicted @ rows.T + noise
    gain = np.linalg.solve(innovation, rows @ predicted).T
    np.testing.assert_allclose(made.gain, gain, rtol=1e-3, atol=1e-4 * np.abs(gain).max())
    np.testing.assert_allclose(made.innovation_std, np.sqrt(np.diag(innovation)), rtol=1e-3)


def test_filter_and_smoother_give_the_posterior_mean_of_all_samples(single: tuple[FloatArray, ...]) -> None:
    """A path that begins with that covariance, every state of every sample in one least squares problem."""
    transition, process, rows, noise, predicted = single
    made = stationary_filter(PAPER_CLASS, DT, SPEED)
    n, m = made.gain.shape
    measurements = np.sqrt(np.diag(noise)) * np.random.default_rng(7).standard_normal((SAMPLES, m))
    covariance = _path_covariance(transition, process, predicted)
    seen = block_diag(*[rows] * SAMPLES)
    total = seen @ covariance @ seen.T + block_diag(*[noise] * SAMPLES)
    mean = (covariance @ seen.T @ np.linalg.solve(total, measurements.ravel())).reshape(SAMPLES, n)
    found, _ = smoothed_states(made, measurements, np.ones(SAMPLES, bool), np.full(SAMPLES, SPEED))
    expected = mean * made.scale
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max(axis=0).max() + 1e-12)
    forces = slice(made.states, made.states + 2)
    np.testing.assert_allclose(found[:, forces], expected[:, forces], atol=5e-3 * np.abs(expected[:, forces]).max())


def _path_covariance(transition: FloatArray, process: FloatArray, first: FloatArray) -> FloatArray:
    n = len(transition)
    blocks = np.zeros((SAMPLES, SAMPLES, n, n))
    blocks[0, 0] = first
    for i in range(1, SAMPLES):
        blocks[i, i] = transition @ blocks[i - 1, i - 1] @ transition.T + process
        for j in range(i):
            blocks[i, j] = transition @ blocks[i - 1, j]
            blocks[j, i] = blocks[i, j].T
    return blocks.transpose(0, 2, 1, 3).reshape(SAMPLES * n, SAMPLES * n)


def test_a_speed_that_varies_moves_the_rolling_measurement_alone() -> None:
    """With y' known, psi + creepage is measured as y'/V: at another speed the innovation differs by y' (1/V - 1/V0)."""
    made = stationary_filter(PAPER_CLASS, DT, SPEED)
    measurements = np.random.default_rng(8).standard_normal((50, len(made.measured)))
    known = np.ones(50, bool)
    _, even = smoothed_states(made, measurements, known, np.full(50, SPEED))
    _, faster = smoothed_states(made, measurements, known, np.full(50, 1.2 * SPEED))
    assert even[0] == pytest.approx(faster[0])  # the state is zero there
    filtered = made.transition @ (made.gain @ measurements[0])
    velocity = filtered[1] * made.scale[1]
    assert faster[1, -1] - even[1, -1] == pytest.approx(velocity * (1.0 / (1.2 * SPEED) - 1.0 / SPEED))
    assert faster[1, :-1] == pytest.approx(even[1, :-1])


def test_speeds_are_rounded_to_filters_that_are_kept() -> None:
    made = stationary_filter(of_bogie(SOFT), DT, 20.1)
    assert stationary_filter(of_bogie(SOFT), DT, 19.9) is made
    assert stationary_filter(of_bogie(SOFT), DT, 20.6) is not made
    assert made.axles == 2
    assert made.accelerations == 6

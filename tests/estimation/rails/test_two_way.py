"""The mixed model against a general solver, and by properties."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from estimation.rails.parameters import RailsParameters
from estimation.rails.two_way import TwoWay, part

PARAMETERS = RailsParameters()


def drawn(seed: int, *, known_rail: bool = True, known_wheels: int = 0) -> TwoWay:
    rng = np.random.default_rng(seed)
    wheels, rails = 8, 4
    theta = rng.uniform(0.15, 0.4, wheels)
    rho = np.concatenate([[0.0], rng.uniform(-0.1, 0.2, rails - 1)])
    beta = np.concatenate([[0.0], rng.normal(0.0, 0.3, rails - 1)])
    wheel, rail = np.divmod(rng.permutation(wheels * rails)[:24], rails)
    std = rng.uniform(0.003, 0.01, len(wheel))
    value = theta[wheel] + rho[rail] + beta[rail] * (theta[wheel] - 0.27) + rng.normal(0.0, np.hypot(std, 0.006))
    known = np.full(wheels, np.nan)
    known[:known_wheels] = theta[:known_wheels]
    held = (np.arange(rails) == 0) & known_rail
    return TwoWay(wheel, rail, value, std**2, held, known, np.full(wheels, 0.003**2))


@pytest.mark.parametrize(("known_rail", "known_wheels"), [(True, 0), (False, 2), (True, 3)])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_solution_is_that_of_a_general_solver_for_the_same_tau(
    seed: int, known_wheels: int, *, known_rail: bool
) -> None:
    cells = drawn(seed, known_rail=known_rail, known_wheels=known_wheels)
    found = part(cells, PARAMETERS)
    w, s = len(cells.known_value), len(cells.known_rail)
    free = np.flatnonzero(~cells.known_rail)
    known = np.flatnonzero(np.isfinite(cells.known_value))

    def split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rho, beta = np.zeros(s), np.zeros(s)
        rho[free], beta[free] = x[w : w + len(free)], x[w + len(free) :]
        return x[:w], rho, beta

    def rows(x: np.ndarray) -> np.ndarray:
        theta, rho, beta = split(x)
        fitted = theta[cells.wheel] + rho[cells.rail] + beta[cells.rail] * (theta[cells.wheel] - found.centre)
        own = (cells.value - fitted) / np.sqrt(cells.variance + found.interaction**2)
        held = (cells.known_value - theta)[known] / np.sqrt(cells.known_variance[known] + found.interaction**2)
        return np.concatenate([own, held, beta[free] / PARAMETERS.slope_std])

    solved = least_squares(rows, np.concatenate([np.full(w, 0.27), np.zeros(2 * len(free))]), xtol=1e-14, ftol=1e-14)
    theta, rho, beta = split(solved.x)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)
    assert found.converged
    assert found.wheel == pytest.approx(theta, abs=1e-6)
    assert found.rail == pytest.approx(rho, abs=1e-6)
    assert found.slope == pytest.approx(beta, abs=1e-5)
    assert found.wheel_variance == pytest.approx(np.diag(covariance)[:w], rel=1e-3)
    both = np.concatenate([free, free + s])
    assert found.covariance[np.ix_(both, both)] == pytest.approx(covariance[w:, w:], rel=1e-2, abs=1e-7)


def test_without_an_anchor_the_sections_have_the_mean_0() -> None:
    found = part(drawn(3, known_rail=False), PARAMETERS)
    assert found.rail.sum() == pytest.approx(0.0, abs=1e-6)
    assert found.slope.sum() == pytest.approx(0.0, abs=1e-6)


def test_a_constant_that_is_moved_from_all_wheels_to_all_rails_fits_as_well() -> None:
    cells = drawn(4, known_rail=False)
    moved = TwoWay(
        cells.wheel, cells.rail, cells.value + 0.05, cells.variance, cells.known_rail, *[np.full(8, np.nan)] * 2
    )
    assert part(moved, PARAMETERS).rail == pytest.approx(part(cells, PARAMETERS).rail, abs=1e-5)


def test_intervals_cover_wheels_and_the_reference_wheel() -> None:
    rng = np.random.default_rng(5)
    wheels_in, rails_in = [], []
    for _ in range(40):
        w, s = 10, 4
        theta = rng.uniform(0.15, 0.4, w)
        rho = np.concatenate([[0.0], rng.uniform(-0.1, 0.2, s - 1)])
        beta = np.concatenate([[0.0], rng.normal(0.0, 0.3, s - 1)])
        chosen = np.flatnonzero(rng.uniform(size=w * s) < 0.7)
        wheel, rail = np.divmod(chosen, s)
        there, wheel = np.unique(wheel, return_inverse=True)
        theta = theta[there]
        std = rng.uniform(0.004, 0.012, len(wheel))
        value = theta[wheel] + rho[rail] + beta[rail] * (theta[wheel] - 0.27) + rng.normal(0.0, np.hypot(std, 0.006))
        nothing = np.full(len(theta), np.nan)
        found = part(TwoWay(wheel, rail, value, std**2, np.arange(s) == 0, nothing, nothing), PARAMETERS)
        wheels_in += list(np.abs(found.wheel - theta) < 1.96 * np.sqrt(found.wheel_variance))
        at, covariance = found.reference_wheel(0.2)
        true = 0.2 + rho + beta * (0.2 - 0.27)
        rails_in += list((np.abs(at - true) < 1.96 * np.sqrt(np.diag(covariance)))[1:])
    assert 0.92 <= np.mean(wheels_in) <= 0.985
    assert 0.90 <= np.mean(rails_in) <= 0.99


def test_what_is_left_is_what_was_drawn() -> None:
    found = [part(drawn(seed), RailsParameters(interaction_weight=0.5)).interaction for seed in range(20, 40)]
    assert float(np.sqrt(np.mean(np.square(found)))) == pytest.approx(0.006, abs=0.0025)

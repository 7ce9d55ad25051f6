"""Small inputs that run the compiled kernels of the estimators and of dampers: see ``kernel_runs``."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from estimation.bogie import curves, simulation
from estimation.bogie.simulation import INPUTS, STATES
from estimation.dampers.damper_filters import add_innovation_products
from estimation.estimators import filter_kernels, hidden_displacement
from estimation.estimators.block_filters import Inputs
from estimation.values.arrays import FloatArray, frozen_array


def _filters() -> Iterator[FloatArray]:
    rng = np.random.default_rng(10)
    n, q = 24, 16
    step_s, (place, yaw, known, lateral) = np.full(n, 0.012), 1e-4 * rng.standard_normal((4, n))
    step_s[[0, 12]] = 0.0
    inputs = Inputs(step_s, np.full(n, 20.0), place, yaw, known, lateral)
    mean, P = np.zeros(6), np.diag([1.0, 1.0, 1e-6, 1e-7, 1e-9, 1e-9])
    yield np.array([filter_kernels.extended(*inputs, 4e-5, 0.67, mean, P)])
    yield from (mean, P)
    slope, means, covariances = (
        np.linspace(0.0, 1.6, q),
        np.zeros((q, 3)),
        np.tile(np.diag([1.0, 1.0, 1e-6]), (q, 1, 1)),
    )
    draws = np.column_stack([rng.uniform(size=3), rng.standard_normal((3, q))])
    yield np.array([filter_kernels.particles(*inputs, 4e-5, 0.67, slope, means, covariances, draws)])
    yield from (slope, means)
    uneven = np.zeros(q)
    uneven[3] = 1.0
    filter_kernels.resample(uneven, slope, means, covariances, draws[0], 0.1)
    yield slope


def _hidden() -> Iterator[FloatArray]:
    rng = np.random.default_rng(11)
    x, grid = 5e-4 * rng.standard_normal(30), np.linspace(-2e-4, 2e-4, 5)
    curve = 0.2 * np.linspace(-1e-3, 1e-3, 41)
    likelihood, posterior = np.empty((2, 6, 5))
    yield np.array([hidden_displacement.weigh(x, 0.2 * x, 5, curve, -1e-3, 5e-5, grid, 5e-5, 0.5, likelihood)])
    prior = np.exp(-0.5 * (grid / 1e-4) ** 2)
    yield np.array([hidden_displacement.smooth(likelihood, prior / prior.sum(), 0.1, posterior)])
    sums, counts = np.zeros((2, 40))
    hidden_displacement.add_expected(x, 0.2 * x, 5, posterior, grid, -1e-3, 5e-5, 1.0, sums, counts)
    yield from (posterior, sums, counts)


def _dampers() -> Iterator[FloatArray]:
    rng = np.random.default_rng(13)
    q, v, n, samples = 3, 2, 2, 6
    products = np.zeros((q - 1, v + 1, v + 1))
    shapes = ((q, v, n, n), (q, v, 2, n), (q, v, n), (q, v, n))
    fixed = [frozen_array(0.3 * rng.standard_normal(shape), shape, name="filters") for shape in shapes]
    source = frozen_array([0, 1], (v,), np.int64, name="source")
    below, above = (frozen_array(rng.standard_normal((3, samples)), (3, samples), name="above") for _ in range(2))
    counted = frozen_array(np.arange(samples) % 3 > 0, (samples,), np.bool_, name="counted")
    add_innovation_products(fixed[0], fixed[1], fixed[2], fixed[3], source, below, above, counted, products)
    yield products


def _bogies() -> Iterator[FloatArray]:
    rng = np.random.default_rng(14)
    n = 12
    yield np.array([simulation.share_of_linear(0.5), simulation.share_of_linear(5.0)])
    track, values = 1e-4 * rng.standard_normal((2, n)), 0.3 * np.tile(np.linspace(-7e-3, 7e-3, 57), (2, 1))
    transitions, inputs = 0.9 * np.eye(STATES)[None], 1e-3 * rng.standard_normal((1, STATES, INPUTS))
    creep = np.array([9e6, 8e6, 2e4, 0.75, 0.46, 1120.0, 1813.0, 1e4, 0.54, 500.0])
    speed, table, out = np.full(n, 20.0), np.zeros(n, dtype=np.int64), np.zeros((STATES + 4, n))
    for farthest in (20e-3, 1e-9):
        through = simulation.step_through(
            track, track, speed, table, transitions, inputs, values, -7e-3, 4e3, farthest, 0.3, creep, out
        )
        yield np.array([float(through)])
    yield out
    cell, means = np.linspace(0.0, 3.0, n), np.zeros((57, 4))
    curves.add_hats(1e-3 * rng.standard_normal(n), -7e-3, 4e3, cell, means)
    yield means
    rows = np.zeros((2, 4))
    curves.add_means(rng.standard_normal((2, n)), cell, rows)
    yield rows


RUNS: tuple[Callable[[], Iterator[FloatArray]], ...] = (_filters, _hidden, _dampers, _bogies)

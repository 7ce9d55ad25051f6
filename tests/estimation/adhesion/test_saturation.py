"""The compiled sums of saturation: against plain numpy, and against the law of the simulator."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.creep_excess import creep_excess, saturated_sums

from estimation.adhesion.window_adhesion import add_saturated, excess_at, excess_table
from ingest.simulator.running import Creep, CreepLaw, share_of_linear

TABLE = excess_table()


def test_the_excess_is_the_law_of_the_simulator_solved_for_the_linear_force() -> None:
    law = Creep(CreepLaw.VERMEULEN_JOHNSON, 0.3).constants()
    for linear in np.linspace(1.0, 2000.0, 50):
        share = share_of_linear(law, linear, 1000.0, 0.0)
        assert 1.0 / share - 1.0 == pytest.approx(excess_at(TABLE, share * linear / 1000.0), abs=1e-5)
    assert excess_at(TABLE, 0.0) == pytest.approx(0.0, abs=1e-5)
    assert excess_at(TABLE, 5.0) == excess_at(TABLE, 0.98) > excess_at(TABLE, 0.97) + 0.01


def test_the_excess_is_that_of_numpy_at_every_utilisation() -> None:
    utilisations = np.concatenate([np.geomspace(1e-9, 1e-3, 50), np.linspace(0.0, 1.2, 200)])
    found = [excess_at(TABLE, one) for one in utilisations]
    np.testing.assert_allclose(found, creep_excess(utilisations), atol=1e-5)


def test_sums_are_those_of_numpy_sample_by_sample() -> None:
    rng = np.random.default_rng(3)
    n, places = 400, 5
    signals = rng.standard_normal((3, n)) * np.array([[1e-4], [1e-4], [2e-3]])
    forces = rng.standard_normal((3, n)) * np.array([[2000.0], [3000.0], [800.0]])
    place, bounds = rng.integers(0, places, n), 4e4 * np.array([0.5, 0.2, 0.1, 0.05])
    found = np.zeros((places, 4, len(bounds)))
    add_saturated(TABLE, signals, forces, place, bounds, found)
    np.testing.assert_allclose(found, saturated_sums(signals, forces, place, bounds, places), rtol=1e-4)

"""Compiled running integrals against those of arrays."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimation.motion.integration import integrate_once, integrate_twice, take_out_mean
from estimation.values.arrays import FloatArray

DT = 4e-3


def running_integrals(rows: FloatArray) -> FloatArray:
    found = np.zeros_like(rows)
    np.cumsum(0.5 * DT * (rows[:, 1:] + rows[:, :-1]), axis=1, out=found[:, 1:])
    return found


@given(seed=st.integers(0, 10_000), rows=st.integers(1, 5), n=st.integers(2, 400))
def test_integrals_are_those_of_arrays(seed: int, rows: int, n: int) -> None:
    accelerations = np.random.default_rng(seed).normal(3.0, 1.0, (rows, n))
    level = accelerations - accelerations.mean(axis=1, keepdims=True)
    take_out_mean(accelerations)
    np.testing.assert_allclose(accelerations, level, atol=1e-12)
    rates, displacements = np.empty((2, rows, n))
    integrate_twice(accelerations, DT, rates, displacements)
    plain = running_integrals(accelerations)
    lines = np.array([np.polyval(np.polyfit(np.arange(n), row, 1), np.arange(n)) for row in plain])
    np.testing.assert_allclose(rates, plain - lines, atol=1e-11)
    np.testing.assert_allclose(displacements, running_integrals(rates), atol=1e-14)
    once = np.empty(n)
    integrate_once(accelerations[0], DT, once)
    np.testing.assert_array_equal(once, running_integrals(accelerations[:1])[0])

"""Compiled running integrals, trapezoidal, starting at zero; every sum goes in the order of the samples."""

from __future__ import annotations

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray


@compiled(nogil=True)
def take_out_mean(rows: FloatArray) -> None:
    """Take its mean from each of the rows (m, n)."""
    n = rows.shape[1]
    for r in range(len(rows)):
        total = 0.0
        for i in range(n):
            total += rows[r, i]
        mean = total / n
        for i in range(n):
            rows[r, i] -= mean


@compiled(nogil=True)
def integrate_once(values: FloatArray, dt: float, integral: FloatArray) -> None:
    """Write the running integral (n,) of values (n,).

    Args:
        values: (n,) in any unit.
        dt: Sampling interval, s.
        integral: (n,), written.
    """
    total, half = 0.0, 0.5 * dt
    integral[0] = 0.0
    for i in range(1, len(values)):
        total += half * (values[i] + values[i - 1])
        integral[i] = total


@compiled(nogil=True)
def integrate_twice(accelerations: FloatArray, dt: float, rates: FloatArray, displacements: FloatArray) -> None:
    """Write running integrals (m, n) of the rows, less their mean and straight line, and the integrals of those.

    Args:
        accelerations: (m, n) in any unit.
        dt: Sampling interval, s.
        rates, displacements: (m, n), written.
    """
    n, half = accelerations.shape[1], 0.5 * dt
    middle = 0.5 * (n - 1)
    squares = n * (n * n - 1.0) / 12.0  # of the places around the middle
    for r in range(len(accelerations)):
        rate, total, moment = 0.0, 0.0, 0.0
        rates[r, 0] = 0.0
        for i in range(1, n):
            rate += half * (accelerations[r, i] + accelerations[r, i - 1])
            rates[r, i] = rate
            total += rate
            moment += rate * (i - middle)
        mean, slope = total / n, moment / squares
        displacement, before = 0.0, 0.0
        for i in range(n):
            rate = rates[r, i] - mean - slope * (i - middle)
            if i > 0:
                displacement += half * (rate + before)
            rates[r, i], displacements[r, i], before = rate, displacement, rate

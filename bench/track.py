"""Unknown track: conicity and alignment from the passes of a fleet alone, against their truth."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from scipy.optimize import isotonic_regression

from bench.report import BenchRow
from bench.track_fleet import AMPLITUDES, PAIRS, Fleet, fleet
from estimation.arrays import FloatArray
from estimation.contact.conicity import equivalent_conicity
from estimation.track.local_filter import smoother, without_slow_part
from estimation.track.panel import PanelParameters, init, update
from estimation.track.positions import PositionParameters, corrected, correlate, journeys, refine
from estimation.track.solution import PanelSolution, result

SEEDS = (0, 1)
PANEL = PanelParameters()
POSITIONS = PositionParameters()
ROUNDS = 4
SEEN = 50.0  # weight of a knot that counts


def rows() -> Iterator[BenchRow]:
    """Yield the rows: with and without errors of the position; half of the wheelsets on each pair."""
    for position_error, limit in ((False, 0.02), (True, 0.025)):
        errors: list[float] = []
        alignment, seconds = [], []
        for pair in PAIRS:
            for seed in SEEDS:
                simulated = fleet(pair, seed, position_error)
                began = time.perf_counter()
                solution = solve(simulated) if position_error else result(update(init(PANEL), list(simulated.passes)))
                seconds.append(time.perf_counter() - began)
                errors += conicity_errors(simulated, solution)
                alignment.append(1e3 * alignment_error(simulated, solution))
        p95 = float(np.quantile(errors, 0.95))
        what = "positions off by 20 m and 0.1 %" if position_error else "positions right"
        yield BenchRow(
            f"unknown alignment, constant gauge, {what}, 48 passes of 12 km: equivalent conicity, error over 1-3 mm",
            f"median {np.median(errors):.4f}, 95th percentile {p95:.4f} of {len(errors)} wheelsets; "
            f"{np.median(seconds):.0f} s on one core",
            f"95th percentile {limit}",
            p95 <= limit,
        )
        if not position_error:
            yield BenchRow(
                "the same: alignment up to 30 m of wavelength",
                f"{np.median(alignment):.3f} mm SD (each: {', '.join(f'{a:.3f}' for a in alignment)})",
                "0.06 mm SD",
                float(np.median(alignment)) <= 0.06,
            )


def solve(simulated: Fleet) -> PanelSolution:
    """Put the passes where they were, round by round, and return the last solution."""
    grouped = journeys(simulated.passes, POSITIONS)
    corrections = correlate(grouped, PANEL, POSITIONS)
    for _ in range(ROUNDS):
        moved = [item for journey, members in grouped.items() for item in corrected(members, corrections[journey])]
        solution = result(update(init(PANEL), moved))
        corrections = refine(grouped, corrections, solution, PANEL)
    return solution


def conicity_errors(simulated: Fleet, solution: PanelSolution) -> list[float]:
    """Return the mean absolute error of every wheelset over the amplitudes that its curve covers."""
    errors = []
    for serial, curve, weight in zip(solution.wheelsets, solution.curves[0], solution.weight, strict=True):
        found = _conicity(curve, weight, solution.knots)
        errors.append(float(np.nanmean(np.abs(found - simulated.conicity[serial]))))
    return errors


def _conicity(curve: FloatArray, weight: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the conicity of a curve y - d over R, made to rise."""
    seen = weight > SEEN
    rising = isotonic_regression(curve[seen]).x + 1e-9 * np.arange(seen.sum())
    return equivalent_conicity(rising, knots[seen], AMPLITUDES)


def alignment_error(simulated: Fleet, solution: PanelSolution) -> float:
    """Return the SD of the alignment's error, m, after the same high-pass, 300 m from the ends."""
    grid = np.arange(PANEL.points) * PANEL.step
    true = np.interp(grid, simulated.track.s, simulated.track.alignment)
    inner = np.isfinite(solution.alignment) & (grid > 300) & (grid < grid[-1] - 300)
    return float((solution.alignment - without_slow_part(true, smoother(PANEL.cut_off, PANEL.step)))[inner].std())

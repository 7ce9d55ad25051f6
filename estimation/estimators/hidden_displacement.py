"""R over y - d with the slow part of y - d, which the high-pass takes away, as a hidden state.

A wheelset whose contact jumps lie unlike on both sides runs off the centre as its amplitude grows. That slow part of
y - d is lost with the drift of the sensors: some 0.06 mm (1 std), by which contact jumps are blurred and moved. The
samples tell it, though: a contact jump shows in R at the moment at which it is passed.

The hidden displacement is a Markov chain on a grid. Forward-backward smoothing gives its probabilities with a curve; R,
averaged over what y - d then is expected to be, gives the next curve (expectation maximisation; Baum, Petrie, Soules
and Weiss 1970). The curve is free in cells of ``CELL``; at the end contact jumps are set in one place each.

Each run of samples is cut into chunks over which the hidden displacement is constant. From chunk to chunk it stays or
moves to a neighbouring value, so that it is distributed as its prior in the long run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from estimation.compiled import compiled
from estimation.contact.conicity import zero_crossing
from estimation.errors import ParameterError
from estimation.estimators.interface import (
    CELLS,
    REACH,
    CurveEstimate,
    EstimatorParameters,
    Replicates,
    counted,
    covered_range,
    curve_estimate,
    nothing,
    usable,
)
from estimation.estimators.parameters import RIVALS
from estimation.geometry.conicity import run_around, too_few_blocks
from estimation.geometry.sharpening import jumps_displaced
from estimation.tables.bin_table import group_of
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.reasons import Reason
from estimation.values.windows import Motion
from estimation.vehicle.regressors import YAW_TARGETS, regression


@dataclass(frozen=True, slots=True)
class HiddenParameters:
    """Prior and noise of the hidden displacement."""

    student_freedom: float = 6.0  # of Student's t, of the difference between R and the curve
    least_probability: float = 1e-3  # probability below which a value of the grid is left out of the sums
    cell_width: float = 0.04e-3  # m of y - d
    least_cell_samples: float = 20.0  # samples
    prior_std: float = 0.1e-3  # m, of the hidden displacement
    step_probability: float = 0.08  # probability of a step to a neighbour in a chunk
    chunk_s: float = 0.02
    curve_noise_std: float = 0.06e-3  # m, std of R about the curve
    sample_weight: float = 0.5  # how much one of neighbouring samples counts
    jump_place_std: float = 0.012e-3  # m, std of where a contact jump is found
    gauge_jump_share: float = 0.3  # of the std that the gauge moves contact jumps by
    steep_factor: float = 3.0  # times the median slope
    least_rise: float = 0.12e-3  # m of R
    most_rise_spread: float = 0.08e-3  # m, std of the rise over y - d
    jump_reach: float = 4.0e-3  # m of y - d: beyond are the flanges
    jump_side_distance: float = 1e-8  # m, from a jump to the points on both of its sides
    grid_step: float = 0.02e-3  # m
    grid_points: int = 15  # to either side
    expectation_rounds: int = 6


HIDDEN = HiddenParameters()
FREEDOM = HIDDEN.student_freedom
LIKELY = HIDDEN.least_probability
CELL = HIDDEN.cell_width


@compiled(nogil=True, error_model="numpy")
def weigh(
    displacement: FloatArray, difference: FloatArray, chunk: int, curve: FloatArray, first: float, width: float,
    grid: FloatArray, noise: float, share: float, likelihood: FloatArray,
) -> float:  # fmt: skip
    """Write the likelihood (k, s) of each value of the grid in each chunk, at most 1; return the logarithm left out.

    Args:
        displacement, difference: (n,) m, of a run; k chunks of it count.
        curve, first, width: (b,) m, R at the middles of cells, the lower edge of the first one and the width of all, m.
        grid: (s,) m, values of the hidden displacement.
        noise, share: Std of R, m, and how much one sample counts: neighbours have errors in common.
    """
    left_out = 0.0
    for k in range(len(likelihood)):
        most = -math.inf
        for s in range(len(grid)):
            total = 1.0  # product over the chunk: one logarithm for all
            for i in range(k * chunk, (k + 1) * chunk):
                place = (displacement[i] + grid[s] - first) / width - 0.5
                low = min(max(math.floor(place), 0), len(curve) - 2)
                part = min(max(place - low, 0.0), 1.0)
                apart = (difference[i] - curve[low] - part * (curve[low + 1] - curve[low])) / noise
                total *= 1.0 + apart * apart / FREEDOM
            likelihood[k, s] = -0.5 * share * (FREEDOM + 1.0) * math.log(total)
            most = max(most, likelihood[k, s])
        left_out += most
        for s in range(len(grid)):
            likelihood[k, s] = math.exp(likelihood[k, s] - most)
    return left_out


@compiled(nogil=True, error_model="numpy")
def smooth(likelihood: FloatArray, prior: FloatArray, move: float, posterior: FloatArray) -> float:
    """Write the probability (k, s) of each value in each chunk, given all chunks; return the logarithm of the evidence.

    Args:
        likelihood: (k, s) from :func:`weigh`.
        prior: (s,) probability of each value before any sample.
        move: Probability of a step to either neighbour that is as probable.
    """
    up, down = steps(prior, move)
    size = len(prior)
    evidence = 0.0
    state, following = prior.copy(), np.empty(size)
    for k in range(len(likelihood)):
        if k > 0:
            for s in range(size):
                following[s] = state[s] * (1.0 - up[s] - down[s])
                if s > 0:
                    following[s] += state[s - 1] * up[s - 1]
                if s + 1 < size:
                    following[s] += state[s + 1] * down[s + 1]
            state[:] = following
        state *= likelihood[k]
        total = state.sum()
        state /= total
        evidence += math.log(total)
        posterior[k] = state
    behind, ahead = np.ones(size), np.empty(size)
    for k in range(len(likelihood) - 2, -1, -1):
        behind *= likelihood[k + 1]
        for s in range(size):
            ahead[s] = behind[s] * (1.0 - up[s] - down[s])
            if s + 1 < size:
                ahead[s] += behind[s + 1] * up[s]
            if s > 0:
                ahead[s] += behind[s - 1] * down[s]
        behind[:] = ahead / ahead.sum()
        posterior[k] *= behind
        posterior[k] /= posterior[k].sum()
    return evidence


@compiled(nogil=True, error_model="numpy")
def steps(prior: FloatArray, move: float) -> tuple[FloatArray, FloatArray]:
    """Return the probabilities (s,) of a step up and of one down that keep the prior as it is."""
    up, down = np.zeros(len(prior)), np.zeros(len(prior))
    for s in range(len(prior) - 1):
        up[s] = move * min(1.0, prior[s + 1] / prior[s])
        down[s + 1] = move * min(1.0, prior[s] / prior[s + 1])
    return up, down


@compiled(nogil=True, error_model="numpy")
def add_expected(
    displacement: FloatArray, difference: FloatArray, chunk: int, posterior: FloatArray, grid: FloatArray,
    first: float, width: float, weight: float, sums: FloatArray, counts: FloatArray,
) -> None:  # fmt: skip
    """Add R and the weights of samples to the cells (b,) in which they are expected by the ``posterior`` (k, s)."""
    for k in range(len(posterior)):
        for s in range(len(grid)):
            probability = posterior[k, s]
            if probability > LIKELY:
                for i in range(k * chunk, (k + 1) * chunk):
                    cell = math.floor((displacement[i] + grid[s] - first) / width)
                    if 0 <= cell < len(sums):
                        sums[cell] += weight * probability * difference[i]
                        counts[cell] += weight * probability


FINE = round(2 * REACH / CELL)
MIDDLES = frozen_array((np.arange(FINE) + 0.5) * CELL - REACH, (FINE,), name="middles")  # m
GRID = HIDDEN.grid_step * np.arange(-HIDDEN.grid_points, HIDDEN.grid_points + 1.0)  # m, of the hidden displacement


@dataclass(frozen=True, slots=True)
class HiddenPiece(FrozenArrays):
    """The samples of one window, in runs within one block each."""

    displacement: Annotated[FloatArray, "n"]  # m
    difference: Annotated[FloatArray, "n"]  # m, R
    start: Annotated[IntArray, "r + 1"]  # first sample of each run, and n
    group: Annotated[IntArray, "r"]
    chunk: int  # samples
    weight: float


@dataclass(frozen=True, slots=True)
class HiddenState(FrozenArrays):
    """All samples, window by window: states share those of earlier ones, so that a window costs its own samples."""

    parameters: EstimatorParameters
    pieces: tuple[HiddenPiece, ...]
    derivatives: Annotated[FloatArray, CELLS, len(YAW_TARGETS) - 1]  # m, sums, of R by the logarithms of the parameters
    counts: Annotated[FloatArray, CELLS]  # effective samples by displacement
    stretches: int

    @property
    def samples(self) -> int:
        """How many there are."""
        return sum(len(piece.displacement) for piece in self.pieces)


@dataclass(frozen=True, slots=True)
class HiddenDisplacement:
    """Expectation maximisation of the curve, ``rounds`` times; none where y - d has lost nothing."""

    rounds: int = HIDDEN.expectation_rounds
    name: str = "hidden"
    title: str = "hidden slow displacement"

    def init(self, parameters: EstimatorParameters) -> HiddenState:
        """Return the state without samples."""
        return HiddenState(parameters, (), np.zeros((CELLS, len(YAW_TARGETS) - 1)), np.zeros(CELLS), 0)

    def update(self, state: HiddenState, motion: Motion, weight: float = 1.0) -> HiddenState:
        """Return the state with the samples of ``motion`` set behind its own, ``weight`` times each."""
        keep = usable(motion)
        if not keep.any():
            return replace(state, stretches=state.stretches + 1)
        equations = regression(motion, state.parameters.vehicle)
        R = equations.yaw_targets[keep] / equations.yaw[keep, -1:]
        x = motion.displacement[keep]
        at, block = np.flatnonzero(keep), motion.block[keep]
        # a run begins behind a gap, and with every block
        first = np.flatnonzero(np.append(True, (np.diff(at) > 1) | (np.diff(block) != 0)))
        cell = np.floor((x + REACH) / (2 * REACH / CELLS)).astype(np.int64)
        derivatives = np.column_stack([np.bincount(cell, column, CELLS) for column in R[:, 1:].T])
        if state.parameters.band_limited and not motion.sample_interval_s > 0.0:
            raise ParameterError("the interval between samples is not known", field="sample_interval_s")
        chunk = max(round(HIDDEN.chunk_s / motion.sample_interval_s), 1) if state.parameters.band_limited else 1
        piece = HiddenPiece(
            x, R[:, 0], np.append(first, len(x)), group_of(block[first], RIVALS.series_groups),
            chunk, weight,
        )  # fmt: skip
        return HiddenState(
            state.parameters,
            (*state.pieces, piece),
            state.derivatives + weight * derivatives,
            state.counts + weight * counted(x),
            state.stretches + 1,
        )

    def result(self, state: HiddenState) -> CurveEstimate:
        """Return the last curve, its intervals from groups left out and from what is systematic."""
        samples = state.samples
        span = covered_range(state.counts)
        if isinstance(span, Reason):
            return nothing(span, state.parameters, samples, state.stretches)
        groups = len({group for piece in state.pieces for group in piece.group.tolist()})
        if groups < RIVALS.fewest_groups:
            return nothing(too_few_blocks(groups), state.parameters, samples, state.stretches)
        sums, counts = self._expected(state)
        number = counts.sum(axis=0)
        enough = (number >= HIDDEN.least_cell_samples) & (span[0] < MIDDLES) & (span[1] > MIDDLES)
        inside = run_around(enough, len(enough) // 2)
        middles = MIDDLES[inside]
        sums, counts = sums[:, inside], counts[:, inside]
        total, number = sums.sum(axis=0), counts.sum(axis=0)
        present = np.flatnonzero(counts.any(axis=1))
        curve = total / number
        sharp = stepped(middles, curve)
        x, R = sharp.displacement, sharp.difference
        rest = number - counts[present]  # of all data where nothing else is left
        changes = np.where(rest > 0, (total - sums[present]) / np.where(rest > 0, rest, 1.0), curve) - curve
        left_out = R + np.array([np.interp(x, middles, change) for change in changes])
        shifted = R + _systematic(x, R, state)
        return curve_estimate(Replicates(x, R, left_out, shifted, samples, state.stretches), state.parameters)

    def _expected(self, state: HiddenState) -> tuple[FloatArray, FloatArray]:
        sums, counts = _expectation(state, None)
        for _ in range(self.rounds if state.parameters.band_limited else 0):
            number = counts.sum(axis=0)
            known = number >= min(HIDDEN.least_cell_samples, number.max())
            curve = np.asarray(np.interp(MIDDLES, MIDDLES[known], sums.sum(axis=0)[known] / number[known]))
            sums, counts = _expectation(state, curve)
        return sums, counts


def _expectation(state: HiddenState, curve: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return sums of R and numbers of samples (g, FINE), as likely as a curve makes it; None: as observed."""
    grid: FloatArray = np.zeros(1) if curve is None else GRID
    prior = np.exp(-0.5 * (grid / HIDDEN.prior_std) ** 2)
    prior /= prior.sum()
    sums, counts = np.zeros((2, RIVALS.series_groups, FINE))
    for piece in state.pieces:
        for group, first, last in zip(piece.group, piece.start[:-1], piece.start[1:], strict=True):
            x, R, chunk = piece.displacement[first:last], piece.difference[first:last], piece.chunk
            posterior = np.ones((len(x) // chunk, len(grid)))
            if curve is not None:
                likelihood = np.empty_like(posterior)
                weigh(x, R, chunk, curve, -REACH, CELL, grid, HIDDEN.curve_noise_std, HIDDEN.sample_weight, likelihood)
                smooth(likelihood, prior, HIDDEN.step_probability, posterior)
            add_expected(x, R, chunk, posterior, grid, -REACH, CELL, piece.weight, sums[group], counts[group])
    return sums, counts


def _systematic(x: FloatArray, curve: FloatArray, state: HiddenState) -> FloatArray:
    """Return what one std of each systematic error changes of the curve (p, n), m."""
    unknown = state.parameters.uncertainty
    coarse = 2 * REACH / CELLS * (np.arange(CELLS) + 0.5) - REACH
    seen = state.counts > 0
    means = state.derivatives[seen] / state.counts[seen, None]
    rows = [std * np.interp(x, coarse[seen], column) for std, column in zip(unknown.yaw(), means.T, strict=True)]
    middle = zero_crossing(x, curve)
    if state.parameters.band_limited and np.isfinite(middle):
        of_gauge = HIDDEN.gauge_jump_share * unknown.jump_position_std
        place = float(np.linalg.norm([HIDDEN.jump_place_std, unknown.jump_mean_std, of_gauge]))
        rows += [jumps_displaced(x, curve, middle, by) - curve for by in (place, -place)]
    return np.array(rows)


class Stepped(NamedTuple):
    """A curve with points close to both sides of each jump."""

    displacement: FloatArray  # (n,) m
    difference: FloatArray  # (n,) m
    jumps: FloatArray  # (j,) m, where they are


def stepped(x: FloatArray, curve: FloatArray) -> Stepped:
    """Return a curve (n,), m, at even distances of displacement, whose contact jumps are each in one place."""
    # A contact point jumps at one displacement. What is left of the error of y - d spreads the step over some 0.1 mm,
    # evenly to both sides; so the jump is in the mean of the rise. A rise that is spread further is left as it is:
    # wheels have steep parts without any jump.
    width = x[1] - x[0]
    middles, rise = 0.5 * (x[1:] + x[:-1]), np.diff(curve)
    near = np.abs(middles) < HIDDEN.jump_reach
    usual = float(np.median(rise[near])) if near.any() else 0.0
    steep = near & (rise > HIDDEN.steep_factor * max(usual, 0.0)) & (rise > 0.0)
    beyond = np.where(steep, rise - usual, 0.0)
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], steep.astype(np.int64), [0]])))
    places, steps = [], []
    smooth = rise.copy()
    for first, behind in bounds.reshape(-1, 2):
        part = slice(first, behind)
        step = float(beyond[part].sum())
        place = float(beyond[part] @ middles[part]) / step
        spread = np.sqrt(float(beyond[part] @ (middles[part] - place) ** 2) / step + width**2 / 12.0)
        if step >= HIDDEN.least_rise and spread <= HIDDEN.most_rise_spread:
            places.append(place)
            steps.append(step)
            smooth[part] -= beyond[part]
    jumps, heights = np.array(places), np.array(steps)
    points = np.sort(np.concatenate([x, jumps - HIDDEN.jump_side_distance, jumps + HIDDEN.jump_side_distance]))
    base = np.interp(points, x, np.append(curve[0], curve[0] + np.cumsum(smooth)))
    return Stepped(points, base + (points[:, None] > jumps) @ heights, jumps)

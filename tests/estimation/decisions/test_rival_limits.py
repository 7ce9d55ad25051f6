"""What the rival estimators need before they say anything: just inside of every limit, and just outside."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from smooth_wheelset import ideal, run

from estimation.estimators import series
from estimation.estimators.block_filters import BlockFilters, Inputs, Posterior, Prior
from estimation.estimators.hidden_displacement import stepped
from estimation.estimators.interface import (
    CELLS,
    WIDTH,
    EstimatorParameters,
    Replicates,
    beside,
    covered_range,
    curve_estimate,
)
from estimation.estimators.paper_algorithm import CellMeans, PaperAlgorithm, PaperState
from estimation.estimators.parameters import RIVALS
from estimation.estimators.series import KnownIrregularity, SeriesState
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.windows import Motion
from estimation.vehicle.vehicle_class import VehicleParameters

SURE = EstimatorParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0)))


class Noting(BlockFilters):
    """A filter of a line that notes the noise that it is given."""

    prior = Prior(np.zeros(2), np.ones(2))

    def __init__(self) -> None:
        self.noises: list[float] = []

    def basis(self, x: np.ndarray) -> np.ndarray:
        return np.column_stack([np.ones(len(x)), x])

    def filter_block(self, vehicle: VehicleParameters, inputs: Inputs, noise: float) -> Posterior:
        del vehicle, inputs
        self.noises.append(noise)
        return Posterior(np.zeros(2), np.eye(2), 1.0)


@cache
def motion() -> Motion:
    return ideal(run(120))


def blocks(samples: int, alignment: float = 0.0, sensors: float = 0.0) -> tuple[int, list[float]]:
    """Return how many blocks are filtered of one that a filter takes so many samples of, and the noise it is given."""
    parameters = replace(SURE, uncertainty=replace(SURE.uncertainty, alignment_noise=alignment))
    stride = max(round(RIVALS.step_s / motion().sample_interval_s), 1)
    first = np.arange(len(motion())) < 1 + stride * (samples - 1)
    one = replace(
        motion(),
        valid=motion().valid & first,
        block=np.zeros(len(motion()), dtype=np.int64),
        displacement_noise=sensors**2,
    )
    noting = Noting()
    return noting.update(noting.init(parameters), one).blocks, noting.noises


@pytest.mark.parametrize(("samples", "of_it"), [(99, 0), (100, 1)])
def test_a_filter_takes_blocks_of_a_hundred_samples(samples: int, of_it: int) -> None:
    assert blocks(samples)[0] == of_it


@pytest.mark.parametrize(("expected", "noise"), [(0.0, 0.03e-3), (0.029e-3, 0.03e-3), (0.05e-3, 0.05e-3)])
def test_a_filter_takes_no_displacement_for_better_known_than_three_hundredths(expected: float, noise: float) -> None:
    assert blocks(200, expected)[1] == [pytest.approx(noise)]
    assert blocks(200, 0.0, expected)[1] == [pytest.approx(noise)]


def test_a_filter_adds_the_noise_of_the_alignment_and_of_the_sensors_at_the_speed_of_the_window() -> None:
    assert blocks(200, 0.3e-3, 0.4e-3)[1] == [pytest.approx(0.5e-3)]


def test_a_range_is_covered_by_cells_of_a_hundred_samples() -> None:
    counts = np.full(CELLS, 100.0)
    counts[CELLS // 2 + 3] = 99.0
    found = covered_range(counts)
    assert isinstance(found, tuple)
    assert found[1] == pytest.approx(3 * WIDTH)
    x, flat = np.linspace(-1e-3, 1e-3, 81), np.zeros(81)
    assert beside(x, flat, np.full(CELLS, 0.1), np.full(CELLS, 100.0)).max() > 0.0
    assert not beside(x, flat, np.full(CELLS, 0.1), np.full(CELLS, 99.0)).any()


@pytest.mark.parametrize(("groups", "status"), [(3, Status.UNESTIMATED), (4, Status.ESTIMATED)])
def test_a_curve_needs_four_groups_of_blocks(groups: int, status: Status) -> None:
    x = np.linspace(-4e-3, 4e-3, 81)
    found = curve_estimate(Replicates(x, 0.4 * x, np.stack([0.4 * x] * groups), np.empty((0, 81)), 100, 1), SURE)
    assert found.status is status
    assert found.reason is None or found.reason.code is ReasonCode.TOO_FEW_BLOCKS


@pytest.mark.parametrize(("bins", "status"), [(4, Status.UNESTIMATED), (5, Status.ESTIMATED)])
def test_the_paper_needs_five_bins_around_the_centre(bins: int, status: Status) -> None:
    estimator = PaperAlgorithm()
    state: PaperState = estimator.init(SURE)
    theta, covariance, count = state.theta.copy(), state.covariance.copy(), state.count.copy()
    first = len(theta) // 2 - 2
    part = slice(first, first + bins)
    theta[part] = 1.0
    covariance[part] = np.eye(3)
    count[part] = 1000
    cells = CellMeans(
        np.zeros((RIVALS.paper_algorithm_groups, CELLS)),
        np.ones((RIVALS.paper_algorithm_groups, CELLS)),
        state.cells.derivatives,
    )
    found = estimator.result(replace(state, theta=theta, covariance=covariance, count=count, cells=cells))
    assert len(found.displacement) == (bins if status is Status.ESTIMATED else 0)
    assert found.reason is not None
    is_of_bins = found.reason.code is ReasonCode.TOO_FEW_BINS
    assert is_of_bins is (status is Status.UNESTIMATED)


@pytest.mark.parametrize(("times", "jumps"), [(2.95, 0), (3.05, 1)])
def test_a_jump_is_three_times_as_steep_as_the_curve_is_usually(times: float, jumps: int) -> None:
    x = 0.04e-3 * (np.arange(200) - 99.5)
    rise = np.full(199, 0.04e-3)
    rise[120:122] *= times
    assert len(stepped(x, np.append(0.0, np.cumsum(rise))).jumps) == jumps


def proportional(apart: float) -> SeriesState:
    """Return sums of whose unknowns two are nearly proportional: by ``apart``, the least eigenvalue."""
    state = KnownIrregularity().init(SURE)
    gram = np.eye(3)
    gram[1, 2] = gram[2, 1] = 1.0 - apart
    f11 = SURE.vehicle.longitudinal_creep_coefficient
    cross = np.zeros((3, state.cross.shape[2]))
    cross[:, 0] = gram @ [f11, 0.0, 0.0]
    groups = len(state.gram)
    return replace(
        state,
        gram=np.stack([gram / groups] * groups),
        cross=np.stack([cross / groups] * groups),
        squares=float(f11**2),
        counts=np.full(CELLS, 1000.0),
    )


@pytest.mark.parametrize(("apart", "code"), [(0.9e-9, ReasonCode.NOT_FINITE), (1.1e-9, None)])
def test_proportional_unknowns_are_not_solved(apart: float, code: ReasonCode | None) -> None:
    refusal = series._refusal(proportional(apart))
    assert (None if refusal is None else refusal.code) is code


def test_a_creep_coefficient_unlike_that_on_file_is_in_the_interval() -> None:
    """What a line cannot follow it takes for creep; by as much the conicity may be off."""
    estimator = KnownIrregularity()
    vehicle = SURE.vehicle
    found = {}
    for factor in (1.0, 1.3):
        on_file = replace(vehicle, longitudinal_creep_coefficient=factor * vehicle.longitudinal_creep_coefficient)
        state = estimator.update(estimator.init(replace(SURE, vehicle=on_file)), motion())
        found[factor] = estimator.result(state).conicity[4]
    right, other = found[1.0], found[1.3]
    assert right.value is not None
    assert right.std is not None
    assert other.value is not None
    assert other.std is not None
    assert other.value == pytest.approx(right.value, rel=0.02), "it does not rest on the coefficient on file"
    added = np.sqrt(other.std**2 - right.std**2)
    assert added == pytest.approx((1.0 - 1.0 / 1.3) * other.value, rel=0.25)

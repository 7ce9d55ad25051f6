"""Filters of blocks: against plain matrices, on a linear wheelset of known conicity, and where they diverge."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from estimators_by_hand import extended_filter
from smooth_wheelset import SmoothTable, ideal, run, track

from estimation.contact.conicity import equivalent_conicity
from estimation.errors import ParameterError
from estimation.estimators import block_filters
from estimation.estimators import filter_kernels as kernels
from estimation.estimators.block_filters import ExtendedKalman, Inputs, ParticleFilter, Posterior, follows
from estimation.estimators.catalogue import LinearConicity
from estimation.estimators.interface import CurveEstimate, Estimator, EstimatorParameters
from estimation.estimators.series import KnownIrregularity
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.windows import Motion
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.running_gear import RunningGear, simulate_gear

LEVER, NOISE = 2 * 0.7452 * 0.45, 4e-5
CERTAIN = EstimatorParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0)))
FILTERS = pytest.mark.parametrize("estimator", [ExtendedKalman(), ParticleFilter()], ids=lambda item: item.name)


def on_a_cone(conicity: float, n: int = 1500, seed: int = 1) -> Inputs:
    """Return what a filter gets of a kinematic wheelset of one conicity on a random track."""
    rng = np.random.default_rng(seed)
    dt, V = 0.012, 20.0
    x, yaw = np.zeros(n), np.zeros(n)
    lateral = rng.normal(0.0, np.sqrt(kernels.ALIGNMENT * V * dt), n)
    turn = rng.normal(0.0, np.sqrt(kernels.YAW_RATE * dt), n)
    for i in range(1, n):
        yaw[i] = yaw[i - 1] - dt * V / LEVER * 2 * conicity * x[i - 1] + turn[i]
        x[i] = x[i - 1] + dt * V * yaw[i] + lateral[i]
    step = np.full(n, dt)
    step[0] = 0.0
    seen = x + NOISE * rng.standard_normal(n), yaw + kernels.YAW * rng.standard_normal(n)
    return Inputs(step, np.full(n, V), *seen, np.zeros(n), np.zeros(n))


def estimated(estimator: Estimator[object], motion: Motion, parameters: EstimatorParameters) -> CurveEstimate:
    return estimator.result(estimator.update(estimator.init(parameters), motion))


@dataclass(frozen=True)
class SteppedTable(SmoothTable):
    """The smooth wheels with a contact jump of either wheel, 1 mm from the centre."""

    step: float = 1.0e-3  # m

    def left(self, x: np.ndarray) -> np.ndarray:
        return super().left(x) + self.step * (x > 1e-3)

    def right(self, x: np.ndarray) -> np.ndarray:
        return super().right(x) + self.step * (x < -1e-3)


@cache
def with_jumps(step: float) -> Motion:
    """Return the motion of a wheelset on wheels with contact jumps of ``step`` m."""
    return ideal(simulate_gear(RunningGear(), [SteppedTable(step=step)], track(1), np.full(120_000, 20.0), 10.0)[0])


def test_the_extended_filter_is_that_of_full_matrices() -> None:
    inputs = on_a_cone(0.12, 300)
    step = inputs.step_s.copy()
    step[150] = 0.0
    rng = np.random.default_rng(2)
    inputs = inputs._replace(step_s=step, known_rate=1e-3 * rng.standard_normal(300))
    mean, P = np.array([0.0, 0.0, 0.0, 3e-4, 0.0, 0.0]), np.diag([1.0, 1.0, 1e-6, 1e-7, 2e-9, 1e-9])
    plain_mean, plain_P, plain_square = extended_filter(inputs, NOISE, LEVER, mean, P)
    square = kernels.extended(*inputs, NOISE, LEVER, mean, P)
    np.testing.assert_allclose(mean, plain_mean, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(P, plain_P, rtol=1e-5, atol=1e-18)
    assert square == pytest.approx(plain_square, rel=1e-8)


def test_a_particle_has_the_filter_of_full_matrices() -> None:
    """With one slope known, a polynomial of degree 0 is the offset that the particle's filter has."""
    inputs, slope = on_a_cone(0.12, 200), 0.24
    mean, P = np.zeros((1, 3)), np.diag([1.0, 1.0, 1e-6])[None].copy()
    kernels.particles(*inputs, NOISE, LEVER, np.array([slope]), mean, P, np.zeros((1, 2)))
    big = np.array([0.0, 0.0, 0.0, 1e-3 * slope]), np.diag([1.0, 1.0, 1e-6, 1e-30])
    plain_mean, plain_P, _ = extended_filter(inputs, NOISE, LEVER, *big)
    np.testing.assert_allclose(mean[0], plain_mean[:3], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(P[0], plain_P[:3, :3], rtol=1e-4, atol=1e-16)


@pytest.mark.parametrize("conicity", [0.05, 0.2, 0.5])
def test_particles_find_the_conicity_of_a_cone_within_their_own_covariance(conicity: float) -> None:
    """Blocks of 18 s each: the mean is right, and the spread from block to block is what they state."""
    vehicle, off = VehicleParameters(), []
    for seed in range(20):
        found = ParticleFilter().filter_block(vehicle, on_a_cone(conicity, seed=seed), NOISE)
        assert 0.8 < found.square < 1.3
        off.append((found.mean[1] - 2e-3 * conicity) / np.sqrt(found.covariance[1, 1]))
    assert abs(np.mean(off)) < 1.0
    assert 0.5 < np.std(off) < 1.8


def test_only_a_filter_whose_innovations_fit_its_covariance_follows() -> None:
    good = Posterior(np.zeros(2), np.eye(2), 1.0)
    assert follows(good)
    assert follows(good._replace(square=2.99))
    assert not follows(good._replace(square=3.01))
    assert not follows(good._replace(square=float("nan")))
    assert not follows(good._replace(mean=np.array([np.inf, 0.0])))
    assert not follows(good._replace(covariance=np.diag([1.0, -1e-9])))


@FILTERS
def test_a_filter_that_diverges_publishes_nothing(estimator: Estimator[object]) -> None:
    motion = with_jumps(1.0e-3)
    found = estimated(estimator, motion, CERTAIN)
    assert found.status is Status.UNESTIMATED
    assert found.reason is not None
    assert found.reason.code is ReasonCode.DIVERGED
    assert all(item.value is None and item.reason == found.reason for item in found.conicity)
    assert estimated(estimator, ideal(run(120)), CERTAIN).status is Status.ESTIMATED


@pytest.mark.parametrize(("diverged", "code"), [(4, None), (5, ReasonCode.DIVERGED)])
def test_a_fifth_of_the_blocks_may_diverge(diverged: int, code: ReasonCode | None) -> None:
    estimator = ExtendedKalman()
    state = estimator.update(estimator.init(CERTAIN), ideal(run(120)))
    found = estimator.result(replace(state, blocks=20, diverged=diverged))
    assert (None if found.reason is None else found.reason.code) is code


@FILTERS
def test_without_the_interval_between_samples_a_filter_refuses(estimator: Estimator[object]) -> None:
    motion = replace(ideal(run(40)), sample_interval_s=float("nan"))
    with pytest.raises(ParameterError, match="sample_interval_s"):
        estimator.update(estimator.init(CERTAIN), motion)


@FILTERS
def test_the_weight_of_a_block_is_that_of_its_copies(estimator: Estimator[object]) -> None:
    motion = ideal(run(120))
    once = estimator.update(estimator.init(CERTAIN), motion, 0.5)
    twice = estimator.update(once, motion, 0.5)
    whole = estimator.update(estimator.init(CERTAIN), motion, 1.0)
    assert isinstance(twice, block_filters.FilterState)
    assert isinstance(whole, block_filters.FilterState)
    np.testing.assert_allclose(twice.precision, whole.precision, rtol=1e-12)
    np.testing.assert_allclose(twice.information, whole.information, rtol=1e-12)


def test_a_creep_coefficient_that_is_wrong_on_file_changes_only_those_who_use_it() -> None:
    motion = ideal(run(120))
    wrong = replace(CERTAIN, vehicle=VehicleParameters(longitudinal_creep_coefficient=0.7 * 7.44e6))
    changes = {}
    for estimator in (KnownIrregularity(), LinearConicity()):
        right, other = (estimated(estimator, motion, one).conicity[8].value for one in (CERTAIN, wrong))
        assert right is not None
        assert other is not None
        changes[estimator.name] = abs(other - right)
    assert changes["known_irregularity"] < 1e-6
    assert changes["linear"] > 0.005


@pytest.mark.parametrize(("share", "code"), [(4.5, None), (5.5, ReasonCode.DIVERGED)])
def test_a_creep_coefficient_that_is_not_that_of_the_vehicle_is_refused(share: float, code: ReasonCode | None) -> None:
    motion = ideal(run(120))
    vehicle = VehicleParameters(longitudinal_creep_coefficient=share * 7.44e6)
    found = estimated(KnownIrregularity(), motion, replace(CERTAIN, vehicle=vehicle))
    assert (None if found.reason is None else found.reason.code) is code


def test_what_a_line_cannot_follow_is_in_its_interval() -> None:
    """On a curve with jumps the covariance of a line is tiny and wrong; the published interval holds the truth."""
    x, table = np.linspace(-10e-3, 10e-3, 20_001), SteppedTable(step=0.5e-3)
    found = estimated(LinearConicity(), with_jumps(0.5e-3), CERTAIN)
    true = equivalent_conicity(x, table.left(x) - table.right(x), found.amplitude)
    assert found.own_std is not None
    for at in (4, 6, 8):  # 1.5, 2 and 2.5 mm
        one = found.conicity[at]
        assert one.value is not None
        assert one.low is not None
        assert one.high is not None
        assert one.low <= true[at] <= one.high
    assert abs(found.conicity[4].value - true[4]) > 20 * found.own_std[4]

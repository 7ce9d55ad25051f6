"""Estimators behind one interface: against truth, against the paper's plain form, and one that is in no catalogue."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from same_values import same_values
from scipy.interpolate import BSpline
from smooth_wheelset import SmoothTable, ideal, run

from estimation.contact.conicity import equivalent_conicity
from estimation.errors import ParameterError
from estimation.estimators import paper_algorithm
from estimation.estimators.catalogue import SHIPPED, CubicFit, LinearConicity, b_splines, estimator_named, estimators
from estimation.estimators.interface import CurveEstimate, Estimator, EstimatorParameters, Replicates, curve_estimate
from estimation.estimators.paper_algorithm import PaperAlgorithm
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.quantities import Status
from estimation.values.windows import Motion
from estimation.vehicle.regressors import regression
from estimation.vehicle.vehicle_class import VehicleParameters

CERTAIN = EstimatorParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0)))
ALL = pytest.mark.parametrize("estimator", estimators(), ids=lambda item: item.name)


def cut(motion: Motion, *at: int) -> list[Motion]:
    edges = [0, *at, len(motion)]
    names = [item.name for item in fields(Motion) if isinstance(getattr(motion, item.name), np.ndarray)]
    return [replace(motion, **{name: getattr(motion, name)[a:b] for name in names}) for a, b in pairwise(edges)]


def run_estimator(
    estimator: Estimator[Any], parameters: EstimatorParameters, motions: Iterable[Motion]
) -> CurveEstimate:
    state = estimator.init(parameters)
    for motion in motions:
        state = estimator.update(state, motion)
    return estimator.result(state)


def true_conicity(estimate: CurveEstimate) -> np.ndarray:
    x = np.linspace(-10e-3, 10e-3, 2001)
    return equivalent_conicity(x, SmoothTable().left(x) - SmoothTable().right(x), estimate.amplitude)


def test_the_catalogue_names_each_once_and_the_product_first() -> None:
    names = [item.name for item in estimators()]
    assert names[0] == SHIPPED
    assert len(set(names)) == len(names)


# error of the conicity at most; coarser ones 0.03
NEAR = {"bins": 0.002, "paper": 0.004, "cubic": 0.002, "extended_kalman": 0.004, "hidden": 0.002}


@pytest.mark.parametrize("estimator", estimators(), ids=lambda item: item.name)
def test_each_comes_near_a_smooth_wheelset(estimator: Estimator[Any]) -> None:
    found = run_estimator(estimator, CERTAIN, cut(ideal(run(300)), 60_000, 120_000, 200_000))
    true = true_conicity(found)
    errors = [abs(item.value - t) for item, t in zip(found.conicity, true, strict=True) if item.value is not None]
    assert found.status is Status.ESTIMATED
    assert len(errors) > 10
    assert max(errors) < NEAR.get(estimator.name, 0.03)
    assert found.stretches == 4
    for item in found.conicity:
        assert item.value is None or (item.low is not None and item.high is not None and item.low < item.high)


def test_one_slope_is_the_same_at_every_amplitude() -> None:
    found = run_estimator(LinearConicity(), CERTAIN, [ideal(run(120))])
    values = [item.value for item in found.conicity if item.value is not None]
    slope = np.diff(found.difference) / np.diff(found.displacement)
    np.testing.assert_allclose(values, slope[0] / 2, rtol=1e-3)
    np.testing.assert_allclose(slope, slope[0], rtol=1e-9)


@ALL
def test_a_state_is_not_touched_by_its_update(estimator: Estimator[Any]) -> None:
    first, second = cut(ideal(run(40)), 20_000)
    state = estimator.update(estimator.init(CERTAIN), first)
    copy = estimator.update(estimator.init(CERTAIN), first)
    estimator.update(state, second)
    assert same_values(getattr(state, "table", state), getattr(copy, "table", copy))


@ALL
def test_the_order_of_windows_does_not_matter(estimator: Estimator[Any]) -> None:
    parts = cut(ideal(run(120)), 30_000, 70_000)
    forth, back = (run_estimator(estimator, CERTAIN, order) for order in (parts, parts[::-1]))
    near = 1e-9 if estimator.name != "paper" else 1e-4  # the recursion starts with other samples
    np.testing.assert_allclose(forth.difference, back.difference, rtol=near, atol=near * 1e-3)
    assert (forth.samples, forth.stretches) == (back.samples, back.stretches)


@ALL
def test_a_window_of_little_weight_hardly_counts(estimator: Estimator[Any]) -> None:
    """The weight decides between two wheelsets: with 1e-6 the first is forgotten, with 1 it is not."""
    old, new = (ideal(run(120, cone=cone)) for cone in (0.05, 0.16))
    state = estimator.update(estimator.init(CERTAIN), new)
    alone = estimator.result(state)
    forgotten = estimator.result(estimator.update(state, old, 1e-6))
    both = estimator.result(estimator.update(state, old, 1.0))
    values = [item.conicity[4].value for item in (alone, forgotten)]
    assert None not in values
    assert abs(values[1] - values[0]) < 1e-4
    mixed = both.conicity[4].value
    assert mixed is None or abs(mixed - values[0]) > 1e-2, "or no one curve fits both"


def test_an_unknown_estimator_is_refused_with_those_there_are() -> None:
    with pytest.raises(ParameterError, match="no estimator 'kalman'; there are bins, linear, paper, cubic"):
        estimator_named("kalman")


def test_the_paper_in_stretches_is_the_paper_at_once() -> None:
    """At constant speed V is the same for every stretch, so that both run the same recursion."""
    motion = ideal(run(120))
    found = run_estimator(PaperAlgorithm(), CERTAIN, cut(motion, 9_000, 50_001))
    plain = paper_algorithm.estimate(motion, VehicleParameters(), PaperAlgorithm())
    at = np.rint((found.displacement - plain.centre[0]) / 0.25e-3).astype(int)
    np.testing.assert_allclose(found.difference, plain.rolling_radius_difference[at], rtol=1e-6)


def test_splines_are_those_of_scipy() -> None:
    x = np.linspace(-3.0, 2.999, 500)
    knots = np.arange(-3 - 3, 3 + 3 + 1, dtype=float)
    np.testing.assert_allclose(
        b_splines(x, -3.0, 1.0, 6), BSpline.design_matrix(x, knots, 3).toarray(), rtol=0, atol=1e-12
    )


@ALL
@pytest.mark.parametrize("keep", [0, 300])
def test_too_little_is_unestimated_with_a_reason(estimator: Estimator[Any], keep: int) -> None:
    motion = ideal(run(40))
    valid = np.arange(len(motion)) < keep
    found = run_estimator(estimator, CERTAIN, [replace(motion, valid=valid)])
    assert found.status is Status.UNESTIMATED
    assert found.reason
    assert all(item.value is None and item.reason for item in (*found.conicity, found.nonlinearity))


@ALL
def test_samples_that_are_not_valid_do_not_matter(estimator: Estimator[Any]) -> None:
    motion = ideal(run(120))
    bad = np.arange(len(motion)) % 7000 < 500
    spoilt = {
        name: np.where(bad, 1e3 if name == "yaw_acceleration" else np.nan, getattr(motion, name))
        for name in ("displacement", "yaw", "yaw_acceleration", "roll_rate")
    }
    clean = run_estimator(estimator, CERTAIN, [replace(motion, valid=~bad)])
    dirty = run_estimator(estimator, CERTAIN, [replace(motion, valid=~bad, **spoilt)])
    np.testing.assert_array_equal(clean.difference, dirty.difference)


def test_uncertain_parameters_widen_the_interval() -> None:
    parts = [ideal(run(120))]
    for estimator in (LinearConicity(), CubicFit()):
        sure = run_estimator(estimator, CERTAIN, parts).conicity[4]
        vague = run_estimator(estimator, EstimatorParameters(), parts).conicity[4]
        assert sure.std is not None
        assert vague.std is not None
        assert vague.std > 1.2 * sure.std  # what a line cannot follow is in both


def test_a_curve_without_groups_has_normal_intervals_of_its_shifts() -> None:
    x = np.linspace(-4e-3, 4e-3, 81)
    curve = Replicates(x, 0.4 * x, np.empty((0, 81)), np.stack([0.42 * x]), 100, 1)
    found = curve_estimate(curve, CERTAIN).conicity[4]
    assert found.value == pytest.approx(0.2, rel=1e-3)
    assert found.std == pytest.approx(0.01, rel=1e-2)
    assert found.high == pytest.approx(0.2 + 1.96 * 0.01, rel=1e-2)


@dataclass(frozen=True)
class Gaussian:
    """Mean and variance of the slope."""

    parameters: EstimatorParameters
    mean: float
    variance: float
    samples: int
    stretches: int


@dataclass(frozen=True)
class ScalarKalman:
    """A Kalman filter of one slope, sample by sample."""

    name: str = "kalman"
    title: str = "Kalman filter of one slope"

    def init(self, parameters: EstimatorParameters) -> Gaussian:
        return Gaussian(parameters, 0.2, 1.0, 0, 0)

    def update(self, state: Gaussian, motion: Motion, weight: float = 1.0) -> Gaussian:
        noise = 1e-8 / weight
        equations = regression(motion, state.parameters.vehicle)
        mean, variance = state.mean, state.variance
        R = equations.yaw_targets[:, 0] / equations.yaw[:, 1]
        for x, measured in zip(motion.displacement[::50], R[::50], strict=True):
            gain = variance * x / (x * x * variance + noise)
            mean, variance = mean + gain * (measured - x * mean), (1 - gain * x) * variance
        return Gaussian(
            state.parameters, mean, variance, state.samples + len(motion.displacement[::50]), state.stretches + 1
        )

    def result(self, state: Gaussian) -> CurveEstimate:
        x = np.linspace(-5e-3, 5e-3, 101)
        shifted = (state.mean + np.sqrt(state.variance)) * x
        curve = Replicates(x, state.mean * x, np.empty((0, 101)), shifted[None], state.samples, state.stretches)
        return curve_estimate(curve, state.parameters)


def test_a_kalman_filter_fits_in() -> None:
    kalman: Estimator[Gaussian] = ScalarKalman()
    parts = cut(ideal(run(120)), 50_000)
    found = run_estimator(kalman, CERTAIN, parts)
    line = run_estimator(LinearConicity(), CERTAIN, parts)
    assert found.conicity[4].value == pytest.approx(line.conicity[4].value, abs=0.02)

"""Estimators on wheelsets in a bogie, by the motion of ideal sensors: against truth, and without the frame's yaw."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bogie_run import COACH, SOFT, ideal_in_bogie, motions, wheelset
from smooth_wheelset import SmoothTable

from estimation.contact.conicity import equivalent_conicity
from estimation.estimators import paper_algorithm
from estimation.estimators.catalogue import SHIPPED, estimators
from estimation.estimators.interface import CurveEstimate, Estimator, EstimatorParameters
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.windows import Motion

CERTAIN = ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0))
CONES = {1: 0.1, 2: 0.14}  # of the front and the rear wheelset
# error of the conicity at most
NEAR = {
    "linear": 0.01,
    "paper": 0.007,
    "cubic": 0.0005,
    "extended_kalman": 0.001,
    "particles": 0.012,
    "known_irregularity": 0.01,
    "hidden": 0.0005,
}
WITH_INNOVATIONS = ("extended_kalman", "particles", "known_irregularity")
OTHERS = [item for item in estimators() if item.name != SHIPPED]


def estimated(estimator: Estimator[Any], yaw_stiffness: float, motion: Motion) -> CurveEstimate:
    parameters = EstimatorParameters(vehicle=wheelset(yaw_stiffness), uncertainty=CERTAIN)
    return estimator.result(estimator.update(estimator.init(parameters), motion))


def largest_error(found: CurveEstimate, axle: int) -> float:
    x = np.linspace(-10e-3, 10e-3, 2001)
    table = SmoothTable(CONES[axle])
    true = equivalent_conicity(x, table.left(x) - table.right(x), found.amplitude)
    errors = [abs(one.value - t) for one, t in zip(found.conicity, true, strict=True) if one.value is not None]
    assert len(errors) > 5
    return max(errors)


def without_frame(motion: Motion) -> Motion:
    return replace(motion, frame_yaw=None, frame_yaw_rate=None, frame_displacement=None)


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("yaw_stiffness", [SOFT, COACH])
@pytest.mark.parametrize("estimator", OTHERS, ids=lambda item: item.name)
def test_each_comes_near_both_wheelsets(estimator: Estimator[Any], yaw_stiffness: float, axle: int) -> None:
    found = estimated(estimator, yaw_stiffness, ideal_in_bogie(motions(yaw_stiffness)[axle - 1]))
    assert found.status is Status.ESTIMATED
    assert largest_error(found, axle) < NEAR[estimator.name]


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("estimator", OTHERS, ids=lambda item: item.name)
def test_without_the_yaw_of_the_frame_a_stiff_bogie_gives_another_curve(estimator: Estimator[Any], axle: int) -> None:
    found = estimated(estimator, COACH, without_frame(ideal_in_bogie(motions(COACH)[axle - 1])))
    if estimator.name in WITH_INNOVATIONS:
        assert found.reason is not None
        assert found.reason.code is ReasonCode.DIVERGED
    else:
        assert largest_error(found, axle) > 0.05


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("yaw_stiffness", [SOFT, COACH])
def test_the_printed_algorithm_has_the_moment_of_the_frame(yaw_stiffness: float, axle: int) -> None:
    motion = ideal_in_bogie(motions(yaw_stiffness)[axle - 1])
    table = SmoothTable(CONES[axle])
    errors = []
    for one in (motion, without_frame(motion)):
        found = paper_algorithm.estimate(one, wheelset(yaw_stiffness), paper_algorithm.PaperAlgorithm())
        use = np.isfinite(found.rolling_radius_difference) & (np.abs(found.centre) < 3e-3)
        true = table.left(found.centre) - table.right(found.centre)
        errors.append(float(np.abs(found.rolling_radius_difference - true)[use].max()))
    assert errors[0] < 0.1e-3  # of about 0.6 mm at 3 mm
    assert errors[1] > 4 * errors[0]

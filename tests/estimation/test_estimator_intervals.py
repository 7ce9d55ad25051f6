"""What the published intervals of the estimators hold: scales, parameters that are others, and why there is none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from smooth_wheelset import SmoothTable, ideal, run

from estimation.contact.conicity import equivalent_conicity
from estimation.estimators.catalogue import SHIPPED, estimators
from estimation.estimators.interface import (
    CurveEstimate,
    Estimator,
    EstimatorParameters,
    geometry_from_curve,
    nothing,
)
from estimation.estimators.paper_algorithm import PaperAlgorithm
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Motion

SURE = ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0))
RIVALS = pytest.mark.parametrize(
    "estimator", [one for one in estimators() if one.name != SHIPPED], ids=lambda one: one.name
)


@cache
def motion() -> Motion:
    return ideal(run(120))


def estimated(estimator: Estimator[Any], unknown: ParameterUncertainty, **other: Any) -> CurveEstimate:  # noqa: ANN401
    parameters = EstimatorParameters(uncertainty=unknown, **other)
    return estimator.result(estimator.update(estimator.init(parameters), motion()))


@RIVALS
def test_the_scales_of_both_axes_are_in_the_interval(estimator: Estimator[Any]) -> None:
    """A log of another place, or a sensor that is off, stretches y - d or R as a whole: no residual shows it."""
    sure = estimated(estimator, SURE).conicity[4]
    assert sure.value is not None
    assert sure.std is not None
    for name in ("displacement", "scale"):
        found = estimated(estimator, replace(SURE, **{name: 0.1})).conicity[4]
        assert found.value == sure.value
        assert found.std is not None
        added = np.sqrt(found.std**2 - sure.std**2)
        assert added == pytest.approx(0.1 * sure.value, rel=0.15)


def test_the_papers_interval_holds_a_creep_coefficient_that_is_another() -> None:
    vehicle = EstimatorParameters().vehicle
    other = replace(vehicle, longitudinal_creep_coefficient=1.08 * vehicle.longitudinal_creep_coefficient)
    found = estimated(PaperAlgorithm(), ParameterUncertainty(), vehicle=other)
    x = np.linspace(-10e-3, 10e-3, 2001)
    true = equivalent_conicity(x, SmoothTable().left(x) - SmoothTable().right(x), found.amplitude)
    assert found.own_std is not None
    known = [
        (one.low <= t <= one.high, abs(one.value - t) <= 1.96 * own)
        for one, t, own in zip(found.conicity, true, found.own_std, strict=True)
        if one.value is not None and one.low is not None and one.high is not None
    ]
    assert len(known) > 10
    assert all(covered for covered, _ in known)
    assert not any(covered for _, covered in known), "its own covariance holds nothing of it"


def test_the_paper_with_too_few_blocks_states_no_interval() -> None:
    """One block of running: nothing can be left out."""
    whole = replace(motion(), block=np.zeros(len(motion()), dtype=np.int64))
    estimator = PaperAlgorithm()
    found = estimator.result(estimator.update(estimator.init(EstimatorParameters()), whole))
    assert found.status is Status.UNESTIMATED
    assert found.reason is not None
    assert found.reason.code is ReasonCode.TOO_FEW_BLOCKS


def test_a_geometry_without_a_curve_gives_the_curves_own_reason() -> None:
    parameters, edges = EstimatorParameters(), np.linspace(-5e-3, 5e-3, 21)
    diverged = Reason(ReasonCode.DIVERGED, "the filter has diverged in 9 of 9 blocks of running")
    found = geometry_from_curve(nothing(diverged, parameters, 100, 3), parameters, np.zeros(20), edges, "k")
    assert found.reason == found.equivalent_conicity.reason == diverged
    assert found.status is Status.UNESTIMATED

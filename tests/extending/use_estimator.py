"""The estimator of the page is in the catalogue and estimates the conicity of a simulated wheelset."""

from __future__ import annotations

from smooth_wheelset import ideal, run

import estimation
from estimation.estimators.catalogue import estimator_named
from estimation.estimators.interface import EstimatorParameters

estimator = estimator_named("parabola")
state = estimator.init(EstimatorParameters())
found = estimator.result(estimator.update(state, ideal(run(300, cone=0.1))))
values = [estimate.value for estimate in found.conicity if estimate.value is not None]
assert values, found.reason
assert all(0.08 < value < 0.16 for value in values), values
print(estimation.__file__)  # noqa: T201 - for the test: which copy ran

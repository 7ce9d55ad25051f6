"""The estimators there are. A new one is a module beside the others and a line here."""

from __future__ import annotations

from typing import Any

from estimation.errors import ParameterError
from estimation.estimators.binned import BinnedGeometry
from estimation.estimators.cubic import CubicFit
from estimation.estimators.extended_kalman import ExtendedKalman
from estimation.estimators.hidden_displacement import HiddenDisplacement
from estimation.estimators.interface import Estimator
from estimation.estimators.known_irregularity import KnownIrregularity
from estimation.estimators.linear import LinearConicity
from estimation.estimators.paper_algorithm import PaperAlgorithm
from estimation.estimators.particle_filter import ParticleFilter

SHIPPED = "bins"
"""The estimator of the jobs as shipped: its sums over each window are what the bin tables store."""


def estimators() -> tuple[Estimator[Any], ...]:
    """Return all estimators, the shipped one first."""
    return (
        BinnedGeometry(),
        LinearConicity(),
        PaperAlgorithm(),
        CubicFit(),
        ExtendedKalman(),
        ParticleFilter(),
        KnownIrregularity(),
        HiddenDisplacement(),
    )


def estimator_named(name: str) -> Estimator[Any]:
    """Return the estimator called ``name``.

    Raises:
        ParameterError: There is none; the message lists those there are.
    """
    known = {item.name: item for item in estimators()}
    if name not in known:
        raise ParameterError(f"no estimator {name!r}; there are {', '.join(known)}", field="estimator")
    return known[name]

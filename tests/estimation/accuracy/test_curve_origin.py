"""Where on a known curve an estimated one has its origin."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.accuracy.fleet_accuracy import curve_origin
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode

CROSSING = 1.2e-3  # m


def true_difference(x: FloatArray) -> FloatArray:
    """Return R (n,), m, of unlike wheels: hardly steering up to 0.8 mm, zero at 1.2 mm."""
    return np.where(x < 0.8e-3, 0.05 * (x - 0.8e-3) - 0.08e-3, 0.2 * (x - CROSSING))


def estimated(curve: FloatArray, edges: FloatArray) -> WheelsetGeometry:
    bins = len(curve)
    unknown = Estimate.unknown(Reason(ReasonCode.OFFSET_NOT_OBSERVABLE, "not asked for"))
    nothing = BinValues(np.full(bins, np.nan), np.full(bins, np.nan), (BinStatus.UNOBSERVABLE,) * bins)
    return WheelsetGeometry(
        bin_edges=edges,
        samples=np.full(bins, 1000.0),
        rolling_radius_sum=nothing,
        rolling_radius_difference=BinValues(curve, np.full(bins, 2e-5), (BinStatus.ESTIMATED,) * bins),
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=np.array([3e-3]),
        conicity=(unknown,),
        reported_amplitude=3e-3,
        equivalent_conicity=unknown,
        nonlinearity=unknown,
        zero_crossing=unknown,
        windows=8,
        parameter_key="k",
        status=Status.ESTIMATED,
    )


@pytest.mark.parametrize("runs_at", [-0.4e-3, 0.05e-3, 1.1e-3, 1.7e-3])
def test_the_origin_of_unlike_wheels_is_found_wherever_the_wheelset_runs(runs_at: float) -> None:
    x = np.linspace(-8e-3, 8e-3, 641)
    edges = np.linspace(-4e-3, 4e-3, 17)
    curve = true_difference(0.5 * (edges[1:] + edges[:-1]) + runs_at)
    origin = curve_origin(estimated(curve - curve.mean(), edges), x, true_difference(x), CROSSING)
    assert origin.displacement == pytest.approx(runs_at, abs=1e-5)
    assert origin.difference == pytest.approx(curve.mean(), abs=2e-6)

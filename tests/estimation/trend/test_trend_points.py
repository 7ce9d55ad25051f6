"""Which amplitude a trend is about when not every interval covers 3 mm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from estimation.trend.extrapolation import conicity_points
from estimation.values.geometry import (
    BinStatus,
    BinValues,
    GeometryRecord,
    IntervalConicities,
    WheelsetGeometry,
    interval_conicities,
)
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, code_of


def known(value: float) -> Estimate:
    return Estimate(value, 0.01, value - 0.02, value + 0.02, 4.0, Status.ESTIMATED)


def interval(number: int, covered_mm: Sequence[float]) -> IntervalConicities:
    """Return a geometry whose conicity at an amplitude a (in mm) is 0.1 a + number."""
    nothing = BinValues(np.full(2, np.nan), np.full(2, np.nan), (BinStatus.TOO_FEW,) * 2)
    grid = (1.0, 1.25, 3.0, 4.0)
    conicity = tuple(known(0.1 * a + number) if a in covered_mm else Estimate.unknown(WHY) for a in grid)
    reference = max((a for a in covered_mm if a <= 3.0), default=3.0)
    geometry = WheelsetGeometry(
        bin_edges=np.array([-1e-3, 0.0, 1e-3]),
        samples=np.zeros(2),
        rolling_radius_sum=nothing,
        rolling_radius_difference=nothing,
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=np.array(grid) / 1000.0,
        conicity=conicity,
        reported_amplitude=reference / 1000.0,
        equivalent_conicity=conicity[grid.index(reference)],
        nonlinearity=Estimate.unknown(WHY),
        zero_crossing=Estimate.unknown(WHY),
        windows=4,
        parameter_key="k",
        status=Status.ESTIMATED,
    )
    record = GeometryRecord(
        "W1", 0, number, 1000.0 * number, 10 * number, 10 * number + 8, geometry, f"d{number}", {}, {}, "v", 1
    )
    return interval_conicities(record)


WHY = Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "amplitude not covered")
# From less than 1.5 mm nothing is extrapolated.
ALL, TO_1_25, TO_1 = (1.0, 1.25, 3.0, 4.0), (1.0, 1.25), (1.0,)


def test_three_millimetres_where_most_intervals_cover_it() -> None:
    chosen = conicity_points([interval(0, ALL), interval(1, TO_1_25), interval(2, ALL), interval(3, ALL)])
    assert chosen.quantity == "equivalent_conicity"
    assert [p.value for p in chosen.points] == pytest.approx([0.3, 2.3, 3.3])
    assert "1 of 4" in str(chosen.note)
    assert (chosen.points[1].mileage_km, chosen.points[1].measured_ns) == (2000.0, 24)


def test_the_largest_amplitude_that_most_cover_and_never_a_mixture() -> None:
    chosen = conicity_points([interval(0, ALL), interval(1, TO_1_25), interval(2, TO_1_25), interval(3, TO_1)])
    assert chosen.quantity == "equivalent_conicity_1.25_mm"
    assert chosen.amplitude == pytest.approx(1.25e-3)
    assert [p.value for p in chosen.points] == pytest.approx([0.125, 1.125, 2.125])
    assert "1.25 mm" in str(chosen.note)


def test_the_one_most_cover_where_none_is_covered_by_most() -> None:
    chosen = conicity_points([interval(0, (3.0,)), interval(1, (1.25,)), interval(2, (1.25,))])
    assert chosen.quantity == "equivalent_conicity_1.25_mm"
    assert len(chosen.points) == 2


def test_nothing_to_go_by_says_why() -> None:
    assert code_of(conicity_points([]).note) is ReasonCode.NO_GEOMETRY_SINCE_REPROFILING
    none = conicity_points([interval(0, ())])
    assert none.points == ()
    assert "amplitude not covered" in str(none.note)


def test_what_a_young_wheelset_did_not_reach_long_ago_does_not_keep_its_trend_from_three_millimetres() -> None:
    histories = [interval(day, TO_1_25 if day < 5 else ALL) for day in range(12)]
    chosen = conicity_points(histories)
    assert chosen.quantity == "equivalent_conicity"
    assert len(chosen.points) == 7
    assert "5 of 12 intervals do not cover it" in str(chosen.note)
    assert conicity_points(histories[:7]).quantity != "equivalent_conicity"

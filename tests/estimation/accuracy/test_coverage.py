"""Whether an interval covers a measurement, by hand, and the interval of a count against published values."""

from __future__ import annotations

import pytest

from estimation.accuracy.fleet_accuracy import CoverageCount, covers
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode

UNKNOWN = Estimate.unknown(Reason(ReasonCode.TOO_FEW_BINS, "too few"))
ESTIMATED = Estimate(0.20, 0.01, 0.17, 0.24, 9.0, Status.ESTIMATED)  # 0.03 down, 0.04 up


def measured(value: float, std: float = 0.0) -> Estimate:
    return Estimate(value, std, value, value, 0.0, Status.ESTIMATED)


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        (0.24, 0.0, True),
        (0.2401, 0.0, False),
        (0.17, 0.0, True),
        (0.1699, 0.0, False),
        (0.2499, 0.0153, True),  # 1.96 * 0.0153 = 0.03: the square root of 0.04^2 + 0.03^2 is 0.05
        (0.2501, 0.0153, False),
        (0.1577, 0.0153, True),  # below, of 0.03^2 + 0.03^2: 0.0424
        (0.1574, 0.0153, False),
    ],
)
def test_the_side_of_the_interval_and_the_error_of_the_measurement_add_as_squares(
    value: float, std: float, *, expected: bool
) -> None:
    assert covers(ESTIMATED, measured(value, std)) is expected


def test_what_is_unknown_is_not_compared() -> None:
    assert covers(UNKNOWN, measured(0.2)) is None
    assert covers(ESTIMATED, UNKNOWN) is None


@pytest.mark.parametrize(
    ("covered", "compared", "low", "high"),
    [(0, 10, 0.0, 0.3085), (9, 10, 0.5550, 0.9975), (10, 10, 0.6915, 1.0), (95, 100, 0.8872, 0.9836)],
)
def test_the_interval_of_a_count_is_that_of_clopper_and_pearson(
    covered: int, compared: int, low: float, high: float
) -> None:
    count = CoverageCount.of([True] * covered + [False] * (compared - covered) + [None] * 3)
    assert (count.compared, count.covered) == (compared, covered)
    assert count.fraction == pytest.approx(covered / compared)
    assert count.interval_95 == pytest.approx((low, high), abs=5e-5)


def test_nothing_compared_has_no_share() -> None:
    count = CoverageCount.of([None])
    assert count.fraction is None
    assert count.interval_95 is None

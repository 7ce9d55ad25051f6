"""Whether an interval covers a measurement, by hand, and the interval of a count against known ones."""

from __future__ import annotations

import pytest
from scipy.special import betaincinv

from estimation.accuracy.fleet_accuracy import ConicityPair, CoverageCount, covers
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


def pair(value: float | None, std: float = 0.0) -> ConicityPair:
    return ConicityPair(3e-3, UNKNOWN if value is None else measured(value, std), ESTIMATED)


@pytest.mark.parametrize(("covered", "compared"), [(1, 10), (9, 10), (95, 100)])
def test_the_interval_of_a_count_of_many_wheelsets_is_that_of_jeffreys(covered: int, compared: int) -> None:
    found = [pair(0.21)] * covered + [pair(0.3)] * (compared - covered) + [pair(None)] * 3
    count = CoverageCount.of((f"WS-{place}", one) for place, one in enumerate(found))
    assert (count.compared, count.covered) == (compared, covered)
    assert count.fraction == pytest.approx(covered / compared)
    known = [float(betaincinv(covered + 0.5, compared - covered + 0.5, share)) for share in (0.025, 0.975)]
    assert count.interval_95 == pytest.approx(known, abs=2e-3)


def test_measurements_of_one_wheelset_do_not_count_as_many() -> None:
    found = [pair(0.21)] * 36 + [pair(0.3)] * 4
    apart = CoverageCount.of((f"WS-{place}", one) for place, one in enumerate(found))
    alike = CoverageCount.of((f"WS-{place // 4}", one) for place, one in enumerate(found))
    assert apart.interval_95 is not None
    assert alike.interval_95 is not None
    assert alike.interval_95[0] < apart.interval_95[0] - 0.05


def test_z_is_the_error_over_the_standard_deviation_of_both() -> None:
    assert pair(0.21).z == pytest.approx(-1.0)
    assert pair(0.17, std=0.02).z == pytest.approx(0.03 / 5**0.5 / 0.01)
    assert pair(None).z is None
    count = CoverageCount.of([("WS-1", pair(0.21)), ("WS-2", pair(0.17)), ("WS-3", pair(None))])
    assert count.z_rms == pytest.approx(5**0.5)
    assert count.mean_z == pytest.approx(1.0)


def test_nothing_compared_has_no_share() -> None:
    count = CoverageCount.of([("WS-1", pair(None))])
    assert (count.compared, count.fraction, count.interval_95, count.z_rms, count.mean_z) == (0, None, None, None, None)

"""Which amplitude a trend is about: just enough intervals that cover it, and one less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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

WHY = Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "amplitude not covered")
GRID = (1.0, 1.25, 3.0, 4.0)  # mm; from less than 1.5 nothing is extrapolated
TO_3, TO_1_25, NOTHING = (1.0, 1.25, 3.0), (1.0, 1.25), ()


def interval(number: int, covered_mm: Sequence[float], reported_mm: float = np.nan) -> IntervalConicities:
    """Return a geometry whose conicity at an amplitude a (mm) is 0.1 a + its number, 0.5 at the reported one."""
    nothing = BinValues(np.full(2, np.nan), np.full(2, np.nan), (BinStatus.TOO_FEW,) * 2)
    conicity = tuple(
        Estimate(0.1 * a + number, 0.01, 0.0, 1.0, 4.0, Status.ESTIMATED) if a in covered_mm else Estimate.unknown(WHY)
        for a in GRID
    )
    reported = np.isfinite(reported_mm)
    geometry = WheelsetGeometry(
        bin_edges=np.array([-1e-3, 0.0, 1e-3]),
        samples=np.zeros(2),
        rolling_radius_sum=nothing,
        rolling_radius_difference=nothing,
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=np.array(GRID) / 1000.0,
        conicity=conicity,
        reported_amplitude=reported_mm / 1000.0,
        equivalent_conicity=Estimate(0.5, 0.02, 0.4, 0.6, 4.0, Status.ESTIMATED) if reported else Estimate.unknown(WHY),
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


def history(*covered: Sequence[float]) -> list[IntervalConicities]:
    return [interval(number, item) for number, item in enumerate(covered)]


@pytest.mark.parametrize(("with_3", "amplitude"), [(6, 3e-3), (5, 1.25e-3)])
def test_three_quarters_of_the_latest_eight_intervals_must_cover_three_millimetres(
    with_3: int, amplitude: float
) -> None:
    records = history(*[TO_1_25] * (8 - with_3), *[TO_3] * with_3)
    assert conicity_points(records).amplitude == pytest.approx(amplitude)
    assert conicity_points(records[:2] * 4 + records).amplitude == pytest.approx(amplitude)


def test_the_ninth_interval_from_the_end_has_no_say_and_the_eighth_has() -> None:
    assert conicity_points(history(TO_3, TO_1_25, TO_1_25, *[TO_3] * 5)).amplitude == pytest.approx(3e-3)
    assert conicity_points(history(TO_3, *[TO_1_25] * 3, *[TO_3] * 5)).amplitude == pytest.approx(1.25e-3)
    assert conicity_points(history(TO_1_25, *[TO_1_25] * 2, *[TO_3] * 6)).amplitude == pytest.approx(3e-3)


@pytest.mark.parametrize(
    ("covered", "amplitude"), [((TO_1_25, TO_3, TO_3, TO_3), 3e-3), ((TO_1_25, TO_3, TO_3), 1.25e-3)]
)
def test_of_few_intervals_three_quarters_too(covered: tuple[Sequence[float], ...], amplitude: float) -> None:
    assert conicity_points(history(*covered)).amplitude == pytest.approx(amplitude)


def test_where_no_amplitude_is_covered_by_enough_the_most_frequent_and_then_the_largest_counts() -> None:
    assert conicity_points(history((1.0,), (1.0,), (1.25,), (3.0,))).amplitude == pytest.approx(1e-3)
    assert conicity_points(history((1.0,), (1.25,), (3.0,))).amplitude == pytest.approx(3e-3)


def test_larger_amplitudes_than_three_millimetres_count_only_where_nothing_smaller_is_covered() -> None:
    chosen = conicity_points(history((3.0, 4.0), (4.0,), (4.0,), (4.0,)))
    assert (chosen.quantity, len(chosen.points)) == ("equivalent_conicity", 1)
    chosen = conicity_points(history((4.0,), (4.0,)))
    assert (chosen.quantity, len(chosen.points)) == ("equivalent_conicity_4_mm", 2)


def test_points_and_notes() -> None:
    whole = conicity_points(history(TO_3, TO_3))
    assert (whole.quantity, whole.note) == ("equivalent_conicity", None)
    assert [(p.mileage_km, p.measured_ns, p.value, p.std) for p in whole.points] == [
        (0.0, 4, pytest.approx(0.3), 0.01),
        (1000.0, 14, pytest.approx(1.3), 0.01),
    ]
    some = conicity_points(history(TO_3, TO_3, NOTHING, TO_3))
    assert code_of(some.note) is ReasonCode.INTERVALS_LEFT_OUT
    assert "1 of 4 intervals" in str(some.note)
    other = conicity_points(history((1.0,), (1.0,), NOTHING))
    assert (other.quantity, other.amplitude) == ("equivalent_conicity_1_mm", pytest.approx(1e-3))
    assert code_of(other.note) is ReasonCode.OTHER_AMPLITUDE
    assert "at 1 mm" in str(other.note)
    assert "1 of 3 intervals" in str(other.note)


def test_the_reported_amplitude_is_one_of_those_of_its_interval() -> None:
    """Off the grid too; equal amplitudes are those within a micrometre's half."""
    chosen = conicity_points([interval(0, (), 1.4), interval(1, (), 1.4)])
    assert chosen.quantity == "equivalent_conicity_1.4_mm"
    assert [p.value for p in chosen.points] == [0.5, 0.5]
    near = conicity_points([interval(0, (), 3.0004)])
    assert near.quantity == "equivalent_conicity"
    apart = conicity_points([interval(0, (), 2.9994)])
    assert apart.quantity == "equivalent_conicity_2.999_mm"


def test_nothing_covered_is_a_reason() -> None:
    assert code_of(conicity_points([]).note) is ReasonCode.NO_GEOMETRY_SINCE_REPROFILING
    none = conicity_points(history(NOTHING, NOTHING))
    assert (none.points, none.amplitude, none.quantity) == ((), 3e-3, "equivalent_conicity")
    assert code_of(none.note) is ReasonCode.NO_CONICITY
    assert "amplitude not covered" in str(none.note)
    reasons = [Reason(ReasonCode.NOT_FINITE, text) for text in ("d", "c", "b", "a")]
    many = [replace(interval(0, ()), reason=reason) for reason in (None, *reasons)]
    assert str(conicity_points(many).note).endswith(": a, b, c")

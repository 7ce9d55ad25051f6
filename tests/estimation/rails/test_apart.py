"""Wheel and rail apart: the truth of drawn fleets, what is refused, and where the limits are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_cells import AMPLITUDE, DESIGN, SECTIONS, anchors, cell, drawn_fleet, wheel

from estimation.errors import ParameterError
from estimation.rails.apart import rails_apart, reported
from estimation.rails.cell import Anchors
from estimation.rails.parameters import RailsParameters
from estimation.values.opinions import KnownWheel, RailPart, RailsApart, RailsReference, SectionConicity, WheelPart
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode

PARAMETERS = RailsParameters()


def apart(
    cells: list[SectionConicity], held: Anchors | None = None, parameters: RailsParameters = PARAMETERS
) -> RailsApart:
    return rails_apart(cells, AMPLITUDE, held or anchors("A"), parameters)


def rails(found: RailsApart, section: str) -> RailPart:
    (one,) = [one for one in found.rails if one.rail.section == section]
    return one


def wheels(found: RailsApart, serial: str) -> WheelPart:
    (one,) = [one for one in found.wheels if one.wheel.wheelset == serial]
    return one


def two_sections(wear: float, count: int = 6, std: float = 0.004, spread: float = 0.0) -> list[SectionConicity]:
    """Return cells of wheels on A and on B, whose rails add ``wear``, without noise."""
    found = []
    for number in range(count):
        theta = 0.2 + 0.02 * number
        found += [cell(wheel(f"W{number}"), "A", theta, std=std)]
        found += [cell(wheel(f"W{number}"), "B", theta + wear + spread * (-1) ** number, std=std)]
    return found


def test_worn_rails_are_not_blamed_on_the_wheels() -> None:
    apart_errors, blamed, covered = [], [], []
    for seed in range(8):
        fleet = drawn_fleet(seed)
        found = apart(fleet.cells)
        for number, true in enumerate(fleet.wheels):
            one = wheels(found, f"W{number:02d}").conicity[1]
            assert one.value is not None
            assert one.low is not None
            assert one.high is not None
            apart_errors.append(one.value - true)
            covered.append(one.low <= true <= one.high)
            own = [c.conicity[1] for c in fleet.cells if c.wheel.wheelset == f"W{number:02d}"]
            blamed.append(float(np.mean(own)) - true)
    assert np.quantile(np.abs(apart_errors), 0.95) < 0.02
    assert np.mean(np.abs(apart_errors)) < 0.25 * np.mean(np.abs(blamed))
    assert 0.90 <= np.mean(covered) <= 1.0


def test_the_reference_wheel_is_covered_on_all_sections() -> None:
    covered = []
    for seed in range(20):
        fleet = drawn_fleet(seed)
        found = apart(fleet.cells)
        for section, true in zip(SECTIONS[1:], fleet.reference_wheel()[1:], strict=True):
            one = rails(found, section).reference_wheel[0]
            if one.low is not None and one.high is not None:
                covered.append(one.low <= true <= one.high)
    assert len(covered) > 40
    assert 0.90 <= np.mean(covered) <= 1.0


def test_any_order_gives_the_same_answer() -> None:
    cells = drawn_fleet(3).cells
    whole = apart(cells)
    again = apart(cells[::-1])
    assert again.rails == whole.rails
    assert again.wheels == whole.wheels


def test_rails_that_are_known_have_no_part_and_no_interval() -> None:
    known = rails(apart(two_sections(0.1)), "A")
    assert known.reference is RailsReference.KNOWN_RAILS
    assert (known.part[0].value, known.part[0].std) == (0.0, 0.0)
    assert (known.reference_wheel[0].value, known.excess[0].value) == (DESIGN, 0.0)


def test_without_an_anchor_only_differences_are_published() -> None:
    found = apart(two_sections(0.1), anchors())
    one = rails(found, "B")
    assert one.reference is RailsReference.MEAN
    assert one.part[0].value == pytest.approx(0.05, abs=1e-4)
    for refused in (one.reference_wheel[0], one.excess[0], wheels(found, "W0").conicity[0]):
        assert refused.value is None
        assert refused.reason is not None
        assert refused.reason.code is ReasonCode.RAILS_LEVEL_OPEN


def test_measured_wheels_hold_the_level_in_the_place_of_known_rails() -> None:
    cells = two_sections(0.1)
    known = tuple(KnownWheel(wheel(f"W{n}"), (0.2 + 0.02 * n) * np.ones(2), 0.003 * np.ones(2)) for n in (0, 1, 3))
    found = apart(cells, replace(anchors(), known_wheels=known))
    assert rails(found, "A").reference is RailsReference.MEASURED_WHEELS
    assert rails(found, "A").part[0].value == pytest.approx(0.0, abs=0.004)
    assert rails(found, "B").part[0].value == pytest.approx(0.1, abs=0.004)
    assert wheels(found, "W5").conicity[0].value == pytest.approx(0.3, abs=0.006)


def test_a_section_that_no_wheelset_connects_is_refused() -> None:
    lonely = [cell(wheel(f"X{n}"), "D", 0.3) for n in range(3)]
    found = apart([*two_sections(0.1), *lonely])
    for refused in (rails(found, "D").part[0], wheels(found, "X0").conicity[0]):
        assert refused.status is Status.UNESTIMATED
        assert refused.reason is not None
        assert refused.reason.code is ReasonCode.RAILS_NOT_CONNECTED
    assert rails(found, "B").part[0].value == pytest.approx(0.1, abs=1e-3)


def test_two_islands_are_parted_each_by_what_it_has() -> None:
    island = [cell(wheel(f"X{n}"), s, 0.2 + 0.02 * n + more) for n in range(4) for s, more in (("C", 0.0), ("D", 0.04))]
    found = apart([*two_sections(0.1), *island])
    assert rails(found, "B").reference is RailsReference.KNOWN_RAILS
    assert rails(found, "D").reference is RailsReference.MEAN
    assert rails(found, "D").part[0].value == pytest.approx(0.02, abs=1e-3)
    assert wheels(found, "X0").conicity[0].value is None


def test_one_wheelset_does_not_connect_a_section() -> None:
    """Pins ``least_wheelsets``: its intervals are its own, however many there are."""
    one = [cell(wheel("W0"), "C", 0.25)]
    found = apart([*two_sections(0.1), *one, cell(wheel("W0", 1), "C", 0.25), cell(wheel("W0", 1), "A", 0.2)])
    refused = rails(found, "C").part[0]
    assert refused.reason is not None
    assert refused.reason.code is ReasonCode.TOO_FEW_WHEELSETS
    two = apart([*two_sections(0.1), *one, cell(wheel("W1"), "C", 0.27)])
    assert rails(two, "C").part[0].value == pytest.approx(0.05, abs=5e-3)


def test_what_is_refused_connects_nothing_behind_it() -> None:
    chain = [cell(wheel("W0"), "C", 0.25), cell(wheel("X0"), "C", 0.25), cell(wheel("X0"), "D", 0.3)]
    found = apart([*two_sections(0.1), *chain])
    assert all(rails(found, section).part[0].value is None for section in ("C", "D"))


def test_the_reference_wheel_needs_wheels_like_it() -> None:
    """Pins ``farthest``: 0.03 in conicity beyond the wheels that run there."""
    low = two_sections(0.1)[2:]  # the least worn has 0.22
    near, far = (replace_design(value) for value in (0.192, 0.188))
    assert rails(apart(low, near), "B").reference_wheel[0].value is not None
    refused = rails(apart(low, far), "B").reference_wheel[0]
    assert refused.reason is not None
    assert refused.reason.code is ReasonCode.REFERENCE_WHEEL_APART
    assert rails(apart(low, far), "B").part[0].value is not None


def replace_design(conicity: float) -> Anchors:
    held = anchors("A")
    return replace(held, wheel=replace(held.wheel, on_reference=conicity * np.ones(2)))


def test_where_neither_wheel_nor_rail_explains_the_conicities_nothing_is_published() -> None:
    """Pins ``most_interaction``: 0.01."""
    calm, wild = (apart(two_sections(0.1, 12, std=0.001, spread=spread)) for spread in (0.012, 0.016))
    assert 0.008 < calm.interaction[0] < 0.01 < wild.interaction[0] < 0.0125
    assert rails(calm, "B").part[0].value is not None
    for refused in (rails(wild, "B").part[0], wheels(wild, "W0").conicity[0]):
        assert refused.reason is not None
        assert refused.reason.code is ReasonCode.RAILS_INTERACT


def test_what_is_known_of_the_interaction_beforehand_shows_where_nothing_else_does() -> None:
    """Pins ``interaction`` and its weight: two wheels on two sections leave one number over."""
    found = apart(two_sections(0.1, 2, std=0.001))
    assert found.interaction[0] == pytest.approx(0.0046, abs=0.0003)


def test_how_much_slopes_may_differ_is_known_beforehand() -> None:
    """Pins ``slope_std``: wheels that are alike say nothing of the slope, and the wheel as designed is 0.03 away."""
    alike = [
        cell(wheel(f"W{n}"), s, 0.23 + more, std=0.0005) for n in range(40) for s, more in (("A", 0.0), ("B", 0.1))
    ]
    found = rails(apart(alike), "B").reference_wheel[0]
    assert found.std is not None
    assert found.std == pytest.approx(0.3 * abs(DESIGN - 0.23), rel=0.06)


def test_an_open_scale_of_a_section_widens_its_rails_and_not_its_wheels() -> None:
    sharp = apart(two_sections(0.1))
    scaled = apart([replace(c, scale_std=0.05 if c.rail.section == "B" else 0.0) for c in two_sections(0.1)])
    before, after = (rails(one, "B").part[0].std for one in (sharp, scaled))
    assert before is not None
    assert after is not None
    assert np.sqrt(after**2 - before**2) == pytest.approx(0.05 * np.mean([c.conicity[0] for c in two_sections(0.1)]))
    assert wheels(sharp, "W2").conicity[0].std == wheels(scaled, "W2").conicity[0].std


def test_what_all_cells_share_stays_with_the_wheels_and_hardly_with_the_rails() -> None:
    shared = apart([replace(c, systematic=0.04 * c.conicity) for c in two_sections(0.1)])
    plain = apart(two_sections(0.1))
    of_wheel = [wheels(one, "W5").conicity[0] for one in (plain, shared)]
    of_rails = [rails(one, "B").part[0] for one in (plain, shared)]
    wider = [np.sqrt((b.std or 0.0) ** 2 - (a.std or 0.0) ** 2) for a, b in (of_wheel, of_rails)]
    assert wider[0] == pytest.approx(0.04 * 0.3, rel=0.02)
    assert wider[1] == pytest.approx(0.04 * 0.1, rel=0.02)


def test_an_amplitude_that_is_not_reached_is_not_covered() -> None:
    half = [replace(c, conicity=np.array([c.conicity[0], np.nan])) for c in two_sections(0.1)]
    found = rails(apart(half), "B")
    assert found.part[0].value is not None
    assert found.part[1].reason is not None
    assert found.part[1].reason.code is ReasonCode.AMPLITUDE_NOT_COVERED
    assert reported(found.part, AMPLITUDE, RailsParameters()) == (found.part[0], 2e-3)


def test_the_trend_of_a_section_needs_three_periods() -> None:
    """Pins ``least_periods``; half a year each, 0.02 a year."""

    def worn(periods: int) -> list[SectionConicity]:
        return [
            cell(wheel(f"W{n}", p), s, 0.2 + 0.02 * n + (0.01 * p if s == "B" else 0.0), period=p)
            for n in range(6)
            for p in range(periods)
            for s in ("A", "B")
        ]

    assert "B" not in apart(worn(2)).trends
    trend = apart(worn(3)).trends["B"]
    assert trend.periods == 3
    assert trend.amplitude == 3e-3
    assert trend.per_year.value == pytest.approx(0.02, abs=1e-3)
    assert trend.per_year.low is not None
    assert trend.per_year.low < 0.02 < (trend.per_year.high or 0.0)
    assert trend.per_100_mgt.reason is not None
    assert trend.per_100_mgt.reason.code is ReasonCode.TONNAGE_UNKNOWN


def test_the_trend_by_traffic_is_that_by_time_over_the_traffic_of_a_year() -> None:
    cells = [
        cell(wheel(f"W{n}", p), s, 0.2 + 0.02 * n + (0.01 * p if s == "B" else 0.0), period=p)
        for n in range(6)
        for p in range(4)
        for s in ("A", "B")
    ]
    by_year = apart(cells, replace(anchors("A"), tonnage={"B": 25.0})).trends["B"]
    year, traffic = by_year.per_year, by_year.per_100_mgt
    assert (traffic.value, traffic.std) == (pytest.approx(4.0 * year.value), pytest.approx(4.0 * year.std))
    assert (traffic.low, traffic.high) == (pytest.approx(4.0 * year.low), pytest.approx(4.0 * year.high))
    assert traffic.count == year.count


def test_a_trend_has_no_periods_of_which_nothing_is_said() -> None:
    """The wheel as designed is too far from the wheels that ran there in the last of three periods."""
    cells = [
        cell(wheel(f"W{n}", p), s, 0.2 + 0.02 * n + (0.1 if p == 2 else 0.0) + (0.05 if s == "B" else 0.0), period=p)
        for n in range(6)
        for p in range(3)
        for s in ("A", "B")
    ]
    found = apart(cells)
    last = [one for one in found.rails if one.rail.section == "B"][-1].excess[0]
    assert last.reason is not None
    assert last.reason.code is ReasonCode.REFERENCE_WHEEL_APART
    assert "B" not in found.trends


def test_a_cell_comes_once_and_with_the_amplitudes_of_all() -> None:
    first = cell(wheel("W0"), "A", 0.2)
    with pytest.raises(ParameterError, match="two cells of W0 on A"):
        apart([first, cell(wheel("W0"), "A", 0.3)])
    with pytest.raises(ParameterError, match="other amplitudes"):
        apart([first, replace(cell(wheel("W1"), "A", 0.2), amplitude=AMPLITUDE + 1e-3)])


def test_no_cells_give_nothing() -> None:
    found = apart([])
    assert (found.rails, found.wheels) == ((), ())

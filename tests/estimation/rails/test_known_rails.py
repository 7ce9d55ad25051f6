"""Sections that are named as known are compared with each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from drawn_cells import AMPLITUDE, anchors, cell, drawn_fleet, wheel

from estimation.rails.apart import rails_apart
from estimation.rails.parameters import RailsParameters
from estimation.values.opinions import RailsApart, RailsReference, SectionConicity
from estimation.values.reasons import ReasonCode


def on(adds: Mapping[str, float], std: float = 0.004) -> list[SectionConicity]:
    """Return cells of eight wheels on sections whose rails add that much."""
    wheels = [(wheel(f"W{n}"), 0.19 + 0.015 * n) for n in range(8)]
    return [cell(of, section, theta + more, std=std) for of, theta in wheels for section, more in adds.items()]


def apart(cells: list[SectionConicity], *known: str) -> RailsApart:
    return rails_apart(cells, AMPLITUDE, anchors(*known), RailsParameters())


def references(found: RailsApart) -> dict[str, RailsReference | None]:
    return {one.rail.section: one.reference for one in found.rails}


def test_known_sections_that_agree_hold_the_level_together() -> None:
    found = apart(on({"A": 0.0, "B": 0.004, "C": 0.1}), "A", "B")
    assert not found.refused
    assert set(references(found).values()) == {RailsReference.KNOWN_RAILS}


def test_of_two_that_differ_neither_holds_the_level() -> None:
    found = apart(on({"A": 0.0, "B": 0.1, "C": 0.1}), "A", "B")
    assert set(found.refused) == {"A", "B"}
    assert {why.code for why in found.refused.values()} == {ReasonCode.KNOWN_RAILS_DIFFER}
    assert set(references(found).values()) == {RailsReference.MEAN}
    for refused in (found.wheels[0].conicity[0], found.rails[2].excess[0]):
        assert refused.reason is not None
        assert refused.reason.code is ReasonCode.KNOWN_RAILS_DIFFER
        assert "0.100" in refused.reason.text


def test_of_three_the_one_that_is_apart_is_measured_by_the_others() -> None:
    found = apart(on({"A": 0.0, "B": 0.1, "C": 0.0}), "A", "B", "C")
    assert set(found.refused) == {"B"}
    assert "A, C" in found.refused["B"].text
    assert found.rails[1].part[0].value == pytest.approx(0.1, abs=0.003)
    assert set(references(found).values()) == {RailsReference.KNOWN_RAILS}


def test_how_far_they_may_be_apart() -> None:
    """Pins ``known_apart``: 1.7 half intervals of the excess, with the interaction that is known beforehand."""
    alone = apart(on({"A": 0.0, "B": 0.02}), "A").rails[1].excess[1]
    assert alone.value is not None
    assert alone.low is not None
    half = alone.value - alone.low
    for share, refused in ((1.6, set()), (1.8, {"A", "B"})):
        assert set(apart(on({"A": 0.0, "B": share * half}), "A", "B").refused) == refused


def test_a_wheel_as_designed_that_is_far_from_all_wheels_does_not_hide_a_difference() -> None:
    cells = [one for one in on({"A": 0.0, "B": 0.1}) if one.wheel.wheelset > "W4"]  # at least 0.065 above the design
    assert set(apart(cells, "A", "B").refused) == {"A", "B"}


def test_sections_that_nothing_connects_are_not_compared() -> None:
    island = [cell(wheel(f"X{n}"), "B", 0.3 + 0.01 * n) for n in range(4)]
    assert not apart([*on({"A": 0.0, "C": 0.1}), *island], "A", "B").refused


@pytest.mark.slow
def test_known_sections_of_drawn_fleets_are_seldom_refused_and_worn_ones_found() -> None:
    alike, worn = 0, []
    for seed in range(20):
        fleet = drawn_fleet(seed)
        again = [cell(one.wheel, "B", float(one.conicity[0])) for one in fleet.cells if one.rail.section == "A"]
        rng = np.random.default_rng([seed, 2])
        moved = [cell(o.wheel, "B", float(o.conicity[0] + rng.normal(0.0, 0.005))) for o in again]
        rest = [one for one in fleet.cells if one.rail.section != "B"]
        alike += bool(apart([*rest, *moved], "A", "B").refused)
        if abs(fleet.rails[1]) > 0.05:
            worn.append(bool(apart(fleet.cells, "A", "B").refused))
    assert alike <= 1
    assert len(worn) >= 5
    assert np.mean(worn) > 0.8

"""Measured wheels hold the level where they confirm each other, and never more surely than they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_cells import AMPLITUDE, anchors, cell, wheel

from estimation.rails.apart import rails_apart
from estimation.rails.cell import Anchors
from estimation.rails.parameters import RailsParameters
from estimation.values.opinions import KnownWheel, RailKey, RailsApart, RailsReference, SectionConicity
from estimation.values.quantities import Estimate
from estimation.values.reasons import ReasonCode

WORN = 0.1  # what the rails of B add


def on_both(count: int = 8, noise: float = 0.0) -> list[SectionConicity]:
    """Return cells of wheels on A, whose rails are as on file, and on B."""
    rng = np.random.default_rng(7)
    of = [(wheel(f"W{n}"), 0.2 + 0.015 * n) for n in range(count)]
    return [
        cell(key, section, theta + more + float(rng.normal(0.0, noise)))
        for key, theta in of
        for section, more in (("A", 0.0), ("B", WORN))
    ]


def measured(errors: dict[int, float], std: float = 0.003, *, known: tuple[str, ...] = ()) -> Anchors:
    """Return anchors of measured wheels, by number, that are off by so much."""
    both = np.ones(2)
    wheels = (
        KnownWheel(wheel(f"W{n}"), (0.2 + 0.015 * n + off) * both, std * both) for n, off in sorted(errors.items())
    )
    return replace(anchors(*known), known_wheels=tuple(wheels))


def apart(cells: list[SectionConicity], held: Anchors) -> RailsApart:
    return rails_apart(cells, AMPLITUDE, held, RailsParameters())


def on(found: RailsApart, section: str) -> Estimate:
    (one,) = [one for one in found.rails if one.rail.section == section]
    return one.part[1]


def covers(one: Estimate, true: float) -> bool:
    return one.low is not None and one.high is not None and one.low <= true <= one.high


def codes(found: RailsApart) -> set[ReasonCode | None]:
    return {None if one.conicity[1].reason is None else one.conicity[1].reason.code for one in found.wheels}


def test_of_two_measured_wheels_that_differ_neither_holds_the_level() -> None:
    found = apart(on_both(), measured({0: 0.0, 3: 0.08}))
    assert set(found.refused_wheels) == {"W0", "W3"}
    assert codes(found) == {ReasonCode.MEASURED_WHEELS_DIFFER}
    assert on(found, "B").value == pytest.approx(0.5 * WORN, abs=1e-3)  # the mean of the sections


@pytest.mark.parametrize("error", [-0.08, 0.08, 0.3])
def test_of_three_the_one_that_is_apart_is_left_out_and_the_others_go_on(error: float) -> None:
    found = apart(on_both(noise=0.004), measured({0: 0.0, 3: error, 5: 0.0}))
    assert {serial: why.code for serial, why in found.refused_wheels.items()} == {
        "W3": ReasonCode.MEASURED_WHEELS_DIFFER
    }
    assert found.rails[0].reference is RailsReference.MEASURED_WHEELS
    assert covers(on(found, "B"), WORN)
    assert covers(on(found, "A"), 0.0)


def test_an_error_that_is_too_small_to_be_found_is_in_the_intervals() -> None:
    """Two measured wheels are no better known than one says of the other."""
    off = apart(on_both(noise=0.004), measured({0: 0.0, 3: 0.025}))
    assert not off.refused_wheels
    assert covers(on(off, "A"), 0.0)
    assert covers(on(off, "B"), WORN)


@pytest.mark.parametrize("error", [0.0, 0.08])
def test_one_measured_wheel_alone_holds_no_level(error: float) -> None:
    found = apart(on_both(), measured({3: error}))
    assert codes(found) == {ReasonCode.RAILS_LEVEL_OPEN}
    assert found.rails[0].reference is RailsReference.MEAN
    why = found.wheels[0].conicity[0].reason
    assert why is not None
    assert "W3" in why.text


def test_a_wheelset_that_is_measured_twice_does_not_confirm_itself() -> None:
    cells = [*on_both(), *(replace(one, wheel=wheel("W3", 1)) for one in on_both() if one.wheel.wheelset == "W3")]
    once = measured({3: 0.08})
    again = replace(once.known_wheels[0], wheel=wheel("W3", 1))
    assert codes(apart(cells, replace(once, known_wheels=(*once.known_wheels, again)))) == {ReasonCode.RAILS_LEVEL_OPEN}


def test_known_rails_confirm_a_measured_wheel_or_neither_holds_the_level() -> None:
    agree, differ = (apart(on_both(), measured({3: error}, known=("A",))) for error in (0.0, 0.08))
    assert not agree.refused_wheels
    assert agree.rails[0].reference is RailsReference.KNOWN_RAILS
    assert set(differ.refused_wheels) == {"W3"}
    assert set(differ.refused) == {"A"}
    assert {why.code for why in differ.refused.values()} == {ReasonCode.KNOWN_RAILS_DIFFER}
    assert {one.reference for one in differ.rails} == {RailsReference.MEAN}


def test_known_rails_that_contradict_measured_wheels_which_agree_are_refused() -> None:
    cells = [replace(one, conicity=one.conicity + 0.08 * (one.rail.section == "A")) for one in on_both()]
    found = apart(cells, measured({0: 0.0, 3: 0.0, 5: 0.0}, known=("A",)))
    assert set(found.refused) == {"A"}
    assert not found.refused_wheels
    assert covers(on(found, "A"), 0.08)


def test_how_well_a_measured_wheel_must_be_confirmed() -> None:
    """Pins ``confirmed_within``: the others must know its conicity to 0.02."""
    for std, reference in ((0.015, RailsReference.MEASURED_WHEELS), (0.018, RailsReference.MEAN)):
        found = apart(on_both(), measured({0: 0.0, 3: 0.0}, std=std))
        assert found.rails[0].reference is reference


def test_how_far_measured_wheels_may_be_apart() -> None:
    """Pins ``known_apart`` for wheels: 1.7 half intervals of what the other says."""
    found = {error: set(apart(on_both(), measured({0: 0.0, 3: error})).refused_wheels) for error in (0.045, 0.05)}
    assert found == {0.045: set(), 0.05: {"W0", "W3"}}


def test_a_level_that_wheels_hold_is_not_said_to_be_held_by_known_rails() -> None:
    """Known rails lie on an island of their own; what all cells share stays with the level that wheels hold."""
    island = [cell(wheel(f"X{n}"), s, 0.2 + 0.02 * n + m) for n in range(4) for s, m in (("C", 0.0), ("D", 0.05))]
    known = replace(measured({0: 0.0, 3: 0.0}), known_rails=frozenset({RailKey("C", 0)}))
    shared = [replace(one, systematic=0.04 * one.conicity) for one in (*on_both(), *island)]
    found = apart(shared, known)
    assert {one.rail.section: one.reference for one in found.rails} == {
        "A": RailsReference.MEASURED_WHEELS,
        "B": RailsReference.MEASURED_WHEELS,
        "C": RailsReference.KNOWN_RAILS,
        "D": RailsReference.KNOWN_RAILS,
    }
    by_serial = {one.wheel.wheelset: one.reference for one in found.wheels}
    assert by_serial["W0"] is RailsReference.MEASURED_WHEELS
    assert by_serial["X0"] is RailsReference.KNOWN_RAILS
    alone = apart([one for one in shared if one.wheel.wheelset.startswith("W")], measured({0: 0.0, 3: 0.0}))
    assert on(found, "B").std == pytest.approx(on(alone, "B").std, rel=0.15)
    assert (on(found, "B").std or 0.0) > 0.04 * 0.25  # of the conicity, not of the 0.1 that the rails add

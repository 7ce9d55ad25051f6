"""Rails on which conicities rise unlike on most others say nothing of wheels whose spread nothing else holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_cells import AMPLITUDE, anchors, cell, wheel

from estimation.rails.apart import rails_apart
from estimation.rails.cell import Anchors
from estimation.rails.parameters import RailsParameters
from estimation.values.arrays import FloatArray
from estimation.values.opinions import KnownWheel, RailsApart, RailsReference, SectionConicity
from estimation.values.reasons import ReasonCode

CENTRE = 0.25
THETA = np.linspace(0.2, 0.3, 9)
ALIKE = (4, 5)  # measured wheels that are nearly alike: they hold the level, and not the spread


def runs(
    slopes: dict[str, float], *, on_first: tuple[int, ...] = (), noise: float = 0.002, seed: int = 0
) -> list[SectionConicity]:
    """Return cells of wheels on sections with slopes; of the first section those of some wheels alone, if named."""
    rng, first = np.random.default_rng(seed), min(slopes)
    return [
        cell(wheel(f"W{n}"), section, theta + slope * (theta - CENTRE) + float(rng.normal(0.0, noise)))
        for section, slope in slopes.items()
        for n, theta in enumerate(THETA.tolist())
        if section != first or not on_first or n in on_first
    ]


def measured(*known: str) -> Anchors:
    both = np.ones(2)
    wheels = (KnownWheel(wheel(f"W{n}"), float(THETA[n]) * both, 0.003 * both) for n in ALIKE)
    return replace(anchors(*known), known_wheels=tuple(wheels))


def apart(cells: list[SectionConicity], held: Anchors, **other: float) -> RailsApart:
    parameters = replace(RailsParameters(), **other)  # type: ignore[arg-type] # names of numbers
    return rails_apart(cells, AMPLITUDE, held, parameters)


def left_out(found: RailsApart) -> set[str]:
    reasons = {one.rail.section: one.part[0].reason for one in found.rails}
    return {name for name, why in reasons.items() if why is not None and why.code is ReasonCode.RAILS_INTERACT}


def errors(found: RailsApart) -> FloatArray:
    values = [one.conicity[0].value for one in found.wheels]
    return np.abs(np.array([np.nan if value is None else value for value in values]) - THETA)


JUMP = {"A": 0.0, "B": 1.4, "C": 0.0, "D": 0.05}


@pytest.mark.parametrize("seed", range(4))
def test_a_section_next_to_a_jump_does_not_spread_the_wheels(seed: int) -> None:
    cells = runs(JUMP, seed=seed)
    found, before = apart(cells, measured()), apart(cells, measured(), uneven_slope=1e3)
    assert left_out(found) == {"B"}
    assert found.no_trends["B"].code is ReasonCode.RAILS_INTERACT
    assert errors(before).max() > 0.012
    assert errors(found).max() < 0.006
    assert all(
        one.conicity[0].low is not None and one.conicity[0].low <= true <= (one.conicity[0].high or 0.0)
        for one, true in zip(found.wheels, THETA, strict=True)
    )


def test_the_order_of_the_cells_is_nothing() -> None:
    cells = runs(JUMP)
    assert apart(cells, measured()).wheels == apart(cells[::-1], measured()).wheels


def test_of_two_sections_that_differ_nobody_knows_which_is_even() -> None:
    found = apart(runs({"A": 0.0, "B": 1.4}), measured())
    assert left_out(found) == {"A", "B"}
    assert {None if one.conicity[0].reason is None else one.conicity[0].reason.code for one in found.wheels} == {
        ReasonCode.RAILS_INTERACT
    }


def test_half_of_all_sections_are_not_most() -> None:
    """Pins ``most_uneven_share``."""
    assert left_out(apart(runs({"A": 0.0, "B": 1.4, "C": 0.0, "D": 1.4}), measured())) == {"A", "B", "C", "D"}
    assert left_out(apart(runs({"A": 0.0, "B": 1.4, "C": 0.0, "D": 1.4, "E": 0.0}), measured())) == {"B", "D"}


@pytest.mark.parametrize(("slope", "names"), [(0.52, set()), (0.7, {"B"}), (-0.34, set()), (-0.42, {"B"})])
def test_how_much_more_conicities_may_rise(slope: float, names: set[str]) -> None:
    """Pins ``uneven_slope``: 0.6, or as much less."""
    cells = runs({"A": 0.0, "B": slope, "C": 0.0, "D": 0.0}, noise=1e-4)
    assert left_out(apart(cells, measured(), interaction=1e-3)) == names


def test_known_rails_say_how_far_the_wheels_are_spread() -> None:
    found = apart(runs(JUMP), measured("A"))
    assert not left_out(found)
    assert errors(found).max() < 0.006


@pytest.mark.parametrize(("on_first", "names"), [((0, 8), set()), ((1, 7), {"B"})])
def test_known_rails_on_which_wheels_are_alike_do_not(on_first: tuple[int, ...], names: set[str]) -> None:
    """Pins ``spread_open``: by two wheels that are 0.1, or 0.075, apart."""
    found = apart(runs(JUMP, on_first=on_first), measured("A"))
    assert left_out(found) == names


@pytest.mark.parametrize("held", [anchors("A"), measured("A")])
def test_known_rails_on_which_wheels_are_alike_leave_the_spread_to_the_others(held: Anchors) -> None:
    cells = runs(JUMP, on_first=ALIKE)
    assert errors(apart(cells, held, uneven_slope=1e3)).max() > 0.012
    assert errors(apart(cells, held)).max() < 0.006


def test_known_rails_are_not_uneven() -> None:
    """Where all others say otherwise the known section stays."""
    found = apart(runs({"A": 0.0, "B": 1.4, "C": 1.4, "D": 1.4}, on_first=(1, 7)), anchors("A"))
    assert not left_out(found)
    assert found.rails[0].reference is RailsReference.KNOWN_RAILS


def test_without_an_anchor_differences_of_all_sections_are_published() -> None:
    found = apart(runs(JUMP), anchors())
    assert not left_out(found)
    assert {one.reference for one in found.rails} == {RailsReference.MEAN}

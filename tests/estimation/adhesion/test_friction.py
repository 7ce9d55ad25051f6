"""Friction from the sums of passes: against the law itself, in any order, with intervals, and where nothing shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from oracles.creep_excess import creep_excess

from estimation.adhesion.creep_forces import FileErrors, FrictionParameters
from estimation.adhesion.friction import certain_stretches, low_stretches, pooled_friction, section_adhesion
from estimation.values.opinions import CellFriction, FrictionSums, WindowAdhesion
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.sums import CELL_LENGTH, INVERSE

KNOWN = FrictionParameters()
NO_ERRORS = FileErrors(0.0, 0.0, 0.0, 0.0, 0.0)
NONE = Estimate.unknown(Reason(ReasonCode.NOT_FINITE, ""))
SAMPLES, NOISE = 600, 3e-5  # of a place and pass; m


def section_friction(passes: Sequence[WindowAdhesion], parameters: FrictionParameters) -> tuple[CellFriction, ...]:
    return pooled_friction(passes, parameters)[0]


def a_pass(
    number: int,
    frictions: Sequence[float],
    used: float = 0.05,
    creep_error: float = 0.0,
    slope_error: float = 0.0,
    first: int = 0,
    factor: float = 1.0,
    of_places: Sequence[float] = (),
    vehicle: str = "",
) -> WindowAdhesion:
    """Return a pass over places of given friction: e by the law, with noise, and errors of class and curve.

    ``factor`` is by how much the load on file is too large: the pass shows that many times the 1/mu. ``of_places`` are
    errors in proportion to q that all passes of a place have alike.
    """
    rng = np.random.default_rng([number, 17])
    squares, saturated = np.zeros((len(frictions), 6)), np.zeros((len(frictions), 4, len(INVERSE)))
    for place, friction in enumerate(frictions):
        q, x = 1.5e-4 * rng.standard_normal(SAMPLES), 2e-3 * rng.standard_normal(SAMPLES)
        adhesion = used * np.abs(rng.standard_normal(SAMPLES))
        coloured = NOISE * np.repeat(rng.standard_normal(SAMPLES // 10), 10)
        linear = creep_error + (of_places[place] if of_places else 0.0)
        e = q * creep_excess(adhesion / friction) + linear * q + slope_error * x + coloured
        squares[place] = [values.sum() for values in (e * e, e * q, q * q, e * x, q * x, x * x)]
        for k, inverse in enumerate(INVERSE):
            g = q * creep_excess(adhesion * inverse / factor)
            saturated[place, :, k] = [values.sum() for values in (g * e, g * g, g * q, g * x)]
    cells = first + np.arange(len(frictions))
    sums = FrictionSums(cells, np.full(len(frictions), float(SAMPLES)), squares, saturated)
    return WindowAdhesion(
        f"W{number}", number, vehicle or f"V{number // 4}", "S", "", Status.ESTIMATED, NONE, NONE, NONE, NONE, sums
    )


TRUE = (0.35, 0.3, 0.28, 0.3, 0.12, 0.08, 0.08, 0.12, 0.3, 0.35, 0.3, 0.28)


def test_friction_is_found_where_creep_shows_it_and_low_stretches_with_it() -> None:
    passes = [a_pass(number, TRUE, creep_error=0.03, slope_error=0.02) for number in range(12)]
    found = section_adhesion("S", passes, KNOWN)
    assert found is not None
    assert (found.windows, found.from_ns, found.to_ns) == (12, 0, 11)
    low = [cell for cell, true in zip(found.cells, TRUE, strict=True) if true < 0.1]
    for cell in low:
        assert cell.friction.value == pytest.approx(0.08, rel=0.2)
        assert cell.friction.low is not None
        assert cell.friction.high is not None
        assert cell.friction.low < 0.08 < cell.friction.high
    ((begin, end),) = found.low_stretches
    assert begin in {4 * CELL_LENGTH, 3 * CELL_LENGTH}
    assert end in {8 * CELL_LENGTH, 9 * CELL_LENGTH}


def test_passes_whose_vibration_was_taken_out_leave_friction_more_open() -> None:
    passes = [a_pass(number, TRUE) for number in range(6)]
    sharp = section_friction(passes, KNOWN)
    blunt = section_friction([replace(one, smoothed=True) for one in passes], KNOWN)
    assert any(one.friction.value is None and one.at_least > 0.0 for one in sharp)
    for one, other in zip(sharp, blunt, strict=True):
        if other.friction.value is None:
            assert other.at_least == 0.0  # smoothed forces make it too high
        elif one.friction.std is not None and other.friction.std is not None:
            assert one.friction.std < other.friction.std


def test_any_order_gives_the_same() -> None:
    passes = [a_pass(number, TRUE) for number in range(6)]
    assert section_friction(passes, KNOWN) == section_friction(passes[::-1], KNOWN)


def test_a_pass_that_is_cut_into_two_windows_says_the_same() -> None:
    passes = [a_pass(number, TRUE) for number in range(5)]
    halves = []
    for one in passes:
        assert one.sums is not None
        for part in (slice(0, 6), slice(6, 12)):
            sums = FrictionSums(
                one.sums.cells[part], one.sums.samples[part], one.sums.squares[part], one.sums.saturated[part]
            )
            halves.append(replace(one, start_ns=one.start_ns * 10 + int(part.start), sums=sums))
    whole, cut = section_friction(passes, KNOWN), section_friction(halves, KNOWN)
    for one, other in zip(whole, cut, strict=True):
        assert one.passes == other.passes
        assert one.low_probability == pytest.approx(other.low_probability, abs=1e-6)


@pytest.mark.parametrize(("used", "least"), [(0.004, 0.0), (0.03, 0.08)])
def test_small_creep_gives_a_lower_bound_alone(used: float, least: float) -> None:
    for cell in section_friction([a_pass(number, [0.4] * 8, used) for number in range(8)], KNOWN):
        assert cell.friction.value is None
        assert cell.friction.reason is not None
        assert cell.friction.reason.code is ReasonCode.CREEP_TOO_SMALL
        assert least <= cell.at_least < 0.4
        assert cell.low_probability < KNOWN.likely


def test_intervals_and_lower_bounds_cover() -> None:
    covered, bounded = [], []
    for seed in range(12):
        frictions = np.random.default_rng([seed, 5]).uniform(0.06, 0.45, 14)
        passes = [a_pass(100 * seed + number, tuple(frictions)) for number in range(8)]
        apart = replace(KNOWN, fresh=1.0)  # neighbours here have nothing in common
        for cell, true in zip(section_friction(passes, apart), frictions, strict=True):
            bounded.append(cell.at_least <= true)
            if cell.friction.low is not None and cell.friction.high is not None:
                covered.append(cell.friction.low <= true <= cell.friction.high)
    assert np.mean(covered) > 0.93
    assert np.mean(bounded) > 0.95
    assert len(covered) > 50


def test_too_few_passes_say_nothing() -> None:
    (cell,) = section_friction([a_pass(number, [0.08]) for number in range(KNOWN.fewest_passes - 1)], KNOWN)
    assert cell.friction.reason is not None
    assert cell.friction.reason.code is ReasonCode.TOO_FEW_PASSES
    assert (cell.at_least, cell.low_probability) == (0.0, 0.0)
    assert section_friction([], KNOWN) == ()
    assert section_adhesion("S", [replace(a_pass(0, [0.1]), sums=None)], KNOWN) is None


def test_what_is_measured_beyond_the_ends_of_a_section_is_no_place_of_it() -> None:
    passes = [a_pass(number, TRUE, first=-2) for number in range(6)]
    found = section_adhesion("S", passes, KNOWN, 8 * CELL_LENGTH)
    assert found is not None
    assert [cell.cell for cell in found.cells] == list(range(8))
    assert section_adhesion("S", passes, KNOWN, 0.0) is None


def test_passes_that_scatter_by_more_than_the_noise_say_less() -> None:
    def std_of(frictions: Sequence[float]) -> float:
        passes = [a_pass(number, [0.1] * 5 + [one] + [0.1] * 6) for number, one in enumerate(frictions)]
        found = section_friction(passes, replace(KNOWN, law_std=0.0, file=NO_ERRORS, fresh=1.0))[5].friction
        assert found.std is not None
        assert found.value is not None
        return found.std / found.value**2

    assert std_of([0.07, 0.14] * 4) > 1.3 * std_of([0.1] * 8)


def test_what_all_passes_of_a_place_have_wrong_is_no_low_friction() -> None:
    """The survey is off: the passes agree with each other, and a third of the places shows less creep than linear."""
    off = np.random.default_rng(3).normal(0.0, 0.15, 40)
    passes = [a_pass(number, [0.3] * 40, of_places=list(off)) for number in range(8)]
    found = section_adhesion("S", passes, KNOWN)
    assert found is not None
    assert found.low_stretches == ()
    assert found.certain_stretches == ()
    right = [a_pass(number, [0.3] * 20 + [0.08] * 4 + [0.3] * 16) for number in range(8)]
    stretches = section_adhesion("S", right, KNOWN)
    assert stretches is not None
    ((begin, end),) = stretches.certain_stretches
    assert 19 * CELL_LENGTH <= begin <= end <= 25 * CELL_LENGTH


@pytest.mark.parametrize("friction", [0.07, 0.1])
def test_a_section_that_is_slippery_from_end_to_end_is_found(friction: float) -> None:
    found = section_adhesion("S", [a_pass(number, [friction] * 30) for number in range(8)], KNOWN)
    assert found is not None
    assert found.low_stretches == ((0.0, 1500.0),)


@pytest.mark.parametrize("error", [0.2, 0.3])
def test_vehicles_that_all_creep_more_than_their_class_make_no_low_friction(error: float) -> None:
    found = section_adhesion("S", [a_pass(number, [0.35] * 30, creep_error=error) for number in range(8)], KNOWN)
    assert found is not None
    assert found.low_stretches == ()


def test_a_vehicle_alone_raises_what_is_near_to_certain_and_takes_nothing_away() -> None:
    frictions = [0.3] * 14 + [0.06] * 4 + [0.3] * 14
    alone = section_adhesion("S", [a_pass(number, frictions, vehicle="V") for number in range(8)], KNOWN)
    others = section_adhesion("S", [a_pass(number, frictions) for number in range(8)], KNOWN)
    assert alone is not None
    assert others is not None
    assert {one.vehicles for one in alone.cells} == {1}
    assert {one.vehicles for one in others.cells} == {2}
    assert alone.low_stretches
    assert alone.certain_stretches == ()
    assert others.certain_stretches


def test_what_decides_on_low_adhesion_is_pinned() -> None:
    assert (KNOWN.low, KNOWN.likely, KNOWN.at_ends) == (0.15, 0.45, 0.3)
    assert (KNOWN.certain, KNOWN.beside_others, KNOWN.fewest_vehicles, KNOWN.good) == (0.9, 0.7, 2, 0.4)
    assert (KNOWN.fewest_passes, KNOWN.least_upper, FrictionParameters().learnt_std_share) == (3, 0.6, 0.7)
    assert (KNOWN.usual, KNOWN.usual_std, KNOWN.level_std, KNOWN.most_usual) == (3.3, 3.0, 1.0, 6.7)
    assert KNOWN.creep_error_std == 0.1
    assert (KNOWN.law_std, KNOWN.track_std, KNOWN.smoothed_std) == (0.1, 0.45, 1.0)
    assert (KNOWN.change_std, KNOWN.fresh) == (0.2, 0.05)
    assert CELL_LENGTH == 50.0

    cells = [cell(1, 0.29), cell(2, 0.31), cell(3, 0.46), cell(4, 0.2), cell(5, 0.89), cell(8, 0.44), cell(9, 0.3)]
    cells += [cell(12, 0.9), cell(13, 0.9, None)]
    assert low_stretches(cells, KNOWN) == ((100.0, 300.0), (600.0, 650.0))
    assert low_stretches(cells[:2], replace(KNOWN, likely=0.25)) == ((50.0, 150.0),)


def cell(
    number: int, probability: float, value: float | None = 0.1, vehicles: int = 2, high: float = 0.12
) -> CellFriction:
    estimate = NONE if value is None else Estimate(value, 0.01, 0.08, high, 4.0, Status.ESTIMATED)
    return CellFriction(number, estimate, 0.08, probability, 4, vehicles)


def test_how_many_vehicles_an_alert_needs_and_what_is_certain_is_pinned() -> None:
    cells = [cell(1, 0.9), cell(2, 0.91), cell(3, 0.89), cell(4, 0.95), cell(5, 0.95, vehicles=1), cell(6, 0.95, None)]
    assert certain_stretches(cells, KNOWN) == ((50.0, 150.0), (200.0, 250.0))
    assert certain_stretches(cells, replace(KNOWN, likely=0.93)) == ((200.0, 250.0),)
    assert low_stretches([cell(1, 0.89, vehicles=1)], KNOWN) == ()
    assert low_stretches([cell(1, 0.90, vehicles=1)], KNOWN) == ((50.0, 100.0),)
    assert low_stretches([cell(1, 0.94, vehicles=1)], replace(KNOWN, likely=0.95)) == ()
    for needed, vehicles in ((0.7, 2), (0.9, 1)):
        elsewhere = cell(9, 0.1, vehicles=vehicles)
        assert low_stretches([cell(1, needed - 0.01, vehicles=1), elsewhere], KNOWN) == ()
        assert low_stretches([cell(1, needed, vehicles=1), elsewhere], KNOWN) == ((50.0, 100.0),)
    assert low_stretches([cell(1, 0.9, high=0.41)], KNOWN) == ()
    assert low_stretches([cell(1, 0.9, high=0.39)], KNOWN) == ((50.0, 100.0),)

"""Next to a contact jump nothing is parted, and nothing is said of the wheel as designed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_cells import DESIGN, anchors, cell, wheel

from estimation.rails.apart import rails_apart
from estimation.rails.cell import Anchors
from estimation.rails.parameters import RailsParameters
from estimation.rails.published import next_to_jump, on_rise
from estimation.values.arrays import FloatArray
from estimation.values.opinions import RailsApart, SectionConicity
from estimation.values.quantities import Estimate
from estimation.values.reasons import ReasonCode

AMPLITUDE = np.array([2.0e-3, 2.25e-3, 2.5e-3, 3.0e-3])
FLAT = np.zeros(4)


def cells(worn: FloatArray) -> list[SectionConicity]:
    """Return cells of wheels on A, and on B, whose rails add ``worn`` (k,)."""
    found = []
    for number in range(6):
        for section, more in (("A", FLAT), ("B", worn)):
            one = cell(wheel(f"W{number}"), section, 0.0, std=0.001)
            both = {name: np.full(4, getattr(one, name)[0]) for name in ("sampled", "systematic")}
            found.append(replace(one, amplitude=AMPLITUDE, conicity=0.2 + 0.02 * number + more, **both))
    return found


def held(on_reference: FloatArray, on_b: FloatArray | None = None) -> Anchors:
    one = anchors("A")
    on_file = {"A": on_reference, "B": on_reference if on_b is None else on_b}
    return replace(one, wheel=replace(one.wheel, on_reference=on_reference, on_file=on_file))


def apart(worn: FloatArray, on_file: Anchors) -> RailsApart:
    return rails_apart(cells(worn), AMPLITUDE, on_file, RailsParameters())


def codes(estimates: tuple[Estimate, ...]) -> list[ReasonCode | None]:
    return [None if one.reason is None else one.reason.code for one in estimates]


def test_a_change_counts_within_a_quarter_of_a_millimetre_to_either_side() -> None:
    curve = np.array([0.2, 0.24, 0.24, 0.20])
    assert next_to_jump(curve, AMPLITUDE, 0.03, RailsParameters()).tolist() == [
        True,
        True,
        False,
        False,
    ]  # 2.5 and 3 mm are further apart
    assert next_to_jump(curve[::-1], AMPLITUDE, 0.03, RailsParameters()).tolist() == [True, True, False, False]
    assert on_rise(curve, AMPLITUDE, 0.03, RailsParameters()).tolist() == [True, True, False, False]
    assert not on_rise(-curve, AMPLITUDE, 0.03, RailsParameters()).any()
    assert not next_to_jump(np.array([0.2, np.nan, 0.3, 0.3]), AMPLITUDE, 0.03, RailsParameters()).any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_the_drawings_have_a_jump_nothing_is_parted(sign: float) -> None:
    """Pins ``steepest``: 0.03 within 0.25 mm."""
    for step, refused in ((0.029, False), (0.031, True)):
        found = apart(FLAT + 0.1, held(DESIGN + sign * step * np.array([1.0, 0.0, 0.0, 0.0])))
        why = ReasonCode.CONTACT_JUMP_NEAR if refused else None
        assert codes(found.rails[1].reference_wheel) == [why, why, None, None]
        assert codes(found.rails[1].part) == [why, why, None, None]
        assert codes(found.wheels[3].conicity) == [why, why, None, None]


def test_a_jump_on_the_other_rails_of_a_section_is_no_matter_of_the_wheels() -> None:
    found = apart(FLAT + 0.1, held(FLAT + DESIGN, DESIGN + 0.04 * np.array([0.0, 0.0, 1.0, 1.0])))
    jump = ReasonCode.CONTACT_JUMP_NEAR
    assert codes(found.rails[1].excess) == [None, jump, jump, None]
    assert codes(found.rails[1].part) == [None] * 4
    assert codes(found.wheels[3].conicity) == [None] * 4


def test_a_jump_that_worn_rails_have_moved_is_seen_by_its_rise() -> None:
    for step, refused in ((0.028, False), (0.032, True)):
        found = apart(0.1 + step * np.array([0.0, 0.0, 1.0, 1.0]), held(FLAT + DESIGN))
        why = ReasonCode.CONTACT_JUMP_NEAR if refused else None
        assert codes(found.rails[1].reference_wheel) == [None, why, why, None]
        assert codes(found.rails[1].part) == [None] * 4
        falls = apart(0.1 - step * np.array([0.0, 0.0, 1.0, 1.0]), held(FLAT + DESIGN))
        assert codes(falls.rails[1].reference_wheel) == [None] * 4

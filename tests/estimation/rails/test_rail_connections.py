"""Which rails more than one wheelset connects with what is known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from drawn_cells import AMPLITUDE, anchors, cell, wheel

from estimation.rails.apart import rails_apart
from estimation.rails.component import Runs, connected
from estimation.rails.parameters import RailsParameters
from estimation.values.opinions import RailsApart, SectionConicity
from estimation.values.reasons import ReasonCode


def two_groups(bridges: int, off: float = 0.0) -> list[SectionConicity]:
    """Return cells of wheels on A and B, of others on C and D, and of some on A and C, of which the first is off."""
    pairs = [("W", 6, "A", "B", 0.1), ("X", 6, "C", "D", 0.05)]
    cells = [
        cell(wheel(f"{name}{n}"), section, 0.2 + 0.02 * n + (more if section == last else 0.0))
        for name, count, first, last, more in pairs
        for n in range(count)
        for section in (first, last)
    ]
    for n, section in product(range(bridges), ("A", "C")):
        cells.append(cell(wheel(f"Y{n}"), section, 0.22 + 0.05 * n + (off if n == 0 and section == "C" else 0.0)))
    return cells


def apart(cells: list[SectionConicity], *known: str) -> RailsApart:
    return rails_apart(cells, AMPLITUDE, anchors(*known), RailsParameters())


def values(found: RailsApart) -> dict[str, float | None]:
    return {one.rail.section: one.part[0].value for one in found.rails}


def test_sections_that_hang_on_one_wheelset_are_refused() -> None:
    """It was turned between A and C, and nobody said so: C and D would be off by that."""
    found = apart(two_groups(1, off=0.1), "A")
    assert values(found)["B"] == pytest.approx(0.1, abs=2e-3)
    for section in found.rails[2:]:
        assert section.part[0].reason is not None
        assert section.part[0].reason.code is ReasonCode.TOO_FEW_WHEELSETS
    (beyond,) = [one for one in found.wheels if one.wheel.wheelset == "X3"]
    assert beyond.conicity[0].reason is not None
    assert beyond.conicity[0].reason.code is ReasonCode.TOO_FEW_WHEELSETS


def test_sections_that_two_wheelsets_connect_are_not() -> None:
    assert values(apart(two_groups(2), "A"))["D"] == pytest.approx(0.05, abs=5e-3)


def test_two_intervals_of_one_wheelset_are_one_wheelset() -> None:
    again = [cell(wheel("Y0", 1), section, 0.25) for section in ("A", "C")]
    assert values(apart([*two_groups(1), *again], "A"))["D"] is None


def test_without_a_reference_each_side_is_compared_with_itself() -> None:
    found = values(apart(two_groups(1, off=0.1)))
    assert found == {
        "A": pytest.approx(-0.05, abs=2e-3),
        "B": pytest.approx(0.05, abs=2e-3),
        "C": pytest.approx(-0.025, abs=2e-3),
        "D": pytest.approx(0.025, abs=2e-3),
    }


def test_a_wheelset_that_alone_connects_a_section_in_the_middle_takes_what_is_behind_it_along() -> None:
    chain = [cell(wheel(f"X{n}"), section, 0.2 + 0.02 * n) for n in range(3) for section in ("C", "D")]
    middle = [cell(wheel("Y0"), section, 0.25) for section in ("B", "C")]
    both = [cell(wheel(f"W{n}"), section, 0.2 + 0.02 * n) for n in range(3) for section in ("A", "B")]
    found = values(apart([*both, *middle, *chain], "A"))
    assert found["B"] is not None
    assert (found["C"], found["D"]) == (None, None)


def drawn(seed: int) -> Runs:
    rng = np.random.default_rng(seed)
    wheels, rails = 9, 8
    wheel_, rail = np.divmod(np.sort(rng.choice(wheels * rails, 16, replace=False)), rails)
    known_rail = (np.arange(rails) == 0) & (seed % 3 > 0)
    known_wheel = (np.arange(wheels) < 2) & (seed % 2 > 0)
    return Runs(wheel_, rail, np.arange(wheels) // 2 * 2, known_rail, known_wheel)


def held_by_hand(runs: Runs, present: set[int]) -> set[int]:
    """Return the rails that reach what is known whichever wheelset is left out, by looking at each."""
    found = set(present)
    for out in [-1, *set(runs.serial.tolist())]:
        reached, before = {r for r in present if runs.known_rail[r]}, set[int]()
        own = [(w, r) for w, r in zip(runs.wheel.tolist(), runs.rail.tolist(), strict=True) if r in present]
        own = [(w, r) for w, r in own if runs.serial[w] != out]
        reached |= {r for w, r in own if runs.known_wheel[w]}
        while reached != before:
            before = set(reached)
            ran = {w for w, r in own if r in reached}
            reached |= {r for w, r in own if w in ran}
            if any(runs.known_rail[r] for r in reached) or any(runs.known_wheel[w] for w in ran):
                reached |= {r for r in present if runs.known_rail[r]}
        found &= reached
    return found


@pytest.mark.parametrize("seed", range(60))
def test_what_is_held_is_what_no_wheelset_alone_connects(seed: int) -> None:
    runs = drawn(seed)
    if not runs.known_rail.any() and not runs.known_wheel.any():
        return
    present, last = set(runs.rail.tolist()), set[int]()
    while present != last:  # what is refused connects nothing behind it
        last, present = present, held_by_hand(runs, present)
    group, _ = connected(runs, 2)
    assert set(np.flatnonzero(group == 0).tolist()) == present

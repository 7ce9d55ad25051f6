"""The bench of sudden changes: lives with their truth, and the page of its results, which every row has met."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bench.steps import NEVER, REACH, SIZES, WITHIN, false_steps, found_in
from bench.steps_lives import MOST_KM, MOST_WEAR, Case, life, odds

PAGE = Path(__file__).parents[2] / "docs" / "results" / "steps.md"


@pytest.mark.parametrize("mixed", [False, True])
def test_a_life_has_its_step_where_it_says(mixed: bool) -> None:  # noqa: FBT001
    given = life(Case(30, 0.2, 6, mixed=mixed), 1)
    first = given.first
    assert first is not None
    assert given.event_km is not None
    assert len(given.records) == 36 + mixed
    assert given.records[29].mileage_km < given.event_km < given.records[first].mileage_km
    assert given.level[first] - given.level[29] == pytest.approx(0.2, abs=0.02)
    assert 0.0 < given.level[30] - given.level[29] < 0.2 + (0.01 if mixed else 0.03)
    assert given.records[-1].mileage_km <= MOST_KM
    assert life(Case(120), 1).level.max() - life(Case(120), 1).level.min() <= MOST_WEAR + 1e-9


def test_a_large_step_is_found_and_a_quiet_life_has_none() -> None:
    found = found_in(life(Case(30, 0.2, 8, singles=0.0, season=False), 3), 30)
    assert found.after == 3 < NEVER
    assert found.holds_place
    assert found.level_error < found.level_error_without
    steps, years = false_steps(life(Case(30), 4))
    assert steps == 0
    assert years > 0.0


@pytest.mark.parametrize("wear", [True, False])
def test_an_ideal_detector_is_sure_of_a_step_and_of_none(wear: bool) -> None:  # noqa: FBT001
    stepped, quiet = life(Case(6, 0.2, 4, mixed=True), 5), life(Case(30), 5)
    assert stepped.first is not None
    assert odds(stepped, stepped.first + 3, wear=wear) > 5.0
    assert odds(stepped, stepped.first - 1, wear=wear) < 0.0
    assert odds(quiet, 30, wear=wear) < 0.0


def test_troubles_are_in_the_points_and_not_in_the_truth() -> None:
    plain = life(Case(60), 2)
    noisy, understated = life(Case(60, scatter=2.0), 2), life(Case(60, understated=5.0), 2)
    assert noisy.noise == pytest.approx(2.0 * plain.noise)
    stds = [[one.known[-1].std for one in given.records] for given in (plain, understated, noisy)]
    assert stds[0] == pytest.approx([5.0 * std for std in stds[1]])
    assert stds[2] == stds[0]
    falling = life(Case(60, shape="falling"), 2).level
    assert falling[-1] < falling[0]
    assert falling.min() > 0.0


def test_what_is_to_be_reached_is_what_was_asked_for() -> None:
    assert (REACH[0.1], REACH[0.2], WITHIN) == (4, 3, 0.98)


def rows() -> dict[str, tuple[str, str]]:
    """Return what was measured, and whether it was met, by what it is."""
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    return {what: (measured, met) for what, measured, _, met in cells}


def test_the_page_of_results_has_met_what_is_to_be_reached() -> None:
    found = rows()
    assert {met for _, met in found.values()} == {"yes"}
    for size in {abs(one) for one in SIZES}:
        lives = re.search(r"(\d+) lives", found[f"step of {size:g}, history of 3 to 240 intervals"][0])
        assert lives is not None
        assert int(lives.group(1)) >= 300
    text, _ = found["false steps, all together"]
    rate, wheelsets = re.match(r"([\d.]+) a wheelset-year", text), re.search(r"of (\d+) wheelsets", text)
    assert rate is not None
    assert wheelsets is not None
    assert float(rate.group(1)) <= 0.02
    assert int(wheelsets.group(1)) >= 300

"""Passes whose odometers disagree are put where they were, and geometry comes out as if they had been there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_panel import PANEL, fleet_passes

from estimation.track.gridded_pass import place
from estimation.track.panel.basis import PanelParameters, init, update
from estimation.track.panel.solution import result
from estimation.track.passes import Journey, Pass, PositionParameters, journeys
from estimation.track.positions import correlate_positions, refine
from estimation.values.track import Correction

POSITIONS = PositionParameters()
OFFSETS = {"17 m/s": 14.0, "23 m/s": -9.5}  # m
SCALES = {"17 m/s": 4e-4, "23 m/s": -3e-4}


def _displaced() -> list[Pass]:
    moved = []
    for item in fleet_passes():
        at = item.at + OFFSETS[item.vehicle] + SCALES[item.vehicle] * (item.at - 1000.0)
        moved.append(replace(item, at=at))
    return moved


def _left_over(corrections: dict[Journey, Correction]) -> np.ndarray:
    """Return what remains of the errors at 400 m and 1,600 m, less the fleet's mean."""
    rows = []
    for (vehicle, _), correction in corrections.items():
        true = np.array([400.0, 1600.0])
        measured = true + OFFSETS[vehicle] + SCALES[vehicle] * (true - 1000.0)
        rows.append(correction.at(measured) - true)
    left = np.array(rows)
    return np.asarray(left - left.mean(axis=0))


def test_offsets_and_scales_are_found_by_correlation_and_refined_by_the_panel() -> None:
    grouped = journeys(_displaced(), POSITIONS)
    assert len(grouped) == len(OFFSETS)
    corrections = correlate_positions(grouped, PANEL.grid, POSITIONS)
    coarse = _left_over(corrections)
    assert np.abs(coarse).max() < 2.0
    for _ in range(4):
        placed = place(grouped, corrections, {}, PANEL.grid)
        solution = result(
            update(init(PANEL), [item for one in placed.values() for item in one.passes]), parameters=PanelParameters()
        )
        corrections = refine(placed, solution, PANEL)
    fine = _left_over(corrections)
    assert np.sqrt((fine**2).mean()) < 0.1
    assert np.sqrt((fine**2).mean()) < 0.5 * np.sqrt((coarse**2).mean())


OFF = (14.0, -9.0, 17.0, -15.0, 12.0, -18.0)  # m, of journeys over parts of the section, each 300 m after the last


def _part(item: Pass, number: int) -> Pass:
    inside = slice(*np.searchsorted(item.at, (300.0 * number, 300.0 * number + 600.0)))
    return replace(
        item,
        at=item.at[inside] + OFF[number],
        displacement=item.displacement[inside],
        difference=item.difference[inside],
        stiffness_term=None,
        start_ns=number * 10**13,
    )


def test_journeys_over_parts_of_a_section_are_placed_in_a_chain() -> None:
    """Each shares a place with the next one only; vehicles alternate."""
    items = [
        _part(item, k) for item in fleet_passes() for k in range(len(OFF)) if (k % 2 == 0) == (item.vehicle[0] == "1")
    ]
    found = correlate_positions(journeys(items, POSITIONS), PANEL.grid, POSITIONS)
    by_part = {start // 10**13: one for (_, start), one in found.items()}
    assert len(by_part) == len(OFF)
    for k in range(len(OFF) - 1):
        middle = 300.0 * k + 450.0
        placed = [by_part[j].at(np.array([middle + OFF[j]]))[0] for j in (k, k + 1)]
        assert placed[0] == pytest.approx(placed[1], abs=1.0)


def test_passes_at_their_places_are_not_moved() -> None:
    grouped = journeys(fleet_passes(), POSITIONS)
    corrections = correlate_positions(grouped, PANEL.grid, POSITIONS)
    assert max(abs(c.offset) for c in corrections.values()) < 1.0


def test_a_pass_of_somewhere_else_is_not_dragged_along() -> None:
    """Noise instead of a track: no correlation, no correction of its own."""
    rng = np.random.default_rng(1)
    stranger = [
        replace(item, vehicle="stranger", displacement=1e-3 * rng.standard_normal(len(item.at)))
        for item in fleet_passes()
        if item.vehicle == "17 m/s"
    ]
    corrections = correlate_positions(journeys([*fleet_passes(), *stranger], POSITIONS), PANEL.grid, POSITIONS)
    foreign = next(c for (vehicle, _), c in corrections.items() if vehicle == "stranger")
    assert abs(foreign.offset - np.mean([c.offset for c in corrections.values()])) < 1.5


def test_a_pause_begins_a_new_journey() -> None:
    items = [replace(fleet_passes()[0], start_ns=int(t * 1e9)) for t in (0, 60, 120, 1000, 1060)]
    assert [len(members) for members in journeys(items, POSITIONS).values()] == [3, 2]


def test_a_correction_stretches_about_its_middle() -> None:
    correction = Correction(offset=2.0, scale=1e-3, middle=1000.0)
    assert correction.at(np.array([1000.0, 3000.0])) == pytest.approx([1002.0, 3004.0])

"""A bogie holds wheels of different diameters off the line on which both roll alike: against the simulator, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from estimation.contact.conicity import equivalent_conicity, middle_of_travel
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.geometry.sharpening import (
    SHARPENING,
    SLOPES,
    held_difference_std,
    held_shares,
    left_in_difference,
    moved_off,
)
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import TrackRecipe, make_track
from ingest.vehicle_class_schema import shipped_class

GRID = 0.05e-3 * np.arange(-220, 221)
X = np.linspace(-10e-3, 10e-3, 401)


@pytest.mark.parametrize("code", ["coach", "freight"])
def test_what_is_left_in_the_difference_is_what_the_simulator_has(code: str) -> None:
    """P8 on 60E1 1:40 is nearly straight: lambda = 0.23. A millimetre between the wheels of both axles, opposite."""
    known, wheel, rail = shipped_class(code), wheel_profile("P8"), rail_profile("60E1")
    radius = known.parameters.nominal_radius
    tables = [
        contact_table(
            WheelsetOnTrack(wheel, wheel, rail, rail, 1 / 40, 1.435, radius + half, radius - half), GRID, outside="hold"
        )
        for half in (0.25e-3, -0.25e-3)
    ]
    track = make_track(TrackRecipe(length=1300.0), np.random.SeedSequence(3))
    ran = simulate_gear(RunningGear(known.parameters, known.bogie), tables, track, np.full(60_000, 20.0), 20.0)
    found = [float((one.rolling_radius_left - one.rolling_radius_right)[10_000:].mean()) for one in ran]
    expected = left_in_difference(known, 0.23) @ [0.5e-3, -0.5e-3]
    np.testing.assert_allclose(found, expected, atol=0.06e-3)


def test_a_stiff_bogie_holds_most_of_it_and_a_wheelset_alone_none() -> None:
    coach, soft = held_shares(shipped_class("coach")), held_shares(shipped_class("soft_bogie"))
    at = SLOPES.index(0.4)
    assert coach[at] == pytest.approx(0.59, abs=0.02)
    assert soft[at] == pytest.approx(0.16, abs=0.02)
    assert set(held_shares(shipped_class("paper"))) == {0.0}


def test_half_of_the_unknown_difference_of_diameters_is_one_of_radii() -> None:
    assert SHARPENING.diameter_std == 0.3e-3
    shares = tuple(0.5 for _ in SLOPES)
    assert held_difference_std(shares, 0.2) == pytest.approx(0.075e-3)


def test_a_straight_curve_has_its_conicity_wherever_it_is_held() -> None:
    amplitudes = np.array([1e-3, 3e-3])
    np.testing.assert_allclose(moved_off(X, 0.4 * X, amplitudes, 0.3e-3), 0.0, atol=1e-9)
    bent = 0.3 * X + 5e3 * X**3
    changes = moved_off(X, bent, amplitudes, 0.3e-3)
    here = equivalent_conicity(X, bent, amplitudes)
    middles = stats.norm.ppf((2.0 * np.arange(8) + 1.0) / 16.0)
    moves = 0.3e-3 * middles / np.sqrt(np.mean(middles**2))
    moved = np.stack([equivalent_conicity(X, bent + move, amplitudes) for move in moves])
    np.testing.assert_allclose(changes, np.sqrt(np.mean((moved - here) ** 2, axis=0)), rtol=1e-3)


def test_the_middle_of_the_travel_is_that_of_the_energy() -> None:
    assert middle_of_travel(X, 0.4 * (X - 1e-3), 3e-3) == pytest.approx(1e-3, abs=1e-9)
    steeper = np.where(X > 0.0, 0.8 * X, 0.2 * X)  # turns where the integrals are equal: 0.8 b^2 = 0.2 (6 - b)^2
    assert middle_of_travel(X, steeper, 3e-3) == pytest.approx(2e-3 - 3e-3, abs=1e-6)
    assert np.isnan(middle_of_travel(X, 0.4 * X, 11e-3))
    assert np.isnan(middle_of_travel(X, -0.4 * X, 3e-3))

"""Constants of the mixed model, each by a number that is another where the constant is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_cells import AMPLITUDE, DESIGN, anchors, cell, wheel
from scipy.optimize import brentq
from scipy.special import stdtrit

from estimation.rails.apart import rails_apart
from estimation.rails.parameters import RailsParameters
from estimation.rails.two_way import TwoWay, part
from estimation.values.arrays import FloatArray
from estimation.values.opinions import RailPart, RailsApart, SectionConicity

PARAMETERS = RailsParameters()


def crossed(wheels: int, rails: FloatArray, slopes: FloatArray, noise: FloatArray, std: float = 1e-4) -> TwoWay:
    """Return every wheel, of conicities from 0.2 to 0.3, on all rails, of which the first are known."""
    theta, s = np.linspace(0.2, 0.3, wheels), len(rails)
    wheel_, rail = np.divmod(np.arange(wheels * s), s)
    value = theta[wheel_] + rails[rail] + slopes[rail] * (theta[wheel_] - 0.25) + noise
    nothing = np.full(wheels, np.nan)
    return TwoWay(wheel_, rail, value, np.full(len(value), std**2), np.arange(s) == 0, nothing, nothing)


def additive(wheels: int, step: float) -> TwoWay:
    noise = step * np.resize([1.0, 0.0, -1.0, 0.0], 2 * wheels)
    return crossed(wheels, np.array([0.0, 0.1]), np.zeros(2), noise)


def test_what_is_known_of_the_interaction_counts_four_degrees_of_freedom() -> None:
    """Pins ``interaction_weight`` and the count of what is left over, against the equation solved by hand."""
    cells = additive(6, 0.003)
    found = part(cells, PARAMETERS)
    theta, s, w = found.wheel, 2, 6

    def surplus(tau: float) -> float:
        """Return squares less freedom, the slope fixed: 12 cells, 6 wheels, one rail and its slope."""
        weight = 1.0 / (cells.variance[0] + tau**2)
        fitted = theta[cells.wheel] + found.rail[cells.rail]
        residual = cells.value - fitted - found.slope[cells.rail] * (theta[cells.wheel] - found.centre)
        used = w + 1.0 + (1.0 - found.covariance[s + 1, s + 1] / 0.3**2)
        return float(weight * (residual**2).sum() - (12 - used) + 4.0 * ((0.005 / tau) ** 2 - 1.0))

    assert found.interaction == pytest.approx(brentq(surplus, 1e-3, 0.1), rel=0.02)
    used = w + 1.0 + (1.0 - found.covariance[s + 1, s + 1] / 0.3**2)
    assert found.freedom == pytest.approx(4.0 + 12 - used, rel=1e-6)


@pytest.mark.parametrize("known", [0, 3])
def test_the_degrees_of_freedom_are_the_trace_of_what_is_left_over(known: int) -> None:
    cells = additive(5, 0.003)
    value = np.where(np.arange(5) < known, np.linspace(0.2, 0.3, 5), np.nan)
    cells = replace(cells, known_value=value, known_variance=np.full(5, 0.003**2))
    found = part(replace(cells, known_rail=np.array([known == 0, False])), PARAMETERS)
    tau2, a = found.interaction**2, 1.0 + found.slope[cells.rail]
    columns = np.zeros((10 + known, 5 + 4))
    columns[np.arange(10), cells.wheel] = a
    columns[np.arange(10), 5 + cells.rail] = 1.0
    columns[np.arange(10), 7 + cells.rail] = found.wheel[cells.wheel] - found.centre
    columns[10:, :known] = np.eye(known)
    weight = 1.0 / (np.concatenate([cells.variance, np.full(known, 0.003**2)]) + tau2)
    free = np.array([*range(5), *([6, 8] if known == 0 else [5, 6, 7, 8])])
    before = np.concatenate([np.zeros(7), np.full(2, 0.3**-2)])[free]
    used = columns[:, free]
    hat = used @ np.linalg.inv(used.T @ (weight[:, None] * used) + np.diag(before)) @ used.T * weight
    assert found.freedom == pytest.approx(4.0 + 10 + known - np.trace(hat), rel=1e-3)


@pytest.mark.parametrize(("slope", "found"), [(-0.7, -0.7), (-0.95, -0.8), (1.9, 1.9), (2.5, 2.0)])
def test_slopes_are_within_their_limits(slope: float, found: float) -> None:
    """Pins ``slope_range``."""
    cells = crossed(40, np.array([0.0, 0.1]), np.array([0.0, slope]), np.zeros(80))
    assert part(cells, replace(PARAMETERS, slope_std=30.0)).slope[1] == pytest.approx(found, abs=2e-3)


def test_the_interaction_is_not_below_a_thousandth() -> None:
    """Pins ``lowest_tau``, where nothing is known of it beforehand and the cells are exact."""
    exact = replace(PARAMETERS, interaction_weight=0.0)
    assert part(additive(12, 0.0), exact).interaction == pytest.approx(1e-3)


def cells_of(scale: dict[str, float], systematic: float, wear: float = 0.1) -> list[SectionConicity]:
    found = []
    for n in range(8):
        for section in ("A", "B", "C"):
            value = 0.2 + 0.02 * n + (wear if section == "B" else 0.0)
            found.append(
                cell(
                    wheel(f"W{n}"),
                    section,
                    value,
                    scale_std=scale.get(section, 0.0),
                    systematic=float(np.hypot(systematic, scale.get(section, 0.0))) * value,
                )
            )
    return found


def apart(cells: list[SectionConicity], *known: str) -> RailsApart:
    return rails_apart(cells, AMPLITUDE, anchors(*known), PARAMETERS)


def of_b(found: RailsApart) -> RailPart:
    (one,) = [one for one in found.rails if one.rail.section == "B"]
    return one


def added(wide: float | None, narrow: float | None) -> float:
    assert wide is not None
    assert narrow is not None
    return float(np.sqrt(wide**2 - narrow**2))


def test_the_scale_of_the_reference_is_that_of_the_mean_of_the_known_sections() -> None:
    """Pins ``_scale_of_reference``: of two with 0.03 and 0.04 it is 0.05 / 2, and it is in rails and wheels."""
    scaled, sharp = (apart(cells_of(scale, 0.0), "A", "C") for scale in ({"A": 0.03, "C": 0.04}, {}))
    centre = float(np.mean([one.conicity[0] for one in cells_of({}, 0.0)]))
    assert added(of_b(scaled).part[0].std, of_b(sharp).part[0].std) == pytest.approx(0.025 * centre, rel=1e-3)
    wheels = (scaled.wheels[7].conicity[0], sharp.wheels[7].conicity[0])
    assert added(wheels[0].std, wheels[1].std) == pytest.approx(0.025 * 0.34, rel=0.02)
    mean, no_mean = (of_b(apart(cells_of(scale, 0.0))) for scale in ({"A": 0.03, "C": 0.04}, {}))
    assert added(mean.part[0].std, no_mean.part[0].std) == pytest.approx(0.05 / 3.0 * centre, rel=1e-3)


def test_the_error_of_the_reference_wheel_grows_with_the_slope_of_the_rails() -> None:
    """Pins the term of slope and mean: what all cells share also stretches how wheels differ on the rails."""
    cells = [
        replace(one, conicity=one.conicity + 0.5 * (one.conicity - 0.3) * (one.rail.section == "B"))
        for one in cells_of({}, 0.0)
    ]
    shared = [replace(one, systematic=0.04 * one.conicity) for one in cells]
    plain, wide = (of_b(apart(some, "A", "C")).reference_wheel[0] for some in (cells, shared))
    assert plain.value is not None
    centre = float(np.mean([one.conicity[0] for one in cells]))
    slope = 0.5  # of B over the mean wheel
    expected = 0.04 * (abs(plain.value - DESIGN) + slope * centre)
    assert added(wide.std, plain.std) == pytest.approx(expected, rel=0.03)


def test_intervals_are_those_of_student_at_the_whole_degrees_of_freedom() -> None:
    """Pins ``_groups``."""
    found = apart(cells_of({}, 0.0), "A", "C")
    one = of_b(found).part[0]
    # 24 cells; 8 wheels and one rail; its slope takes less than one; 4 are known beforehand
    assert one.value is not None
    assert one.high is not None
    assert one.std is not None
    assert (one.high - one.value) / one.std == pytest.approx(float(stdtrit(18, 0.975)), rel=1e-6)

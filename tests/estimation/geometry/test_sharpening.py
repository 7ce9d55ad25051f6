"""Sharpening of curves of which is known what is behind: steps, lines, bends and falls under a normal error."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr
from slow_sharpening import WIDTH, node_values, sample_places

from estimation.geometry.sharpening import SHARPENING, Sharpening, edges_and_centres, jumps_displaced, sharpen
from estimation.values.arrays import FloatArray

EDGES = (np.arange(-11, 13) - 0.5) * WIDTH
LOW, HIGH = EDGES[:-1], EDGES[1:]
AT = sample_places(LOW, 400)
NODES = edges_and_centres(LOW, HIGH)
CELL = WIDTH / 8.0
STEP = 0.4e-3


def sharp(nodes: FloatArray, longest: float, std: float = 0.0) -> Sharpening:
    return sharpen(LOW, HIGH, nodes, np.full(len(nodes), std), longest)


def blurred_step(place: float, blur: float, height: float = STEP) -> FloatArray:
    """Return a line with a step, blurred, at 400 places in each bin."""
    return 0.2 * AT + height * ndtr((AT - place) / blur)


@pytest.mark.parametrize("longest", [0.0, 0.1e-3, 0.25e-3])
def test_a_straight_line_comes_back(longest: float) -> None:
    """Slopes end three std beyond the bins, where 0.0005 of a blur is left."""
    found = sharp(0.2 * NODES, longest)
    np.testing.assert_allclose(found.curve(0.2 * NODES), 0.2 * found.displacement, atol=0.2 * 0.0005 * longest + 1e-12)
    assert (found.blur, found.left) == (longest, 0.0)


@pytest.mark.parametrize("bend", [10.0, -10.0])
def test_a_quadratic_comes_back_without_what_the_blur_adds(bend: float) -> None:
    """A blur adds bend x blur^2; the truth costs (2 bend cell)^2 per cell in roughness, so that no node is further."""
    blur = 0.2e-3
    nodes = 0.2 * NODES + bend * (NODES**2 + blur**2)
    found = sharp(nodes, blur)
    away = found.curve(nodes) - (0.2 * found.displacement + bend * found.displacement**2)
    inner = np.abs(found.displacement) < EDGES[-1] - 2 * blur  # beyond, the slope of the last bins goes on
    furthest = np.sqrt(5 * len(LOW)) * 2 * abs(bend) * CELL * SHARPENING.least_node_std
    assert furthest < 0.2 * abs(bend) * blur**2
    np.testing.assert_allclose(away[inner], 0.0, atol=furthest)


@pytest.mark.parametrize(("blur", "cells"), [(0.12e-3, 4), (0.25e-3, 8)])
@pytest.mark.parametrize("place", [0.63e-3, -1.21e-3])
def test_a_blurred_step_comes_back_to_its_cell(blur: float, cells: int, place: float) -> None:
    """Half its rise is in its cell; what it rises over, 2.6 std blurred, is less than 0.43 of that."""
    nodes = node_values(LOW, blurred_step(place, blur))
    found = sharp(nodes, blur)
    assert found.blur == blur
    step = found.curve(nodes) - 0.2 * found.displacement
    rise = [float(found.displacement[np.argmax(step > share * STEP)]) for share in (0.1, 0.9)]
    assert rise[1] - rise[0] <= (cells + 0.1) * CELL < 1.07 * blur
    middle = np.interp(0.5 * STEP, step, found.displacement)
    assert middle == pytest.approx(place, abs=0.5 * CELL)
    integral = np.trapezoid(step, found.displacement)
    assert integral == pytest.approx(STEP * (EDGES[-1] - place), rel=0.005)


@pytest.mark.parametrize("true", [0.1e-3, 0.2e-3])
def test_a_blur_that_is_too_long_is_not_taken(true: float) -> None:
    nodes = node_values(LOW, blurred_step(0.63e-3, true))
    found = sharp(nodes, 0.5e-3)
    assert true <= found.blur <= 0.3e-3
    assert sharp(node_values(LOW, blurred_step(0.63e-3, 0.5e-3)), 0.5e-3).blur == 0.5e-3


def test_the_curve_is_linear_in_the_nodes_while_the_same_slopes_are_at_their_bound() -> None:
    nodes = node_values(LOW, blurred_step(0.63e-3, 0.2e-3))
    other = nodes + 1e-9 * np.cos(np.arange(len(nodes)))
    once, again = sharp(nodes, 0.2e-3), sharp(other, 0.2e-3)
    assert ((np.diff(once.curve(nodes)) < 1e-15) == (np.diff(again.curve(other)) < 1e-15)).all()
    np.testing.assert_allclose(once.curve(other), again.curve(other), atol=1e-13)
    assert np.abs(once.curve(other) - once.curve(nodes)).max() > 1e-9


def test_a_falling_part_stays() -> None:
    """A curve that falls by 0.1 over 1.5 mm, between rises of 0.2, under a blur of 0.15 mm."""
    blur = 0.15e-3

    def ramp(x: FloatArray) -> FloatArray:
        return np.asarray(x * ndtr(x / blur) + blur * np.exp(-0.5 * (x / blur) ** 2) / np.sqrt(2 * np.pi))

    nodes = node_values(LOW, 0.2 * AT - 0.3 * ramp(AT + 0.5e-3) + 0.3 * ramp(AT - 1e-3))
    found = sharp(nodes, blur)
    x = found.displacement
    true = 0.2 * x - 0.3 * np.maximum(x + 0.5e-3, 0.0) + 0.3 * np.maximum(x - 1e-3, 0.0)
    np.testing.assert_allclose(found.curve(nodes), true, atol=6e-6)
    slopes = np.diff(found.curve(nodes)) / CELL
    assert slopes[(x[:-1] > -0.2e-3) & (x[1:] < 0.7e-3)] == pytest.approx(-0.1, abs=0.02)


def test_where_nothing_fits_the_nodes_stay_and_so_does_the_blur() -> None:
    """Edges 50 um above a line, centres 50 um below it: no curve that rises does that."""
    nodes = 0.2 * NODES + 50e-6 * (-1.0) ** np.arange(len(NODES))
    found = sharp(nodes, 0.2e-3, std=1e-6)
    np.testing.assert_array_equal(found.displacement, NODES)
    np.testing.assert_array_equal(found.curve(nodes), nodes)
    assert found.blur == 0.0
    assert found.left == pytest.approx(np.hypot(0.2e-3, WIDTH / np.sqrt(12.0)))


@settings(max_examples=15)
@given(
    place=st.floats(-1.5e-3, 1.5e-3),
    height=st.floats(-0.3e-3, 0.6e-3),
    blur=st.floats(0.05e-3, 0.3e-3),
    longest=st.floats(0.1e-3, 0.4e-3),
)
def test_the_mirrored_curve_is_sharpened_to_the_mirrored_result(
    place: float, height: float, blur: float, longest: float
) -> None:
    nodes = node_values(LOW, blurred_step(place, blur, height))
    one = sharpen(LOW, HIGH, nodes, np.zeros(len(nodes)), longest)
    other = sharpen(-HIGH[::-1], -LOW[::-1], -nodes[::-1], np.zeros(len(nodes)), longest)
    assert other.blur == pytest.approx(one.blur, rel=1e-12)
    np.testing.assert_allclose(other.displacement, -one.displacement[::-1], atol=1e-12)
    np.testing.assert_allclose(other.curve(-nodes[::-1]), -one.curve(nodes)[::-1], atol=1e-9)


@pytest.mark.parametrize("by", [0.1e-3, -0.1e-3])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_jumps_are_displaced_by_exactly_that_on_either_side(by: float, side: float) -> None:
    x = np.linspace(-3e-3, 3e-3, 601)

    def curve(place: float) -> FloatArray:
        return np.asarray(0.2 * x + STEP * np.clip((x - place) / 0.05e-3, 0.0, 1.0))

    place = 1.3e-3 if side > 0 else -1.35e-3
    beyond = (1.0 - 0.2 * 0.05e-3 / STEP) * (curve(place) - 0.2 * x)  # what is steeper than twice the median slope
    expected = curve(place) - beyond + np.interp(x - side * by, x, beyond)
    np.testing.assert_allclose(jumps_displaced(x, curve(place), 0.2e-3, by), expected, atol=1e-12)


def test_a_curve_without_jumps_has_none_displaced() -> None:
    x = np.linspace(-3e-3, 3e-3, 601)
    smooth = 0.2 * x + 3e3 * x**3 - 0.1e-3 * ndtr((x - 1e-3) / 0.1e-3)  # up to 0.28 steep, and a fall
    np.testing.assert_array_equal(jumps_displaced(x, smooth, 0.0, 0.2e-3), smooth)

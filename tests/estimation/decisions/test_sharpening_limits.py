"""What sharpening decides, against the same done slowly; and how far contact jumps are displaced."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.special import ndtr
from slow_sharpening import WIDTH, node_values, sample_places, slow_sharpened, slow_with_blur

from estimation.geometry.sharpening import edges_and_centres, jumps_displaced, nodes_of, sharpen
from estimation.values.arrays import FloatArray

EDGES = (np.arange(-4, 6) - 0.5) * WIDTH
LOW, HIGH = EDGES[:-1], EDGES[1:]
NODES = 2 * len(LOW) + 1
EXACT = np.zeros(NODES)
LONGEST = 0.5e-3


def stepped(blur: float, height: float = 0.4e-3) -> FloatArray:
    """Return the nodes of a straight line with a step at 0.33 mm, blurred."""
    x = sample_places(LOW, 400)
    step = ndtr((x - 0.33e-3) / blur) if blur else x > 0.33e-3
    return node_values(LOW, 0.2 * x + height * step)


@cache
def noisy(seed: int) -> FloatArray:
    """Return nodes of a step that is blurred by 0.25 mm, with a fall beside it and noise of 8 um."""
    x = sample_places(LOW, 400)
    curve = stepped(0.25e-3) - 0.15e-3 * node_values(LOW, ndtr((x + 0.5e-3) / 0.3e-3))
    return curve + 8e-6 * np.random.default_rng(seed).standard_normal(NODES)


@pytest.mark.parametrize(
    ("blur", "share"),
    [
        (0, 0),
        (0.06, 0.1),
        (0.1, 0.2),
        (0.13, 0.3),
        (0.16, 0.4),
        (0.19, 0.5),
        (0.23, 0.6),
        (0.25, 0.7),
        (0.28, 0.8),
        (0.31, 0.9),
        (0.4, 1),
    ],
)
def test_the_longest_blur_of_eleven_is_taken_that_the_nodes_allow(blur: float, share: float) -> None:
    nodes = stepped(1e-3 * blur)
    slow = slow_sharpened(LOW, nodes, EXACT, LONGEST)
    assert slow is not None
    found = sharpen(LOW, HIGH, nodes, EXACT, LONGEST)
    assert found.blur == slow.blur == pytest.approx(share * LONGEST)
    np.testing.assert_allclose(found.displacement, slow.displacement, atol=1e-15)
    np.testing.assert_allclose(found.curve(nodes), slow.curve, atol=8e-9)


@pytest.mark.parametrize(("blur", "misfit", "taken"), [(0.326e-3, 1.024, False), (0.328e-3, 0.987, True)])
def test_a_blur_is_allowed_up_to_a_misfit_of_one_std(blur: float, misfit: float, *, taken: bool) -> None:
    nodes = stepped(blur)
    assert slow_with_blur(LOW, nodes, EXACT, LONGEST).misfit == pytest.approx(misfit, abs=0.002)
    assert (sharpen(LOW, HIGH, nodes, EXACT, LONGEST).blur == LONGEST) is taken


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("std", [4e-6, 12e-6])
def test_noise_and_falls_give_what_a_general_solver_gives(seed: int, std: float) -> None:
    """The std of the nodes, the least one, the roughness and the cells beyond the bins all change the curve."""
    stds = std * np.linspace(0.5, 2.0, NODES)
    slow = slow_sharpened(LOW, noisy(seed), stds, 0.25e-3)
    assert slow is not None
    found = sharpen(LOW, HIGH, noisy(seed), stds, 0.25e-3)
    assert found.blur == slow.blur
    assert len(found.displacement) == 8 * len(LOW) + 1
    np.testing.assert_allclose(found.curve(noisy(seed)), slow.curve, atol=8e-9)


@pytest.mark.parametrize(("steps", "left"), [(1, np.hypot(LONGEST, WIDTH / np.sqrt(12.0))), (40, 0.0)])
def test_a_search_that_does_not_end_leaves_the_nodes_as_they_are(steps: int, left: float) -> None:
    """A step has slopes at their bound beside it, whatever the blur, and finding which takes more than one step."""
    nodes = stepped(0.0)
    found = sharpen(LOW, HIGH, nodes, EXACT, LONGEST, steps=steps)
    assert found.left == pytest.approx(left)
    assert found.blur == 0.0
    assert np.array_equal(found.curve(nodes), nodes) is bool(left)


def test_slopes_fall_no_more_than_twice_as_steeply_as_what_was_observed() -> None:
    x = sample_places(LOW, 400)
    nodes = node_values(LOW, 0.2 * x - 0.4e-3 * ndtr(x / 0.15e-3))
    steepest = float(np.min(np.diff(nodes[1::2]) / WIDTH))
    found = sharpen(LOW, HIGH, nodes, EXACT, 0.3e-3)
    slopes = np.diff(found.curve(nodes)) / np.diff(found.displacement)
    assert slopes.min() == pytest.approx(2.0 * steepest, rel=1e-6)


def test_nodes_are_edges_and_centres_and_an_edge_is_the_mean_of_both_bins() -> None:
    np.testing.assert_allclose(edges_and_centres(LOW, HIGH)[:5], (np.arange(5) - 9.0) / 2.0 * WIDTH, atol=1e-15)
    assert edges_and_centres(LOW, HIGH)[-1] == HIGH[-1]
    two = np.array([[1.0, 0.5, 0.2], [4.0, -0.5, 1.0]])  # value, slope and curvature over u
    expected = [1.0 - 0.25 + 0.05, 1.0, 0.5 * ((1.0 + 0.25 + 0.05) + (4.0 + 0.25 + 0.25)), 4.0, 4.0 - 0.25 + 0.25]
    np.testing.assert_allclose(nodes_of(two), expected)
    np.testing.assert_allclose(nodes_of(np.stack([two, 2.0 * two], axis=-1))[:, 1], 2.0 * np.array(expected))
    assert nodes_of(np.zeros((2, 3, 0))).shape == (5, 0)


@pytest.mark.parametrize(("slope", "rise"), [(0.39, 0.0), (0.41, 0.01), (1.0, 0.6)])
def test_what_is_steeper_than_twice_the_median_is_displaced(slope: float, rise: float) -> None:
    """Eleven points with a slope of 0.2, and one steeper cell: what is above 0.4 there moves to the next cell."""
    x = 0.1e-3 * np.arange(11.0)
    slopes = np.full(10, 0.2)
    slopes[5] = slope
    curve = np.append(0.0, np.cumsum(slopes * np.diff(x)))
    moved = jumps_displaced(x, curve, 0.0, 0.1e-3)
    expected = curve - np.where(np.arange(11) == 6, rise * 0.1e-3, 0.0)
    np.testing.assert_allclose(moved, expected, atol=1e-12)

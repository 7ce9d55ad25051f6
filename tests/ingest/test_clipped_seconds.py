"""Of a second that its status frame calls clipped only the blows are, where they explain it."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import BoolArray
from ingest.align.windows import narrowed

SECOND = 250  # samples


def marked(*seconds: int) -> BoolArray:
    found = np.zeros(10 * SECOND, np.bool_)
    for second in seconds:
        found[second * SECOND : (second + 1) * SECOND] = True
    return found


def test_a_blow_explains_its_second_alone() -> None:
    values = 0.3 * np.random.default_rng(0).standard_normal((10 * SECOND, 4))
    values[800:803, :3] = 40.0
    found = narrowed(marked(3), values, 0.004)
    assert found[800:803].all()
    assert 3 <= found.sum() < 20
    assert np.array_equal(narrowed(marked(3, 6), values, 0.004)[SECOND * 6 : SECOND * 7], np.ones(SECOND))


def test_what_clips_all_the_time_is_no_blow() -> None:
    at = np.arange(10 * SECOND)
    swaying = np.clip(60.0 * np.sin(2.0 * np.pi * 4.0 * 0.004 * at), -40.0, 40.0)
    values = np.column_stack([swaying, swaying, 0.1 * swaying, swaying])
    assert np.array_equal(narrowed(marked(3), values, 0.004), marked(3))


def test_a_yaw_that_clips_outside_the_blows_is_not_explained() -> None:
    values = np.zeros((10 * SECOND, 4))
    values[800:803, [0, 2]] = 40.0
    values[900:950, 1] = 30.0
    assert np.array_equal(narrowed(marked(3), values, 0.004), marked(3))
    assert not narrowed(marked(), values, 0.004).any()

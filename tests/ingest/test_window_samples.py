"""The compiled loops over the samples of a window give what numpy gives, step by step."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimation.values.arrays import BoolArray, FloatArray, IntArray, runs
from ingest.align.samples import between_frames, gaps_of, good_samples, gridded, on_section, range_of

COUNT = 60
SEEDS = st.integers(0, 2**32 - 1)


def near_clipped(clipped: BoolArray, slot: IntArray, guard: int) -> BoolArray:
    """Return which samples are within ``guard`` slots of a clipped one."""
    counted = np.concatenate([[0], np.cumsum(clipped)])
    first = np.searchsorted(slot, slot - guard, side="left")
    last = np.searchsorted(slot, slot + guard, side="right")
    return np.asarray(counted[last] > counted[first])


@given(seed=SEEDS, share=st.sampled_from([0.0, 0.05, 0.5, 1.0]), guard=st.integers(0, 12))
def test_samples_count_that_are_valid_where_the_speed_is_known_away_from_clipped_ones(
    seed: int, share: float, guard: int
) -> None:
    rng = np.random.default_rng(seed)
    slot = np.flatnonzero(rng.random(COUNT) < rng.uniform(0.2, 1.0))
    valid = rng.random((len(slot), 4)) > 0.1
    clipped = rng.random(len(slot)) < share
    speed = np.where(rng.random(COUNT) < 0.1, np.nan, 20.0)
    good, count = good_samples(slot, valid, clipped, speed, guard)
    wanted = valid.all(axis=1) & ~np.isnan(speed[slot]) & ~near_clipped(clipped, slot, guard)
    assert good.tolist() == wanted.tolist()
    assert count == np.count_nonzero(wanted)
    if count:
        section = rng.integers(-1, 3, COUNT)
        numbers = section[slot[wanted]]
        assert range_of(section, slot, good) == (numbers.min(), numbers.max())
    values = rng.standard_normal((len(slot), 4))
    grid = np.full((3, COUNT), np.nan)
    grid[:, slot[wanted]] = values[wanted][:, :3].T
    assert np.array_equal(gridded(values, slot, good, COUNT, 3), grid, equal_nan=True)


@given(seed=SEEDS)
def test_the_distance_of_a_wheelset_is_that_on_its_section(seed: int) -> None:
    rng = np.random.default_rng(seed)
    distance = np.where(rng.random(COUNT) < 0.1, np.nan, rng.uniform(0.0, 10.0, COUNT))
    forward, section = rng.choice([-1.0, 1.0], COUNT), rng.integers(1, 3, COUNT)
    own = distance - forward * 4.0
    wanted = np.where((section == 1) & (own >= 0.0), own, np.nan)
    assert np.array_equal(on_section(distance, forward, section, 1, 4.0), wanted, equal_nan=True)


@given(st.lists(st.booleans(), max_size=40))
def test_gaps_are_the_runs_without_a_valid_sample(valid: list[bool]) -> None:
    missing = runs(~np.array(valid, np.bool_))
    assert gaps_of(np.array(valid, np.bool_)) == (len(missing), int(np.diff(missing).max(initial=0)))


def by_search(tick: IntArray, values: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return what :func:`between_frames` does, by a search for every slot."""
    grid = np.arange(COUNT)
    before = np.searchsorted(tick, grid, side="right") - 1
    if len(tick) == 0:
        return np.full(COUNT, np.nan), np.full(COUNT, np.nan), before
    since = grid - tick[before]
    inside = np.where(since == 0, values[before], values[before] + slope[before] * since)
    return np.where(before >= 0, inside, np.nan), np.where(before >= 0, slope[before], np.nan), before


@given(seed=SEEDS, frames=st.sampled_from([0, 1, 5, 40]))
def test_values_between_frames_are_on_the_line_from_the_one_before(seed: int, frames: int) -> None:
    rng = np.random.default_rng(seed)
    tick = np.sort(rng.choice(np.arange(-20, COUNT + 20), frames, replace=False))
    values, slope = (np.where(rng.random(frames) < 0.1, np.nan, rng.standard_normal(frames)) for _ in range(2))
    for one, other in zip(between_frames(COUNT, tick, values, slope), by_search(tick, values, slope), strict=True):
        assert np.array_equal(one, other, equal_nan=True)

"""Merging frames: a set in one order, however it was cut and shuffled."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from same_values import same_values

from ingest.frames import FrameBatch, between, concatenate, merge, take

FRAME = st.tuples(st.integers(0, 5), st.sampled_from([0x80, 0x181, 0x182]), st.integers(0, 2))


def batch_of_rows(rows: list[tuple[int, int, int]]) -> FrameBatch:
    data = np.zeros((len(rows), 8), np.uint8)
    data[:, 0] = [row[2] for row in rows]
    return FrameBatch(
        "can0", np.array([r[0] for r in rows], np.int64), np.array([r[1] for r in rows]), np.full(len(rows), 8), data
    )


@given(rows=st.lists(FRAME, min_size=1, max_size=40), seed=st.integers(0, 1000))
def test_merge_is_the_sorted_set_of_frames(rows: list[tuple[int, int, int]], seed: int) -> None:
    merged = merge([batch_of_rows(rows)])
    found = list(zip(merged.t_ns.tolist(), merged.arbitration_id.tolist(), merged.data[:, 0].tolist(), strict=True))
    assert found == sorted(set(rows))
    rng = np.random.default_rng(seed)
    shuffled = take(batch_of_rows(rows + rows), rng.permutation(2 * len(rows)))
    cut = int(rng.integers(0, 2 * len(rows) + 1))
    again = merge([take(shuffled, slice(cut, None)), take(shuffled, slice(0, cut))])
    assert same_values(merged, again)


def test_between_is_half_open() -> None:
    batch = batch_of_rows([(t, 0x80, 0) for t in range(6)])
    assert between(batch, 2, 4).t_ns.tolist() == [2, 3]
    assert len(concatenate([])) == 0

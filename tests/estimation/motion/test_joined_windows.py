"""Windows that follow each other without a break are one, whatever the order in which they come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smooth_wheelset import mems_windows, run

from estimation.track.parameters import TRACK
from estimation.track.passes import following, joined
from estimation.values.windows import Window

SECOND_NS = 10**9


def keys(windows: list[Window]) -> list[tuple[str, int, int]]:
    return [(w.wheelset, w.start_ns, w.start_ns + w.length_ns) for w in windows]


@given(
    runs=st.lists(st.tuples(st.sampled_from("AB"), st.lists(st.booleans(), min_size=1, max_size=12)), max_size=4),
    order=st.randoms(use_true_random=False),
    most=st.integers(1, 5),
)
def test_groups_are_unbroken_and_hold_everything_once(
    runs: list[tuple[str, list[bool]]], order: object, most: int
) -> None:
    """The oracle walks every wheelset's seconds in order; each run has seconds with data and without."""
    items, at = [], 0
    for name, present in runs:
        items += [(name, at + i) for i, there in enumerate(present) if there]
        at += len(present) + 1
    expected: list[list[tuple[str, int]]] = []
    for name, second in sorted(items):
        if expected and expected[-1][-1] == (name, second - 1) and len(expected[-1]) < most:
            expected[-1].append((name, second))
        else:
            expected.append([(name, second)])
    order.shuffle(items)  # type: ignore[attr-defined]
    found = following(items, [(name, second, second + 1) for name, second in items], most)
    assert found == expected


def test_windows_of_another_wheelset_or_vehicle_meanwhile_break_nothing() -> None:
    times = [("A", 0, 1), ("B", 0, 1), ("A", 1, 2), ("B", 1, 2), ("A", 2, 3)]
    assert following(times, times) == [[times[0], times[2], times[4]], [times[1], times[3]]]
    assert following([], []) == []


def test_a_long_run_is_cut_so_that_a_late_window_changes_little() -> None:
    cut = mems_windows(run(120, seed=1, cone=0.10, speed=20.0), seed=3, length_s=10)
    assert [len(group) for group in following(cut, keys(cut))] == [TRACK.most_pass_windows] * 3


def test_joined_windows_are_the_window_that_one_recording_would_have_made() -> None:
    motion = run(120, seed=1, cone=0.10, speed=20.0)
    (whole,) = mems_windows(motion, seed=3, length_s=120)
    parts = mems_windows(motion, seed=3, length_s=30)
    (group,) = following(list(reversed(parts)), keys(list(reversed(parts))))
    together = joined(group)
    for name in ("lateral_acceleration", "yaw_acceleration", "speed", "distance", "valid"):
        np.testing.assert_array_equal(getattr(together, name), getattr(whole, name))
    assert (together.start_ns, together.length_ns) == (0, 120 * SECOND_NS)
    assert joined(group[:1]) is group[0]


def test_the_quality_of_joined_windows_hides_nothing() -> None:
    first, second = mems_windows(run(60), seed=3, length_s=30)
    bad = replace(
        second,
        quality=replace(
            second.quality,
            coverage=0.5,
            longest_gap_s=2.0,
            gaps=3,
            clipped=0.02,
            speed_min_m_s=3.0,
            position_quality=0.2,
            sensor_fault=True,
        ),
    )
    found = joined([first, bad]).quality
    assert found.coverage == pytest.approx(0.5 * (first.quality.coverage + 0.5))
    assert (found.longest_gap_s, found.gaps, found.sensor_fault) == (2.0, first.quality.gaps + 3, True)
    assert (found.speed_min_m_s, found.speed_max_m_s) == (3.0, first.quality.speed_max_m_s)
    assert (found.position_quality, found.clipped) == (0.2, pytest.approx(0.01))

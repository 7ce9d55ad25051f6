"""Which end goes first: found from what nodes measure, and an ordinary journey either way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bogie_run import COACH, SOFT, WHEELBASE, joined, of_bogie, parameters, windows
from paper_class import PAPER_CLASS
from smooth_wheelset import alignment, mems_windows, run, track
from whole_runs import whole_runs

from estimation.geometry.rolling_radius import rolling_radius
from estimation.motion.axle_distance import bogie_runs_backwards, check_axle_distance, turned_over, with_frame_yaw
from estimation.motion.checks import runs_backwards
from estimation.motion.integration import SignalParameters, WindowParameters
from estimation.motion.rolling_sums import rolling_sums
from estimation.motion.window_motion import window_motion
from estimation.signatures.window_signatures import axle_position
from estimation.track.passes import examine
from estimation.values.signatures import AxlePosition
from estimation.values.windows import Motion, Window


def rear_first(window: Window) -> Window:
    """Return what a node measures whose vehicle runs the other way round: left and front are right and rear."""
    names = ("lateral_acceleration", "roll_acceleration", "mass_lateral_acceleration")
    return replace(window, **{name: -getattr(window, name) for name in names})


def push_pull(stiffness: float) -> list[tuple[Window, Window]]:
    """Return pairs of windows of axles 1 and 2 of a bogie that runs with axle 2 first."""
    front, rear = (windows(stiffness, axle) for axle in (1, 2))
    pairs = zip(rear, front, strict=True)
    return [(rear_first(one), rear_first(other)) for one, other in pairs]


@pytest.mark.parametrize("stiffness", [SOFT, COACH])
def test_the_direction_of_travel_is_seen_at_each_node(stiffness: float) -> None:
    for axle in (1, 2):
        for window in windows(stiffness, axle):
            assert runs_backwards(window) is False
            assert runs_backwards(rear_first(window)) is True


def test_what_has_nothing_in_common_says_nothing() -> None:
    (window, *_) = windows(SOFT, 1)
    noise = np.random.default_rng(1).standard_normal((2, len(window.valid)))
    silent = replace(window, lateral_acceleration=noise[0], yaw_acceleration=noise[1])
    assert runs_backwards(silent) is None
    standing = replace(window, speed=np.zeros(len(window.valid)))
    assert runs_backwards(standing) is None


@pytest.mark.parametrize("stiffness", [SOFT, COACH])
def test_the_return_journey_of_a_push_pull_train_is_the_mirror_image_of_an_ordinary_one(stiffness: float) -> None:
    track_on_file, known = alignment(track(1)), parameters(of_bogie(stiffness))
    for (own, other), forward in zip(push_pull(stiffness), joined(stiffness, 2), strict=True):
        assert bogie_runs_backwards(own, other, WHEELBASE) is True
        assert check_axle_distance(own, other, -WHEELBASE) is None
        window = turned_over(with_frame_yaw(own, other, WHEELBASE))
        assert window.backwards
        back, there = (window_motion(one, track_on_file, known) for one in (window, forward))
        assert isinstance(back, Motion)
        assert isinstance(there, Motion)
        for name in ("displacement", "yaw", "roll", "frame_yaw"):
            np.testing.assert_allclose(getattr(back, name), -getattr(there, name), rtol=1e-9, atol=1e-12)
        (one,), (same,) = (examine(item, known)[0] for item in (window, forward))
        np.testing.assert_allclose(one.displacement, same.displacement, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(one.difference, -same.difference, rtol=1e-9, atol=1e-12)
        assert (one.side, same.side) == (-1, 1)


def test_a_train_that_was_turned_runs_forward() -> None:
    (window, *_) = windows(SOFT, 1)
    turned = replace(window, distance=5000.0 - window.distance)
    assert runs_backwards(turned) is False


def test_of_nodes_that_disagree_the_rolls_decide() -> None:
    (own, *_), (other, *_) = windows(SOFT, 1), windows(SOFT, 2)
    rough = np.random.default_rng(2).standard_normal(len(own.valid))
    late = round(WHEELBASE / 20.0 / own.sample_interval_s)
    front = replace(own, roll_acceleration=rough)
    rear = replace(other, roll_acceleration=np.roll(rough, late))
    assert bogie_runs_backwards(front, rear_first(rear), WHEELBASE) is False
    assert bogie_runs_backwards(front, rear_first(rear), -WHEELBASE) is True
    assert bogie_runs_backwards(front, replace(rear, yaw_acceleration=rough), WHEELBASE) is False
    silent = replace(rear, roll_acceleration=np.roll(rough[::-1], 7))
    assert bogie_runs_backwards(front, rear_first(silent), WHEELBASE) is None


def test_the_axle_is_ahead_of_the_reference_that_it_is_behind_by_the_registry() -> None:
    (window, *_) = windows(SOFT, 1)
    np.testing.assert_allclose(turned_over(window, 3.0).distance, window.distance + 6.0)
    against = replace(window, distance=5000.0 - window.distance)
    np.testing.assert_allclose(turned_over(against, 3.0).distance, against.distance - 6.0)


def test_the_leading_axle_is_the_one_that_meets_the_track_first() -> None:
    (window, *_) = windows(SOFT, 1)
    known = parameters(of_bogie(SOFT))
    assert axle_position(window, known) is AxlePosition.LEADING
    assert axle_position(turned_over(window), known) is AxlePosition.TRAILING
    assert axle_position(window, WindowParameters(PAPER_CLASS)) is AxlePosition.SINGLE


def test_the_rolling_radius_is_the_same_either_way() -> None:
    known, signals = of_bogie(SOFT), SignalParameters()
    there, back = (
        rolling_radius(
            [part for axle in (1, 2) for one in joined(SOFT, axle) for part in rolling_sums(f(one), known, signals)]
        )
        for f in (lambda one: one, rear_first)
    )
    assert there is not None
    assert back is not None
    assert back.value == pytest.approx(there.value, rel=1e-9)


def test_windows_before_and_after_a_reversal_are_not_joined() -> None:
    first, second = mems_windows(run(120), seed=1)[:2]
    assert len(list(whole_runs([first, second]))) == 1
    assert len(list(whole_runs([first, turned_over(second)]))) == 2

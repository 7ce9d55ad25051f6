"""Lateral accelerometers that are turned about the longitudinal axis: a part of gravity stands in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_wheelset import alignment, mems_windows, run, track

from estimation.motion.checks import check_upright, straight_part
from estimation.motion.integration import SignalParameters
from estimation.motion.window_motion import motion
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackLayout
from estimation.values.windows import Motion, Window

STRAIGHT = TrackLayout("S1", 1, np.array([0.0, 1e5]), np.zeros(2), np.zeros(2))
CHANNELS = ("lateral_acceleration", "mass_lateral_acceleration")


def leaning(at_rest: float, channel: str = "lateral_acceleration", *, gravity: bool = True) -> Window:
    """Return a window of a sensor that measures ``at_rest``, m/s2, where nothing moves."""
    window = mems_windows(run(60), seed=1)[0]
    level = {name: getattr(window, name) - np.mean(getattr(window, name)[window.valid]) for name in CHANNELS}
    return replace(window, **(level | {channel: level[channel] + at_rest}), measures_gravity=gravity)


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize(("at_rest", "refused"), [(1.38, False), (1.42, True), (-1.42, True), (9.81, True)])
def test_more_than_offset_and_cant_make_is_refused(at_rest: float, channel: str, *, refused: bool) -> None:
    window = leaning(at_rest, channel)
    reason = check_upright(window, window.valid)
    assert (reason is not None) == refused
    if reason is not None:
        assert reason.code is ReasonCode.SENSOR_TURNED
        assert ("mass" in reason.text) == (channel == "mass_lateral_acceleration")
        assert f"{at_rest:+.1f} m/s2" in reason.text
        assert f"{np.degrees(np.arcsin(abs(at_rest) / 9.81)):.0f} degrees" in reason.text


@pytest.mark.parametrize("layout", [None, STRAIGHT])
def test_neither_geometry_nor_alignment_uses_it(layout: TrackLayout | None) -> None:
    parameters = SignalParameters()
    for found in (
        motion(leaning(2.0), alignment(track(1)), parameters, layout),
        straight_part(leaning(2.0), layout, parameters),
    ):
        assert isinstance(found, Reason)
        assert found.code is ReasonCode.SENSOR_TURNED
    assert isinstance(motion(leaning(0.5), alignment(track(1)), parameters, layout), Motion)
    assert isinstance(straight_part(leaning(0.5), layout, parameters), Window)


def test_sensors_that_do_not_measure_gravity_may_have_any_offset() -> None:
    window = leaning(5.0, gravity=False)
    assert check_upright(window, window.valid) is None
    assert check_upright(leaning(5.0), np.zeros(len(window.valid), dtype=bool)) is None, "no sample"

"""Band-limited motion: exact where it must be, near the truth with real sensors, NaN in gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_wheelset import alignment, mems_windows, run, track

from estimation.errors import ParameterError
from estimation.filters import remove_wander
from estimation.motion.integration import SignalParameters, standard_displacement
from estimation.motion.window_motion import motion
from estimation.values.reasons import Reason
from estimation.values.windows import Motion

PARAMETERS = SignalParameters()


def _fast(x: np.ndarray, distance: np.ndarray) -> np.ndarray:
    known = np.ones(len(x), dtype=bool)
    return remove_wander(x[None, :], distance, known, PARAMETERS.cutoff_wavelength)[0]


def test_the_motion_is_that_of_the_wheelset_without_its_slow_part() -> None:
    m = run(60, swing=3.0)
    (window,) = mems_windows(m, seed=0, density=0.0)
    found = motion(window, alignment(track(1)), PARAMETERS)
    assert isinstance(found, Motion)
    distance = m.distance[::4] - m.distance[0]
    keep = found.valid
    for name, truth, tolerance in (
        ("displacement", standard_displacement(m.relative_displacement, m.roll, 0.45, level=False), 0.04e-3),
        ("yaw", m.yaw, 4e-6),
        ("yaw_rate", m.yaw_rate, 3e-5),
    ):
        error = (getattr(found, name) - _fast(truth[::4], distance))[keep]
        assert np.sqrt((error**2).mean()) < tolerance, name


def test_offset_and_constant_drift_of_a_sensor_change_nothing() -> None:
    (window,) = mems_windows(run(60), seed=0, density=0.0)
    tilted = replace(
        window, lateral_acceleration=window.lateral_acceleration + 0.4, yaw_acceleration=window.yaw_acceleration - 3.0
    )
    a = motion(window, alignment(track(1)), PARAMETERS)
    b = motion(tilted, alignment(track(1)), PARAMETERS)
    assert isinstance(a, Motion)
    assert isinstance(b, Motion)
    np.testing.assert_allclose(a.displacement[a.valid], b.displacement[b.valid], atol=1e-9)
    np.testing.assert_allclose(a.yaw[a.valid], b.yaw[b.valid], atol=1e-9)


def test_short_gaps_are_bridged_but_not_used_and_long_ones_split() -> None:
    (window,) = mems_windows(run(60), seed=0)
    valid = window.valid.copy()
    valid[1000:1003] = False
    valid[7000:7100] = False
    valid[14_000:] = False
    acceleration = np.where(valid, window.lateral_acceleration, np.nan)
    gappy = replace(window, lateral_acceleration=acceleration, valid=valid)
    found = motion(gappy, alignment(track(1)), PARAMETERS)
    whole = motion(window, alignment(track(1)), PARAMETERS)
    assert isinstance(found, Motion)
    assert isinstance(whole, Motion)
    trim = 250
    assert not found.valid[1000:1003].any()
    assert found.valid[trim:1000].all()
    assert found.valid[1003 : 7000 - trim].all()
    assert not found.valid[7000 - trim : 7100 + trim].any()
    assert np.isfinite(found.displacement[found.valid]).all()
    both = found.valid & whole.valid
    assert np.sqrt(((found.displacement - whole.displacement)[both] ** 2).mean()) < 0.25e-3


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"speed": np.full(15_000, 2.0)}, "100% slower than 8 m/s"),
        ({"distance": np.full(15_000, -50.0)}, "100% off the known part of the section"),
        ({"valid": np.arange(15_000) % 2000 > 300}, "no uninterrupted run"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_reason(change: dict[str, np.ndarray], reason: str) -> None:
    (window,) = mems_windows(run(60), seed=0)
    found = motion(replace(window, **change), alignment(track(1)), PARAMETERS)
    assert isinstance(found, Reason)
    assert reason in found.text


def test_impossible_parameters_are_refused() -> None:
    with pytest.raises(ParameterError, match="cutoff_wavelength"):
        SignalParameters(cutoff_wavelength=-1.0)

"""Where noise of the yaw sensor hides the error of the lateral displacement, what is expected stands for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_wheelset import ideal, run

from estimation.geometry.estimate import (
    NOISE,
    GeometryParameters,
    _displacement_noise,
    _expected_noise,
    _Replicates,
    estimate_geometry,
)
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.motion.parameters import MOTION
from estimation.tables.bin_table import BinParameters, init, merge_all, tabulate
from estimation.values.geometry import BinTable
from estimation.values.reasons import ReasonCode
from estimation.vehicle.regressors import LATERAL_TARGETS, YAW_TARGETS

BINS, SLOPE, EXPECTED = 21, 0.5, 0.12e-3
PARAMETERS = BinParameters()


def replicates(residual: float, of_sensors: float) -> _Replicates:
    """Return a straight curve with a residual of rL - rR, m, of which sensors make a part, m."""
    yaw = np.zeros((1, BINS, 4, len(YAW_TARGETS)))
    yaw[0, :, 2, 0] = SLOPE * PARAMETERS.width
    yaw[0, :, 1, NOISE] = of_sensors**2
    lateral = np.zeros((1, BINS, 4, len(LATERAL_TARGETS)))
    return _Replicates(lateral, yaw, np.full(BINS, residual), np.full(BINS, 16.0), np.zeros((BINS, 3, 0)))


def found(residual: float, of_sensors: float, expected: float = EXPECTED) -> float:
    return _displacement_noise(
        replicates(residual, of_sensors), np.zeros(BINS, dtype=np.bool_), PARAMETERS, expected, GeometryParameters()
    )


def test_without_sensor_noise_the_residual_shows_the_error() -> None:
    assert found(0.05e-3, 0.0, expected=0.0) == pytest.approx(0.05e-3 / SLOPE / np.sqrt(2.0))


def test_all_of_the_residual_is_error_of_the_displacement_where_that_much_is_expected() -> None:
    assert found(0.05e-3, 0.0, expected=0.08e-3) == pytest.approx(0.08e-3)
    assert found(0.05e-3, 0.0, expected=1e-3) == pytest.approx(0.05e-3 / SLOPE)


def test_noise_of_the_yaw_sensor_hides_it() -> None:
    most = np.sqrt(GeometryParameters().hidden_share) * 0.4e-3
    assert found(0.4e-3, 1.01 * most, expected=2e-3) == pytest.approx(2e-3)
    assert found(0.4e-3, 0.99 * most, expected=2e-3) < 1e-3
    assert found(0.4e-3, 0.4e-3) == pytest.approx(EXPECTED)


def test_the_shipped_figures() -> None:
    assert (
        GeometryParameters().hidden_share,
        GeometryParameters().counted_as_one,
    ) == (0.5, (10_000.0, 10_000.0, 1_000.0))
    assert ParameterUncertainty().of_bogie == (0.02, 0.02, np.radians(2.0))
    assert (ParameterUncertainty().noise_doubt, MOTION.longest_roll_wave) == (0.5, 120.0)


def noisy_table(*stds: float) -> BinTable:
    """Return the table of windows of equally many samples whose sensors are so far off at their speeds, m."""
    moved = ideal(run(240, swing=4.0))
    return merge_all([tabulate(replace(moved, displacement_noise=std**2), PARAMETERS) for std in stds], PARAMETERS)


def test_windows_of_different_speeds_add_their_variances() -> None:
    unknown = ParameterUncertainty()
    assert _expected_noise(noisy_table(0.3e-3, 0.1e-3), PARAMETERS, unknown) == pytest.approx(np.sqrt(0.05) * 1e-3)
    known = replace(unknown, alignment_noise=0.4e-3)
    assert _expected_noise(noisy_table(0.3e-3), PARAMETERS, known) == pytest.approx(0.5e-3)
    assert _expected_noise(init(PARAMETERS), PARAMETERS, known) == 0.4e-3


def test_what_the_sensors_are_off_at_a_low_speed_is_in_the_interval_and_beyond_measure_in_doubt() -> None:
    fast, slow, crawling = (
        estimate_geometry(noisy_table(std), PARAMETERS, GeometryParameters()) for std in (0.0, 0.1e-3, 1e-3)
    )
    for one, other in zip(fast.conicity, slow.conicity, strict=True):
        if one.std is not None and other.std is not None:
            assert other.std >= one.std
    assert slow.rolling_radius_difference.std[20] > 1.1 * fast.rolling_radius_difference.std[20]
    assert (fast.reason, slow.reason) == (None, None)
    assert crawling.reason is not None
    assert crawling.reason.code is ReasonCode.CONICITY_OPEN

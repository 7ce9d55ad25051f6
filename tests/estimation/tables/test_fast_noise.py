"""Vibration in rL - rR: what varies faster than a wheelset can counts as noise, contact jumps do not."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.motion.parameters import MOTION
from estimation.tables.bin_table import fast_noise
from estimation.values.units import STD_PER_MAD

N, RATE = 30_000, 250.0
T = np.arange(N) / RATE
EVERY = np.ones(N, dtype=np.bool_)
SLOW = 0.7e-3 * np.sin(2 * np.pi * 1.3 * T)  # m, a wheelset on its track


def test_white_noise_is_found_beside_the_motion_of_a_wheelset() -> None:
    noise = 0.2e-3 * np.random.default_rng(1).standard_normal(N)
    assert np.sqrt(fast_noise(SLOW + noise, EVERY)) == pytest.approx(0.2e-3, rel=0.06)


def test_a_wheelset_alone_and_its_contact_jumps_are_no_noise() -> None:
    jumping = SLOW + 0.5e-3 * np.sign(SLOW)
    assert np.sqrt(fast_noise(SLOW, EVERY)) < 0.01e-3
    assert np.sqrt(fast_noise(jumping, EVERY)) < 0.02e-3


def test_samples_that_do_not_count_are_left_out() -> None:
    noise = 0.2e-3 * np.random.default_rng(2).standard_normal(N)
    spoiled, half = SLOW + noise, np.arange(N) < N // 2
    spoiled[~half] = np.nan
    assert np.sqrt(fast_noise(spoiled, half)) == pytest.approx(0.2e-3, rel=0.08)
    assert fast_noise(spoiled, ~half) == 0.0


def test_the_mean_is_over_some_hundredths_of_a_second() -> None:
    assert (MOTION.fast_mean_samples, STD_PER_MAD) == (17, 1.4826)

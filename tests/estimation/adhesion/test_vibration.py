"""Axle boxes that vibrate: the forces are found all the same, and a vehicle without vibration keeps its jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bogie_run import SOFT, of_bogie
from test_creep_forces import SIGNALS, found, gear, high_passed, true_forces

from bench.adhesion_case import contact_forces
from estimation.adhesion.creep_forces import without_vibration
from estimation.adhesion.parameters import FORCES
from estimation.values.reasons import Reason
from estimation.values.windows import ACCELERATIONS, Window
from ingest.simulator.sensor_errors import Vibration, vibration_of

STEP = 1e-3  # s


def vibrating(window: Window, seed: int, lateral: float = 2.0) -> Window:
    """Return the window as an axle box shows it that vibrates from 20 Hz on."""
    every = round(window.sample_interval_s / STEP)
    count = every * len(window.valid)
    vibration = Vibration(lateral, 0.5 * lateral, highest_hz=100.0)
    added = vibration_of(vibration, count, np.random.default_rng(seed))[:, ::every]
    return replace(
        window, **{name: getattr(window, name) + row for name, row in zip(ACCELERATIONS, added, strict=True)}
    )


@pytest.mark.parametrize("axle", [1, 2])
def test_forces_under_axle_boxes_that_vibrate_are_those_of_newton(axle: int) -> None:
    windows = [vibrating(window, seed) for seed, window in enumerate(gear())]
    forces = found(windows, of_bogie(SOFT))[axle - 1]
    assert forces.smoothed
    estimated = high_passed(np.stack([forces.contact, forces.moment]))
    true = high_passed(true_forces(axle))
    error = (estimated - true).std(axis=1) / true.std(axis=1)
    assert error[0] < 0.20
    assert error[1] < 0.35
    rms = estimated.std(axis=1) / true.std(axis=1) - 1.0
    assert (np.abs(rms) < 2.0 * np.hypot(FORCES.force_std, FORCES.smoothed_force_std)).all()


def test_without_vibration_nothing_is_smoothed() -> None:
    assert not any(forces.smoothed for forces in found(gear(), of_bogie(SOFT)))


def test_vibration_in_the_band_of_the_forces_diverges() -> None:
    def slow(window: Window, seed: int) -> Window:
        count = 4 * len(window.valid)
        low = Vibration(2.0, 1.0, mass_share=0.5, lowest_hz=5.0, highest_hz=20.0)
        added = vibration_of(low, count, np.random.default_rng(seed))[:, ::4]
        named = zip(ACCELERATIONS, added, strict=True)
        return replace(window, **{name: getattr(window, name) + row for name, row in named})

    windows = [slow(window, seed) for seed, window in enumerate(gear())]
    assert isinstance(contact_forces(windows, of_bogie(SOFT), SIGNALS), Reason)


@pytest.mark.parametrize(("rms", "smoothed"), [(0.245, False), (0.255, True)])
def test_from_which_level_on_an_axle_box_vibrates_is_pinned(rms: float, smoothed: bool) -> None:  # noqa: FBT001 - a parameter
    t = 0.004 * np.arange(5000)
    tones = np.sqrt(2.0) * np.stack([rms * np.sin(2 * np.pi * 60.0 * t), np.sin(2 * np.pi * 60.0 * t)])
    kept, vibrates = without_vibration(tones, np.ones(5000, bool), 0.004, slice(0, 1))
    assert vibrates is smoothed
    assert bool(kept[:, 100:-100].std() < 1e-3) is smoothed
    assert (FORCES.vibration_rms, FORCES.smoothed_force_std) == (0.25, 0.06)


@pytest.mark.parametrize(("hertz", "left"), [(6.0, 0.98), (FORCES.band_hz, 0.5), (20.0, 0.01)])
def test_what_is_slower_than_the_band_stays_in_its_place(hertz: float, left: float) -> None:
    t = 0.004 * np.arange(5000)
    tone, fast = np.sin(2 * np.pi * hertz * t), np.sin(2 * np.pi * 60.0 * t)
    kept, _ = without_vibration(np.stack([tone + fast]), np.ones(5000, bool), 0.004, slice(0, 1))
    middle = slice(100, -100)
    assert kept[0, middle] @ tone[middle] / (tone[middle] @ tone[middle]) == pytest.approx(left, abs=0.03)
    assert FORCES.band_hz == 12.0

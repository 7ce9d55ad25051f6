"""Signs of signals against each other, on motion written out: which signal is turned, and what gravity allows."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from estimation.values.arrays import FloatArray
from ingest.exchange.intake import Turned, sign_evidence
from ingest.exchange.run import ExchangeRun

DT, SPEED = 0.004, 20.0
T = DT * np.arange(7500)
LATERAL, YAW, ROLL, MASS = range(4)


def smooth_noise(seed: int, low: float, high: float) -> FloatArray:
    sos = scipy.signal.butter(3, [low, high], "bandpass", fs=1.0 / DT, output="sos")
    found = scipy.signal.sosfiltfilt(sos, np.random.default_rng(seed).standard_normal(len(T)))
    return np.asarray(found / np.std(found))


def second(values: FloatArray) -> FloatArray:
    return np.gradient(np.gradient(values, DT), DT)


def motion(*turned: int, in_bogie: bool = False, cross_level: float = 0.0, slope: float = 0.05) -> ExchangeRun:
    """Return a wheelset that follows Klingel with noise, under a mass on spring and damper or a stiff frame."""
    y = 2e-3 * smooth_noise(1, 1.0, 3.0)
    roll = slope * y + cross_level * smooth_noise(2, 0.3, 2.0)
    if in_bogie:
        mass = 0.9 * np.roll(y, 8)
    else:
        stiffness, damping, weight = 0.23e6, 50e3, 8000.0
        system = scipy.signal.lti([damping, stiffness], [weight, damping, stiffness])
        mass = scipy.signal.lsim(system, y, T)[1]
    signals = np.column_stack([second(y) + 9.81 * roll, second(np.gradient(y, DT) / SPEED), second(roll), second(mass)])
    signals[:, list(turned)] *= -1.0
    speed = np.full(len(T), SPEED)
    return ExchangeRun(np.arange(len(T)), SPEED * T, speed, SPEED * T, {1: signals})


CASES = [
    ((), None),
    ((LATERAL, MASS), Turned.LATERAL),
    ((YAW,), Turned.YAW),
    ((ROLL,), Turned.ROLL),
    ((MASS,), Turned.MASS_LATERAL),
    ((LATERAL, YAW, MASS), Turned.ROLL),  # x and y turned, as for a vehicle that runs backwards, but not roll
    ((LATERAL, YAW, ROLL, MASS), None),  # the mirror image of a motion is one too
]


@pytest.mark.parametrize("in_bogie", [False, True], ids=["single", "bogie"])
@pytest.mark.parametrize(("turned", "expected"), CASES)
def test_the_signal_that_contradicts_the_others_is_found(
    turned: tuple[int, ...], expected: Turned | None, *, in_bogie: bool
) -> None:
    assert sign_evidence(motion(*turned, in_bogie=in_bogie), 1, in_bogie=in_bogie).turned is expected


def test_cross_level_hides_the_roll_of_the_wheelset_and_is_no_contradiction() -> None:
    assert sign_evidence(motion(cross_level=2e-3), 1, in_bogie=False).turned is None
    assert sign_evidence(motion(ROLL, cross_level=2e-3), 1, in_bogie=False).turned is None
    assert sign_evidence(motion(YAW, cross_level=2e-3), 1, in_bogie=False).turned is Turned.LATERAL_OR_YAW
    assert sign_evidence(motion(LATERAL, MASS, cross_level=2e-3), 1, in_bogie=False).turned is Turned.LATERAL_OR_YAW


def test_signals_that_stand_still_contradict_nothing() -> None:
    speed = np.full(len(T), SPEED)
    run = ExchangeRun(np.arange(len(T)), SPEED * T, speed, SPEED * T, {1: np.zeros((len(T), 4))})
    assert sign_evidence(run, 1, in_bogie=False).turned is None
    assert sign_evidence(run, 1, in_bogie=True).turned is None

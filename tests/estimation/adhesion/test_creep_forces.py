"""Forces at the contacts against the truth of simulated gears; a filter that does not follow is noticed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bogie_run import SOFT, joined, motions, of_bogie, wheelset

from bench.adhesion_case import contact_forces
from estimation.adhesion import creep_forces
from estimation.adhesion.creep_forces import ContactForces
from estimation.adhesion.parameters import FORCES
from estimation.filters import remove_wander
from estimation.motion.integration import SignalParameters
from estimation.values.arrays import FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleClass

SIGNALS = SignalParameters()
TRIMMED = slice(500, -500)


def gear(number: int = 0) -> list[Window]:
    return [joined(SOFT, axle)[number] for axle in (1, 2)]


def found(windows: list[Window], vehicle_class: VehicleClass) -> tuple[ContactForces, ...]:
    forces = contact_forces(windows, vehicle_class, SIGNALS)
    assert not isinstance(forces, Reason), forces
    return forces


def true_forces(axle: int) -> FloatArray:
    """Return contact force and moment of creep (2, n) of the first window, by Newton from the true motion."""
    p, m = wheelset(SOFT), motions(SOFT)[axle - 1]
    assert m.frame_yaw is not None
    spring = p.lateral_stiffness * (m.mass_lateral_displacement - m.lateral_displacement)
    damper = p.lateral_damping * (m.mass_lateral_velocity - m.lateral_velocity)
    contact = p.wheelset_mass * m.lateral_acceleration - spring - damper
    moment = p.yaw_inertia * m.yaw_acceleration + p.yaw_stiffness * (m.yaw - m.frame_yaw)
    moment = moment + p.pitch_inertia * m.speed / p.nominal_radius * m.roll_rate
    return np.stack([contact, moment])[:, :60_000:4]


def high_passed(rows: FloatArray) -> FloatArray:
    run = 0.08 * np.arange(rows.shape[1])
    return remove_wander(rows, run, np.ones(rows.shape[1], bool), SIGNALS.cutoff_wavelength)[:, TRIMMED]


@pytest.mark.parametrize("axle", [1, 2])
def test_forces_in_a_bogie_are_those_of_newton_within_a_tenth(axle: int) -> None:
    forces = found(gear(), of_bogie(SOFT))[axle - 1]
    estimated = high_passed(np.stack([forces.contact, forces.moment]))
    true = high_passed(true_forces(axle))
    error = (estimated - true).std(axis=1) / true.std(axis=1)
    assert error[0] < 0.15
    assert error[1] < 0.10
    assert forces.innovation < 0.5 * FORCES.most_innovation


def test_gaps_change_the_forces_beside_them_alone() -> None:
    windows = gear()
    lost = np.ones(len(windows[0].valid), bool)
    lost[7000:7002] = False
    cut = [replace(window, valid=window.valid & lost) for window in windows]
    whole, gapped = found(windows, of_bogie(SOFT))[0], found(cut, of_bogie(SOFT))[0]
    far = np.r_[600:6000, 8000:14_000]
    difference = high_passed(np.stack([gapped.contact - whole.contact, gapped.moment - whole.moment]))
    scale = high_passed(np.stack([whole.contact, whole.moment])).std(axis=1)
    assert (difference[:, far - 500].std(axis=1) < 0.03 * scale).all()


def test_a_class_with_far_softer_springs_diverges() -> None:
    right = of_bogie(SOFT)
    stiffness = 0.2 * right.parameters.lateral_stiffness
    softer = replace(right, parameters=replace(right.parameters, lateral_stiffness=stiffness))
    forces = contact_forces(gear(), softer, SIGNALS)
    assert isinstance(forces, Reason)
    assert forces.code is ReasonCode.DIVERGED


def noisy(window: Window) -> FloatArray:
    noise = 0.1 * np.random.default_rng(1).standard_normal(len(window.valid))
    return np.asarray(window.mass_lateral_acceleration + noise)


@pytest.mark.parametrize(
    "given",
    [
        noisy,
        lambda window: -window.mass_lateral_acceleration,
        lambda window: 0.0 * window.mass_lateral_acceleration,
    ],
    ids=["noise", "reversed", "dead"],
)
def test_a_sensor_that_does_not_measure_the_frame_diverges(given: Callable[[Window], FloatArray]) -> None:
    front, rear = gear()
    broken = replace(front, mass_lateral_acceleration=given(front))
    forces = contact_forces([broken, rear], of_bogie(SOFT), SIGNALS)
    assert isinstance(forces, Reason)
    assert forces.code is ReasonCode.DIVERGED


def test_what_is_believed_is_pinned(monkeypatch: pytest.MonkeyPatch) -> None:
    assert FORCES.most_innovation == 10.0
    forces = found(gear(), of_bogie(SOFT))[0]
    for share, refused in ((1.01, False), (0.99, True)):
        filtered = replace(creep_forces.FORCES, most_innovation=share * forces.innovation)
        monkeypatch.setattr(creep_forces, "FORCES", filtered)
        assert isinstance(contact_forces(gear(), of_bogie(SOFT), SIGNALS), Reason) is refused


def test_windows_of_another_gear_are_a_mistake() -> None:
    with pytest.raises(ValueError, match="running gear"):
        contact_forces(gear()[:1], of_bogie(SOFT), SIGNALS)


def test_windows_that_stand_still_have_no_forces() -> None:
    still = [replace(window, speed=np.zeros(len(window.valid))) for window in gear()]
    forces = contact_forces(still, of_bogie(SOFT), SIGNALS)
    assert isinstance(forces, Reason)
    assert forces.code is ReasonCode.NO_USABLE_SAMPLE

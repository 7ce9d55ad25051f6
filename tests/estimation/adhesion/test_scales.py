"""Vehicles and wheelsets that show another friction than the others: left out with a reason, and not by chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_friction import KNOWN, TRUE, a_pass

from estimation.adhesion.creep_forces import FileErrors, FrictionParameters
from estimation.adhesion.friction import pooled_friction, section_adhesion
from estimation.adhesion.parameters import FORCES
from estimation.adhesion.pass_sums import SCALES, Agreed, contradicting, pass_sums, scales
from estimation.values.opinions import WindowAdhesion
from estimation.values.reasons import ReasonCode

WEIGHED = replace(KNOWN, file=FileErrors(0.1, 0.05, 0.02, 0.03, 0.03))  # a load that is known


def passes_of(vehicles: int, wrong: int, factor: float) -> list[WindowAdhesion]:
    """Return passes of four wheelsets of each vehicle; the first ``wrong`` wheelsets show another friction."""
    return [a_pass(number, TRUE, factor=factor if number < wrong else 1.0) for number in range(4 * vehicles)]


def test_limits_are_pinned() -> None:
    assert (
        FrictionParameters().wheelset_scatter,
        FrictionParameters().fewest_with_scale,
        FrictionParameters().most_deviation_stds,
        FORCES.most_scale_std,
        FORCES.scale_reach,
    ) == (0.1, 3, 3.0, 0.25, 0.5)
    assert (SCALES[0], SCALES[-1], len(SCALES)) == (-1.8, 1.8, 73)


@pytest.mark.parametrize("factor", [0.7, 0.85, 1.2, 1.5])
def test_the_scale_of_a_vehicle_is_found(factor: float) -> None:
    sums = pass_sums(passes_of(4, 4, factor))
    assert sums is not None
    found = scales(sums, sums.vehicle, Agreed(1.0 / np.array(TRUE), np.zeros(16), 9e-9, KNOWN.creep_error_std))
    assert np.exp(found.logarithm[0]) == pytest.approx(factor, rel=0.1)
    assert np.exp(found.logarithm[1:]) == pytest.approx(1.0, abs=0.05)
    assert found.known.all()
    assert (found.std_from(found.logarithm + 0.1) < 0.05).all()


@pytest.mark.parametrize("factor", [0.35, 2.5, 30.0])
def test_a_vehicle_that_contradicts_the_others_is_left_out_with_its_reason(factor: float) -> None:
    passes = passes_of(4, 4, factor)
    found = section_adhesion("S", passes, KNOWN)
    assert found is not None
    (one,) = found.left_out
    assert (one.vehicle, one.wheelset, one.reason.code) == ("V0", None, ReasonCode.FRICTION_DIFFERS)
    assert found.windows == 12
    rest = section_adhesion("S", passes[4:], KNOWN)
    assert rest is not None
    assert found.cells == rest.cells


@pytest.mark.parametrize(("factor", "left_out"), [(0.75, False), (1.4, False), (0.5, True), (1.9, True)])
def test_what_the_class_states_decides(factor: float, left_out: bool) -> None:  # noqa: FBT001 - a table of cases
    passes = passes_of(4, 4, factor)
    assert bool(pooled_friction(passes, KNOWN)[1]) is left_out
    weighed = pooled_friction(passes, WEIGHED)[1]
    assert [one.vehicle for one in weighed] == ["V0"]


def test_one_wheelset_that_contradicts_its_vehicle_is_left_out_alone() -> None:
    found = pooled_friction(passes_of(4, 1, 2.2), KNOWN)[1]
    assert [(one.vehicle, one.wheelset) for one in found] == [("V0", "W0")]
    assert not pooled_friction(passes_of(4, 1, 1.2), KNOWN)[1]


def test_one_wheelset_of_each_vehicle_is_left_out_at_a_time() -> None:
    passes = [a_pass(number, TRUE, factor=2.2 if number % 4 == 1 else 1.0) for number in range(24)]
    sums = pass_sums(passes)
    assert sums is not None
    agreed = Agreed(1.0 / np.array(TRUE), np.zeros(24), 9e-9, KNOWN.creep_error_std)
    wrong = [(f"V{vehicle}", f"W{4 * vehicle + 1}") for vehicle in range(6)]
    found = contradicting(sums, agreed, KNOWN.file, KNOWN)
    assert sorted((one.vehicle, str(one.wheelset)) for one in found) == wrong
    assert sorted((one.vehicle, str(one.wheelset)) for one in pooled_friction(passes, KNOWN)[1]) == wrong


@pytest.mark.parametrize("under", [0, 3])
def test_wheelsets_that_ran_under_two_vehicles_are_pooled_with_both(under: int) -> None:
    passes = passes_of(4, 0, 1.0)
    last = 3 if under == 0 else 0
    again = [replace(a_pass(40 + k, TRUE), wheelset=f"W{4 * last + k}", vehicle=f"V{under}") for k in range(4)]
    assert pooled_friction([*passes, *again], KNOWN)[1] == ()


def test_wheelsets_are_compared_when_wrong_vehicles_are_gone() -> None:
    passes = passes_of(5, 4, 0.3)
    passes[-1] = a_pass(19, TRUE, factor=2.2)
    found = pooled_friction(passes, KNOWN)[1]
    assert [(one.vehicle, one.wheelset) for one in found] == [("V0", None), ("V4", "W19")]


def test_of_two_vehicles_that_contradict_each_other_none_is_left_out() -> None:
    assert pooled_friction(passes_of(2, 4, 2.5), KNOWN)[1] == ()


def test_vehicles_that_agree_stay_whatever_they_have_in_common() -> None:
    for seed in range(4):
        passes = [a_pass(100 * seed + number, TRUE, creep_error=0.05 * seed) for number in range(12)]
        assert pooled_friction(passes, WEIGHED)[1] == ()
    common = [a_pass(number, TRUE, factor=1.5) for number in range(12)]
    assert pooled_friction(common, WEIGHED)[1] == ()


def test_passes_that_show_no_friction_contradict_nobody() -> None:
    passes = [a_pass(number, [0.4] * 8, used=0.001 if number < 4 else 0.05) for number in range(12)]
    assert pooled_friction(passes, WEIGHED)[1] == ()
    sums = pass_sums(passes)
    assert sums is not None
    agreed = Agreed(np.full(8, 2.5), np.zeros(12), 9e-9, KNOWN.creep_error_std)
    assert not contradicting(sums, agreed, WEIGHED.file, FrictionParameters())

"""What may be behind a step: each cause where it explains it, and not where it cannot."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.trend import explanations
from estimation.values.geometry import KnownConicity
from estimation.values.quantities import Estimate, Status
from estimation.values.trend import StepCause, StepExplanation, StepSurroundings, TrendStep

DAY_NS = 86_400 * 10**9
DESIGNED = {2e-3: 0.07, 2.5e-3: 0.08, 3e-3: 0.1}


def step(before: float, size: float, *, std: float = 0.01, day: int = 100) -> TrendStep:
    estimate = Estimate(size, std, size - 2 * std, size + 2 * std, 4.0, Status.ESTIMATED)
    return TrendStep(
        9e4, 9.1e4, day * DAY_NS, (day + 1) * DAY_NS, (day + 4) * DAY_NS, estimate, before, 3e-3, 0.99, 30, 4
    )


def causes_of(given: TrendStep, around: StepSurroundings) -> dict[StepCause, StepExplanation]:
    found = explanations(given, around)
    assert sum(one.share for one in found) == pytest.approx(1.0)
    assert [one.share for one in found] == sorted((one.share for one in found), reverse=True)
    return {one.cause: one for one in found}


def behind(*conicities: float) -> tuple[KnownConicity, ...]:
    return tuple(KnownConicity(at, value, 0.02, 0.02) for at, value in zip(DESIGNED, conicities, strict=True))


def test_a_fall_to_the_design_curve_was_turned() -> None:
    found = causes_of(step(0.35, -0.25), StepSurroundings(behind(0.071, 0.079, 0.1), DESIGNED, (None, None)))
    assert next(iter(found)) is StepCause.TURNED
    assert found[StepCause.TURNED].left < 0.5
    assert found[StepCause.TURNED].share > 0.7


def test_another_level_or_another_shape_than_the_design_was_exchanged() -> None:
    other_level = causes_of(step(0.35, -0.1), StepSurroundings(behind(0.2, 0.23, 0.25), DESIGNED, (None,)))
    other_shape = causes_of(step(0.35, -0.25), StepSurroundings(behind(0.2, 0.15, 0.1), DESIGNED, (None,)))
    for found in (other_level, other_shape):
        assert next(iter(found)) is StepCause.EXCHANGED
        assert found[StepCause.TURNED].left > 3.0


def test_only_a_rise_is_damage_and_no_worn_level_is_turned() -> None:
    up = causes_of(step(0.1, 0.3), StepSurroundings(behind(0.4, 0.4, 0.4), DESIGNED, (None, None)))
    down = causes_of(step(0.4, -0.3), StepSurroundings(behind(0.07, 0.08, 0.1), DESIGNED, (None, None)))
    assert up[StepCause.DAMAGED].share > 0.15
    assert down[StepCause.DAMAGED].share < 1e-3
    assert up[StepCause.TURNED].share < 1e-3


def test_one_factor_for_all_wheelsets_of_a_vehicle_is_its_sensor_only_at_one_time() -> None:
    own, same, other = step(0.2, 0.1), step(0.3, 0.15), step(0.3, -0.2)
    together = causes_of(own, StepSurroundings((), DESIGNED, (same, same, same)))
    assert next(iter(together)) is StepCause.SENSOR
    alone, unlike = (
        causes_of(own, StepSurroundings((), DESIGNED, others))[StepCause.SENSOR].share
        for others in ((None, None, None), (other, other, other))
    )
    assert max(alone, unlike) < 0.15
    just, late = (
        replace(
            same,
            before_ns=own.after_ns + FINDINGS.simultaneous_ns + apart,
            after_ns=own.after_ns + FINDINGS.simultaneous_ns + DAY_NS,
        )
        for apart in (0, 1)
    )
    assert causes_of(own, StepSurroundings((), DESIGNED, (just,)))[StepCause.SENSOR].share > 0.3
    assert causes_of(own, StepSurroundings((), DESIGNED, (late,)))[StepCause.SENSOR].share < 0.15


def test_a_wheelset_that_kept_its_conicity_may_have_been_turned_end_for_end() -> None:
    small, large = (
        causes_of(step(0.2, size), StepSurroundings())[StepCause.TURNED_END_FOR_END] for size in (0.03, 0.2)
    )
    assert small.left < 1.5
    assert large.left > 5.0


def test_without_a_design_on_file_a_fall_may_have_been_turned_and_a_rise_not() -> None:
    assert causes_of(step(0.3, -0.1), StepSurroundings())[StepCause.TURNED].share > 0.4
    assert causes_of(step(0.3, 0.1), StepSurroundings())[StepCause.TURNED].share < 1e-3

"""Which windows are looked at: just inside of every limit, and just outside."""

from __future__ import annotations

from dataclasses import replace

import pytest
from plain_windows import GOOD

from estimation.motion.checks import gate
from estimation.motion.integration import Gates
from estimation.values.reasons import ReasonCode, code_of

GATES = Gates()


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"coverage": 0.25}, None),
        ({"coverage": 0.249}, ReasonCode.TOO_FEW_SAMPLES),
        ({"clipped": 0.1}, None),
        ({"clipped": 0.101}, ReasonCode.CLIPPED),
        ({"position_quality": 0.1}, None),
        ({"position_quality": 0.099}, ReasonCode.POSITION_UNKNOWN),
        ({"sensor_fault": True}, ReasonCode.SENSOR_FAULT),
        ({}, None),
    ],
)
def test_the_quality_of_a_window_at_its_limits(change: dict[str, float], code: ReasonCode | None) -> None:
    assert code_of(gate(replace(GOOD, **change), "S1", GATES)) is code


def test_a_window_without_section_is_refused_and_the_worst_reason_comes_first() -> None:
    assert code_of(gate(GOOD, None, GATES)) is ReasonCode.SECTION_UNKNOWN
    bad = replace(GOOD, sensor_fault=True, coverage=0.0, clipped=1.0, position_quality=0.0)
    order = []
    for cure in ({"sensor_fault": False}, {"coverage": 1.0}, {"clipped": 0.0}):
        order.append(code_of(gate(bad, None, GATES)))
        bad = replace(bad, **cure)
    assert order == [ReasonCode.SENSOR_FAULT, ReasonCode.TOO_FEW_SAMPLES, ReasonCode.CLIPPED]
    assert code_of(gate(bad, None, GATES)) is ReasonCode.SECTION_UNKNOWN
    assert code_of(gate(bad, "S1", GATES)) is ReasonCode.POSITION_UNKNOWN


def test_the_limits_are_those_that_are_given() -> None:
    strict = Gates(least_coverage=0.9, most_clipped=0.01, least_position_quality=0.5)
    assert code_of(gate(replace(GOOD, coverage=0.89), "S1", strict)) is ReasonCode.TOO_FEW_SAMPLES
    assert code_of(gate(replace(GOOD, clipped=0.02), "S1", strict)) is ReasonCode.CLIPPED
    assert code_of(gate(replace(GOOD, position_quality=0.4), "S1", strict)) is ReasonCode.POSITION_UNKNOWN

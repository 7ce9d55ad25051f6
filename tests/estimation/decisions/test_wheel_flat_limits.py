"""How many windows of blows raise and clear an alert, which turn is believed, and what blows excuse."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from plain_facts import facts_of
from plain_windows import GOOD
from wheelset_life import START_NS, WINDOW_NS, window_record
from windows_finding import windows_finding

from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.sensor_data import NoDataRule, SensorFaultRule, faulty
from estimation.alerts.rules.wheels import WheelFlatRule, strikes
from estimation.motion.checks import gate
from estimation.motion.integration import Gates
from estimation.values.alerts import Finding, Severity
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.registry import Mounting, Reprofiling, WheelsetRecord
from estimation.values.windows import Hunting, TurnBlows, WindowRecord, WindowState

RULE = WheelFlatRule()
TURN = 2.0 * math.pi * 0.45
MOUNTING = Mounting("W", "V1", 1, 5, None, 0.0, 0.0)
WHEELSET = WheelsetRecord("W", "F", "P8", 0.45, MOUNTING)


def window(
    number: int, share: float = 1.0, *, size: float = 20.0, side: int = 1, turn: float = TURN, clipped: float = 0.0
) -> WindowRecord:
    record = window_record("W", number, clipped=clipped)
    return replace(record, quality=replace(record.quality, blows=TurnBlows(share, size, turn, side)))


def of_windows(striking: int, calm: int, size: float = 20.0) -> Finding:
    windows = [window(n, 1.0 if n < striking else 0.0, size=size) for n in range(striking + calm)]
    return windows_finding(RULE, list(reversed(windows)))


@pytest.mark.parametrize(
    ("striking", "calm", "breached", "cleared"),
    [
        (2, 0, None, None),
        (3, 0, True, False),
        (3, 4, False, False),
        (8, 12, True, False),
        (7, 13, False, False),
        (0, 3, False, False),
        (0, 9, False, True),
        (0, 8, False, False),
        (1, 19, False, True),
        (2, 18, False, False),
    ],
)
def test_windows_of_blows_raise_and_their_absence_clears(
    striking: int,
    calm: int,
    breached: bool | None,  # noqa: FBT001 - of the table
    cleared: bool | None,  # noqa: FBT001 - of the table
) -> None:
    found = of_windows(striking, calm)
    assert (found.breached, found.cleared, found.severity) == (breached, cleared, Severity.WARNING)


def test_the_evidence_names_size_wheel_and_turn() -> None:
    found = of_windows(4, 2)
    assert {**found.evidence, "probability": found.probability} == {
        "striking_windows": 4,
        "windows": 6,
        "blow_m_s2": 20.0,
        "wheel": "left",
        "turn_m": 2.83,
        "speed_max_km_h": 72.0,
        "unknown_because": None,
        "unknown_because_code": None,
        "probability": pytest.approx(0.987, abs=1e-3),
    }
    assert (found.action, of_windows(0, 3).evidence["wheel"]) == ("inspect_wheel_treads", None)
    turned = windows_finding(RULE, [window(n) for n in range(3)], reversed_=True)
    assert turned.evidence["wheel"] == "right"


def test_severity_is_by_size() -> None:
    assert of_windows(3, 0, size=34.9).severity is Severity.WARNING
    assert of_windows(3, 0, size=35.0).severity is Severity.CRITICAL


def test_a_wheel_is_named_where_windows_agree() -> None:
    def wheel(*sides: int) -> object:
        windows = [window(n, side=side) for n, side in enumerate(sides)]
        return windows_finding(RULE, windows).evidence["wheel"]

    assert (wheel(-1, -1, -1), wheel(1, 1, -1), wheel(1, 1, 0), wheel(1, 0, 0)) == ("right", None, "left", None)
    assert wheel(*[1] * 9, -1) == "left"
    assert wheel(*[1] * 8, -1, -1) is None
    assert FINDINGS.same_side_share == 0.8


def test_a_window_strikes_for_half_of_its_time_at_the_turn_of_the_wheel() -> None:
    assert strikes(window(0, 0.5), TURN)
    assert not strikes(window(0, 0.49), TURN)
    assert FINDINGS.turn_tolerance == 0.1
    assert strikes(window(0, turn=1.09 * TURN), TURN)
    assert not strikes(window(0, turn=1.11 * TURN), TURN)
    assert not strikes(window(0, turn=0.89 * TURN), TURN)


def test_the_lathe_removes_a_flat() -> None:
    windows = [window(n) for n in range(6)]
    facts = replace(facts_of(windows=windows), wheelset=WHEELSET)
    found = RULE.find(facts, 0)
    assert found is not None
    assert found.breached
    turned = Reprofiling("W", START_NS + 4 * WINDOW_NS, 1.0)
    after = RULE.find(replace(facts, wheelset=replace(WHEELSET, reprofilings=(turned,))), 0)
    assert after is not None
    assert (after.breached, after.evidence["windows"]) == (None, 2)


def test_a_sensor_that_clips_in_blows_or_beside_a_wheelset_that_hunts_is_sound() -> None:
    rule = SensorFaultRule()
    assert faulty(rule, window(0, 0.0, clipped=0.3)) == "clipping"
    assert faulty(rule, window(0, 0.5, clipped=0.3)) == ""
    start = window(0).start_ns
    assert faulty(rule, window(0, 0.0, clipped=0.3), frozenset({start})) == ""
    assert faulty(rule, window(1, 0.0, clipped=0.3), frozenset({start})) == "clipping"
    hunting = replace(window(2, 0.0, clipped=0.3).quality, hunting=Hunting(0.5, 3.0, 0.005))
    assert faulty(rule, replace(window(2, 0.0, clipped=0.3), quality=hunting)) == ""


def test_a_flat_that_saturates_names_itself() -> None:
    flat, gates = replace(GOOD, blows=TurnBlows(0.5, 40.0, TURN, 1)), Gates()
    assert gate(replace(flat, clipped=0.0019), "S", gates) is None
    assert code_of(gate(replace(flat, clipped=0.0021), "S", gates)) is ReasonCode.WHEEL_FLAT
    some = replace(flat, blows=TurnBlows(0.49, 40.0, TURN, 1))
    assert gate(replace(some, clipped=0.0999), "S", gates) is None
    assert code_of(gate(replace(some, clipped=0.1001), "S", gates)) is ReasonCode.CLIPPED


def test_silence_says_what_arrives_and_why_it_cannot_be_used() -> None:
    jump, few = Reason(ReasonCode.POSITION_JUMP, "by 40 m"), Reason(ReasonCode.TOO_FEW_SAMPLES, "10 %")
    used = window_record("W", 0)
    why = [few, jump, jump, few, jump]
    refused = [
        replace(window_record("W", n + 1), state=WindowState.REFUSED, reason=reason) for n, reason in enumerate(why)
    ]
    facts = replace(facts_of(windows=[used, *refused]), wheelset=WHEELSET, geometry=None)
    found = NoDataRule().find(facts, START_NS + 40 * 86_400 * 10**9)
    assert found is not None
    assert found.breached
    assert found.evidence["refused_windows"] == 5
    assert found.evidence["reasons"] == {"position_jump": 3, "too_few_samples": 2}
    assert (found.evidence["reason"], found.action) == ("by 40 m", "check_refused_windows")
    silent = NoDataRule().find(replace(facts, windows=[used]), START_NS + 40 * 86_400 * 10**9)
    assert silent is not None
    assert (silent.evidence["refused_windows"], silent.action) == (0, "check_sensor_and_connection")

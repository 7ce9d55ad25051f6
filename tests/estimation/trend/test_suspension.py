"""A yaw spring that softens is found; friction that all vehicles share is not taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.alerts.life_cycle import transition
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.alerts.rules.running_gear import SuspensionChangeRule, suspension_change_finding
from estimation.trend.suspension import SuspensionParameters, suspension_changes, suspension_histories
from estimation.values.alerts import Alert
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.trend import SuspensionChange, SuspensionFinding, SuspensionShown

DAY = 86_400_000_000_000
RULE = SuspensionChangeRule()


def finding(vehicle: str, day: int, ratio: float, *, section: str = "S", std: float = 0.03) -> SuspensionFinding:
    return SuspensionFinding(vehicle, section, day * DAY, (day + 1) * DAY, ratio, std, 0.34, "v", 1)


def history(
    vehicle: str, ratios: list[float], *, friction: list[float] | None = None, seed: int = 0, std: float = 0.03
) -> list[SuspensionFinding]:
    """Return one finding a day, with the error of its std."""
    rng = np.random.default_rng([seed, *vehicle.encode()])
    common = friction or [1.0] * len(ratios)
    return [
        finding(vehicle, day, ratio * f * (1.0 + std * float(rng.standard_normal())), std=std)
        for day, (ratio, f) in enumerate(zip(ratios, common, strict=True))
    ]


def softened(by: float, days: int = 8) -> list[float]:
    return [1.0] * (days - 3) + [1.0 - by] * 3


def breached(change: SuspensionChange) -> bool | None:
    return suspension_change_finding(RULE, "W", change).breached


def test_a_spring_that_softens_is_found_and_only_there() -> None:
    for seed in range(10):
        fleet = [*history("A", softened(0.4), seed=seed)]
        for other in "BCDE":
            fleet += history(other, [1.0] * 8, seed=seed)
        changes = suspension_changes(fleet)
        assert breached(changes["A"]) is True
        assert changes["A"].change == pytest.approx(-0.4, abs=3.0 * changes["A"].std)
        assert [breached(changes[other]) for other in "BCDE"] == [False] * 4
        assert (changes["A"].past, changes["A"].recent, changes["A"].others) == (5, 3, 4)
        assert changes["A"].recent_ns == 8 * DAY


def test_a_history_goes_back_finding_by_finding() -> None:
    own, others = history("A", softened(0.4)), [*history("B", [1.0] * 8), *history("C", [1.0] * 8)]
    found = list(suspension_histories([*reversed(own), *others])["A"])
    assert [(change.past, change.recent, change.recent_ns) for change in found] == [
        (5, 3, 8 * DAY),
        (4, 3, 7 * DAY),
        (3, 3, 6 * DAY),
    ]
    assert found[0] == suspension_changes([*own, *others])["A"]
    assert abs(found[1].change) > abs(found[2].change)


def facts_of(shown: SuspensionShown | None, *alerts: Alert) -> WheelsetFacts:
    wheelset = WheelsetRecord("W", "F", "P8", 0.45, Mounting("W", "A", 1, 0, None, 0.0, 0.0))
    return WheelsetFacts(
        wheelset=wheelset, vehicle=None, geometry=None, trend=None, windows=(), open_alerts=alerts, suspension=shown
    )


def test_an_alert_whose_findings_were_taken_away_is_cleared_and_no_other() -> None:
    change = suspension_changes(history("A", softened(0.5)))["A"]
    raised = RULE.find(facts_of(SuspensionShown(change, stands=True, since_ns=7 * DAY)), 0)
    assert raised is not None
    opened = transition(None, raised, 0, fleet="F")
    assert opened is not None
    assert opened.alert.opened_ns == 7 * DAY
    taken = RULE.find(facts_of(SuspensionShown(None, stands=False), opened.alert), 0)
    assert taken is not None
    closed = transition(opened.alert, taken, 0, fleet="F")
    assert closed is not None
    assert closed.alert.closed_ns == opened.alert.last_seen_ns
    assert RULE.find(facts_of(SuspensionShown(None, stands=False)), 0) is None
    assert RULE.find(facts_of(None, opened.alert), 0) is None


def test_friction_that_all_share_is_no_change() -> None:
    """Wet rails for three days: the ratio of every vehicle is higher by half."""
    wet = [1.0] * 5 + [1.5] * 3
    fleet = [one for name in "ABCDE" for one in history(name, [1.0] * 8, friction=wet)]
    changes = suspension_changes(fleet)
    assert [breached(changes[name]) for name in "ABCDE"] == [False] * 5
    assert max(abs(one.change) for one in changes.values()) < 0.15
    spring = [one for one in fleet if one.vehicle != "A"] + history("A", softened(0.4), friction=wet)
    assert breached(suspension_changes(spring)["A"]) is True


def test_a_vehicle_alone_needs_more_for_friction_may_be_it() -> None:
    alone = suspension_changes(history("A", softened(0.3)))["A"]
    assert alone.others == 0
    assert breached(alone) is False
    assert breached(suspension_changes(history("A", softened(0.5)))["A"]) is True
    fleet = [*history("A", softened(0.3)), *history("B", [1.0] * 8), *history("C", [1.0] * 8)]
    assert suspension_changes(fleet)["A"].std < 0.7 * alone.std


def test_intervals_of_the_change_cover() -> None:
    """Drawn as assumed: errors of each finding, friction of each day, and a little of each vehicle's own."""
    p = SuspensionParameters()
    inside = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        wet = np.exp(p.common_creep_std * rng.standard_normal(8)).tolist()
        fleet = []
        for name in "ABCD":
            own = np.exp(p.own_creep_std * rng.standard_normal(8))
            spring = softened(0.25) if name == "A" else [1.0] * 8
            fleet += history(name, (own * spring).tolist(), friction=wet, seed=seed)
        change = suspension_changes(fleet)["A"]
        inside.append(abs(change.change + 0.25) < 1.96 * change.std)
    assert np.mean(inside) >= 0.88


@pytest.mark.parametrize(("others", "found"), [("B", None), ("BC", True), ("BCD", True)])
def test_a_vehicle_whose_spring_has_changed_does_not_accuse_the_others(others: str, found: bool | None) -> None:  # noqa: FBT001
    for seed in range(10):
        fleet = history("A", softened(0.45), seed=seed)
        fleet += [one for name in others for one in history(name, [1.0] * 8, seed=seed)]
        changes = suspension_changes(fleet)
        assert [breached(changes[name]) for name in others] == [False] * len(others)
        assert found is None or breached(changes["A"]) is found


def test_vehicles_of_one_day_show_each_others_friction() -> None:
    """Their passes follow each other; those of other days or sections show nothing."""
    fleet = [*history("A", [1.0] * 8), *history("B", [1.0] * 8)]

    def others(hours: float, section: str = "S") -> int:
        by = round(hours / 24.0 * DAY)
        moved = [
            replace(one, from_ns=one.from_ns + by, to_ns=one.from_ns + by + 1, section=section)
            for one in fleet
            if one.vehicle == "B"
        ]
        short = [replace(one, to_ns=one.from_ns + 1) for one in fleet if one.vehicle == "A"]
        return suspension_changes([*short, *moved], SuspensionParameters(together_days=0.25))["A"].others

    assert [others(hours) for hours in (0.0, 5.9, 6.1, -5.9, -6.1)] == [1, 1, 0, 1, 0]
    assert others(0.0, "elsewhere") == 0


def test_the_past_is_the_newest_of_what_was_before() -> None:
    long_ago = history("A", [2.0] * 10 + [1.0] * 10 + [0.5] * 3)
    assert suspension_changes(long_ago, SuspensionParameters(most_past=10))["A"].change == pytest.approx(-0.5, abs=0.05)
    assert suspension_changes(long_ago)["A"].past == 20


def test_too_few_findings_say_nothing() -> None:
    assert suspension_changes([]) == {}
    assert suspension_changes(history("A", [1.0] * 5)) == {}
    assert set(suspension_changes(history("A", [1.0] * 6))) == {"A"}


def test_another_class_on_file_is_no_change() -> None:
    """The ratio is relative to what was assumed: twice the assumed one halves it."""
    whole = history("A", [1.0] * 8)
    other_class = [replace(one, ratio=one.ratio / 2.0, ratio_std=one.ratio_std / 2.0, assumed=0.68) for one in whole]
    mixed = suspension_changes([*whole[:5], *other_class[5:]])["A"]
    assert mixed.change == pytest.approx(suspension_changes(whole)["A"].change, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "raised", "cleared"),
    [(-0.2, False, False), (-0.265, True, False), (0.265, True, False), (-0.105, False, True), (-0.115, False, False)],
)
def test_the_limits_of_the_rule(change: float, raised: bool, cleared: bool) -> None:  # noqa: FBT001 - of the table
    found = suspension_change_finding(RULE, "W", SuspensionChange("A", change, 0.05, 5, 3, 4, 9))
    assert (found.breached, found.cleared) == (raised, cleared)
    assert (found.measured_ns, found.evidence["vehicle"], found.evidence["other_vehicles"]) == (9, "A", 4)


def test_a_spring_that_is_a_fifth_softer_is_found_among_others_and_does_not_fade() -> None:
    soon = []
    for seed in range(4):
        fleet = history("A", [1.0] * 10 + [0.8] * 30, seed=seed)
        for other in "BCDE":
            fleet += history(other, [1.0] * 40, seed=seed)
        newest_first = list(suspension_histories(fleet)["A"])
        now, fourth = newest_first[0], next(one for one in newest_first if one.recent_ns == 14 * DAY)
        assert breached(now) is True
        assert (now.past, now.recent) == (10, 30)
        assert now.change == pytest.approx(-0.2, abs=0.04)
        assert now.since_ns == 10 * DAY
        assert now.step_probability is not None
        soon.append(breached(fourth))
        assert [breached(one) for one in newest_first if one.recent_ns <= 10 * DAY] == [False] * 5
        assert breached(suspension_changes(fleet)["B"]) is False
    assert soon == [True] * 4


def test_a_change_at_once_is_found_from_a_tenth_and_only_where_it_was_at_once() -> None:
    sure = SuspensionChange("A", -0.164, 0.05, 9, 9, 4, 9 * DAY, step_probability=0.99, since_ns=5 * DAY)
    assert RULE.raise_step == 0.1
    assert breached(sure) is False
    assert breached(replace(sure, change=-0.165)) is True
    assert breached(replace(sure, change=-0.165, step_probability=None)) is False

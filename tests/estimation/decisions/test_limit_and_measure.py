"""When a wheelset that does not move 3 mm is over its limit, and when it is to be measured: just inside and outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from believed_now import ahead_of, believed, with_ahead
from plain_facts import BELOW, above, facts_of, geometry_record, trend_of
from wheelset_life import geometry_of, known

from estimation.alerts.rules.conicity_limit import (
    ConicityLimitRule,
    MeasureRule,
    conicity_limit_finding,
    measure_finding,
)
from estimation.alerts.rules.trend import LimitForecastRule, limit_forecast_finding
from estimation.trend.extrapolation import Extrapolation
from estimation.trend.now import LimitState, limit_state
from estimation.values.alerts import Finding, Severity
from estimation.values.quantities import Estimate, Forecast
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import LevelCalibration

LIMIT = 0.4
RULE, LIMIT_RULE = MeasureRule(), ConicityLimitRule()
UNKNOWN = Estimate.unknown(Reason(ReasonCode.AMPLITUDE_NOT_COMPARABLE, "the conicity is known at 1.75 mm"))


def even(probability: float) -> LimitState:
    """Return a wheelset that covers 1.75 mm, below the limit there, and is over it at 3 mm with a probability."""
    beyond = Extrapolation(0.35, 0.03, 0.03, 1e-6, (0.0,) * 40)
    return LimitState(above(probability, LIMIT, 0.03), known(0.3, 0.01), 1.75e-3, (), beyond)


def decided(state: LimitState, windows: int = 8) -> Finding:
    return conicity_limit_finding(LIMIT_RULE, "W", believed(state, LIMIT), windows, 5)


def found(state: LimitState, *, measured: bool = False, windows: int = 8) -> Finding:
    return measure_finding(RULE, believed(state, LIMIT), decided(state, windows), measured=measured)


@pytest.mark.parametrize(
    ("at_reached", "at_3_mm", "breached"),
    [(0.91, 0.61, True), (0.89, 0.61, False), (0.91, 0.59, False), (0.2, 0.91, True), (0.2, 0.89, False)],
)
def test_over_the_limit_at_the_amplitude_reached_is_over_it_unless_rather_below_at_3_mm(
    *, at_reached: float, at_3_mm: float, breached: bool
) -> None:
    state = replace(even(at_3_mm), reached=above(at_reached, LIMIT, 0.01))
    finding = decided(state)
    assert finding.breached is breached
    by_reached = at_reached > at_3_mm >= 0.6
    assert finding.evidence["amplitude_mm"] == (1.75 if by_reached else 3.0)
    assert found(state).breached is not breached  # what is not over it for sure is measured


def test_where_nothing_is_known_of_3_mm_the_amplitude_reached_decides_alone() -> None:
    over = LimitState(UNKNOWN, above(0.91, LIMIT, 0.01), 1.75e-3)
    assert (decided(over).breached, decided(over).severity) == (True, Severity.CRITICAL)
    perhaps = replace(over, reached=above(0.61, LIMIT, 0.01))
    assert (decided(perhaps).breached, found(perhaps).breached) == (False, True)
    below = replace(over, reached=above(0.4, LIMIT, 0.01))
    assert (decided(below).breached, found(below).breached, found(below).cleared) == (None, True, False)
    assert found(below, measured=True).cleared is True
    silent = measure_finding(RULE, believed(below, LIMIT), decided(below, windows=2), measured=False)
    assert (silent.breached, silent.cleared) == (None, None)
    nothing = replace(below, reached=None)
    assert (found(nothing).breached, found(nothing).cleared) == (None, None)
    assert decided(below).evidence["unknown_because_code"] == "amplitude_not_comparable"


def test_an_alert_by_the_amplitude_reached_does_not_clear_while_it_is_over_there() -> None:
    state = replace(even(0.001), reached=known(0.42, 0.01))
    assert decided(state).cleared is False
    assert decided(replace(state, conicity=known(0.2, 0.01), reached=known(0.3, 0.01))).cleared is True


@pytest.mark.parametrize(
    ("first", "second", "breached"), [(0.91, 0.91, True), (0.89, 0.99, False), (0.99, 0.89, False)]
)
def test_the_last_two_points_over_the_limit_are_over_it_whatever_the_smooth_curve_says(
    *, first: float, second: float, breached: bool
) -> None:
    state = LimitState(known(0.3, 0.01), last=(above(first, LIMIT, 0.02), above(second, LIMIT, 0.02)))
    assert decided(state).breached is breached
    assert decided(replace(state, last=state.last[1:])).breached is False


@pytest.mark.parametrize(
    ("probability", "breached", "cleared"),
    [(0.13, True, False), (0.11, False, False), (0.105, False, False), (0.095, False, True), (0.91, False, True)],
)
def test_an_extrapolated_conicity_that_may_be_over_is_measured(
    *, probability: float, breached: bool, cleared: bool
) -> None:
    finding = found(even(probability))
    assert (finding.breached, finding.cleared) == (breached, cleared)
    assert (finding.severity, finding.action) == (Severity.WARNING, "measure_wheel_profiles")


@pytest.mark.parametrize(
    ("conicity", "breached"),
    [
        (above(0.51, LIMIT, 0.02), True),
        (above(0.49, LIMIT, 0.02), False),
        (above(0.91, LIMIT, 0.02), False),
        (known(0.30, 0.1532), True),
        (known(0.30, 0.1530), False),
    ],
)
def test_a_conicity_known_at_3_mm_is_measured_where_it_is_rather_over_or_wide_open(
    *, conicity: Estimate, breached: bool
) -> None:
    assert found(LimitState(conicity)).breached is breached


@pytest.mark.parametrize(
    ("over", "severity"), [(0.89, Severity.WARNING), (0.9, Severity.CRITICAL), (None, Severity.WARNING)]
)
def test_a_forecast_of_what_is_over_the_limit_now_is_critical(over: float | None, severity: Severity) -> None:
    ahead = with_ahead(replace(trend_of(probability=over), distance_to_limit_km=Forecast(1e4, 2e4, 4e4)))
    assert limit_forecast_finding(LimitForecastRule(), "W", ahead, ahead_of(BELOW, ahead), 5).severity is severity


@pytest.mark.parametrize(("since_km", "breached"), [(None, False), (9_999.0, False), (10_001.0, True)])
def test_a_forecast_counts_from_the_newest_mileage(*, since_km: float | None, breached: bool) -> None:
    ahead = with_ahead(replace(trend_of(), distance_to_limit_km=Forecast(2e4, 3e4, 4e4)))
    finding = limit_forecast_finding(LimitForecastRule(), "W", ahead, ahead_of(BELOW, ahead, since_km), 5)
    assert finding.breached is breached
    left = [0.0 if since_km is None else since_km] * 3
    assert [far - run for far, run in zip((2e4, 3e4, 4e4), left, strict=True)] == pytest.approx(
        [*finding.evidence["distance_to_limit_km"].values()]  # type: ignore[union-attr]
    )


def test_a_measurement_decides_and_unknown_stays_unknown() -> None:
    state = even(0.5)
    assert (found(state).breached, found(state, measured=True).breached) == (True, False)
    assert found(state, measured=True).cleared is True
    few = found(state, windows=2)
    assert (few.breached, few.cleared, few.evidence["unknown_because_code"]) == (None, None, "too_few_windows")


@pytest.mark.parametrize(("measured_km", "breached"), [(None, True), (1e4 - 1.0, True), (1e4 + 1.0, False)])
def test_a_measurement_holds_for_10_000_km(*, measured_km: float | None, breached: bool) -> None:
    rather_over = replace(geometry_record(geometry_of(conicity=0.402)), mileage_km=2e4)
    facts = facts_of(geometry=rather_over, limit_rule=LIMIT_RULE, profiles_measured_km=measured_km)
    finding = RULE.find(facts, 0)
    assert finding is not None
    assert finding.breached is breached
    assert RULE.find(replace(facts, limit_rule=None), 0) is None
    assert RULE.find(replace(facts, vehicle=None), 0) is None


@pytest.mark.parametrize(("reached", "counts"), [(1.5e-3, True), (1.25e-3, False), (2.75e-3, True), (3e-3, False)])
def test_an_amplitude_of_one_and_a_half_to_less_than_3_mm_is_held_against_the_limit(
    *, reached: float, counts: bool
) -> None:
    covered = replace(geometry_of(conicity=0.6), amplitude=np.array([reached]), conicity=(known(0.6, 0.01),))
    covered = replace(covered, reported_amplitude=reached)
    state = limit_state(covered, None)
    assert state.extrapolated is counts
    assert state.reached_amplitude == (reached if counts else 3e-3)


@pytest.mark.parametrize(
    ("amplitude", "windows", "breached"),
    [(1.5e-3, 8, True), (3e-3, 8, True), (1.25e-3, 8, None), (3.25e-3, 8, None), (3e-3, 2, None)],
)
def test_a_conicity_that_the_data_leave_open_where_a_limit_is_held_may_be_beyond_it(
    *, amplitude: float, windows: int, breached: bool | None
) -> None:
    unknown = Estimate.unknown(Reason(ReasonCode.CONICITY_OPEN, "open by 0.3 either way"))
    left_open = replace(
        geometry_of(conicity=0.2, windows=windows),
        amplitude=np.array([amplitude]),
        conicity=(unknown,),
        equivalent_conicity=unknown,
    )
    finding = RULE.find(facts_of(geometry=geometry_record(left_open), limit_rule=LIMIT_RULE), 0)
    assert finding is not None
    assert (finding.breached, finding.cleared) == (breached, None if breached is None else False)
    measured = facts_of(geometry=geometry_record(left_open), limit_rule=LIMIT_RULE, profiles_measured_km=0.0)
    after_measuring = RULE.find(measured, 0)
    assert after_measuring is not None
    assert after_measuring.breached is (None if breached is None else False)


def test_the_last_points_are_those_of_a_trend_that_a_limit_is_held_against() -> None:
    geometry = geometry_of(conicity=0.6)
    assert [one.value for one in limit_state(geometry, trend_of()).last] == [0.3, 0.3]
    assert not limit_state(geometry, None).last


def test_a_trend_that_measured_profiles_moved_is_held_against_the_limit_as_moved() -> None:
    covers_2_mm = geometry_of(conicity=0.36)
    covers_2_mm = replace(
        covers_2_mm, amplitude=np.array([1e-3, 2e-3]), conicity=covers_2_mm.conicity[:2], reported_amplitude=2e-3
    )
    plain = replace(trend_of(), std=np.full(3, 0.05))
    for profiles, last, std in ((1, 0.26, 0.0125), (0, 0.3, 0.05)):
        said = LevelCalibration(profiles, 1 - profiles, -0.04 * profiles, 0.0075, ())
        state = limit_state(covers_2_mm, replace(plain, calibration=said))
        assert [point.value for point in state.last] == pytest.approx([last] * 2)
        assert [point.std for point in state.last] == pytest.approx([std] * 2)
        assert (state.beyond is None) is bool(profiles)

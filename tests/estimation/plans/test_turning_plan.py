"""The turning plan: cases worked out by hand, and what holds of every plan."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.values.reasons import Reason, ReasonCode
from estimation.worklist.turning_plan import Candidate, Cause, DiameterLimits, PlanLine, Radii, turning_plan

DAY = 86_400_000_000_000
NOW = 1_800_000_000_000_000_000
LIMITS = DiameterLimits(
    cut=3e-3, minimum_radius=0.42, axle_difference=0.5e-3, bogie_difference=5e-3, vehicle_difference=10e-3
)


def wheelset(axle: int, due_days: float | None = None, radius: float | None = 0.46, vehicle: str = "V") -> Candidate:
    return Candidate(
        serial=f"{vehicle}-{axle}",
        vehicle=vehicle,
        axle=axle,
        bogie=(axle + 1) // 2,
        over_limit=False,
        due_ns=None if due_days is None else NOW + round(due_days * DAY),
        reason=f"due in {due_days} days",
        unknown=None,
        radii=None if radius is None else Radii(radius, radius),
    )


def plan(*wheelsets: Candidate, limits: DiameterLimits = LIMITS) -> list[PlanLine]:
    return turning_plan(wheelsets, limits, NOW, 90 * DAY, 30 * DAY)


def summary(lines: list[PlanLine]) -> list[tuple[int, Cause, int | None, float | None]]:
    return [
        (
            one.candidate.axle,
            one.cause,
            one.visit,
            None if one.radius_after is None else round(1e3 * one.radius_after, 6),
        )
        for one in lines
    ]


def test_a_turned_wheelset_takes_the_other_of_its_bogie_with_it() -> None:
    """3 mm off the radius make 6 mm of diameter: more than 5 in the bogie, less than 10 in the vehicle."""
    lines = plan(wheelset(1, 20.0), wheelset(2), wheelset(3), wheelset(4))
    assert summary(lines) == [(1, Cause.DUE, 1, 457.0), (2, Cause.TOGETHER, 1, 457.0)]
    assert lines[0].reason == "due in 20.0 days"
    assert lines[1].reason == "turned together with axle 1, because the diameters would differ by 6.0 mm > 5 mm"
    assert {one.turn_by_ns for one in lines} == {NOW + 20 * DAY}


def test_the_limit_of_the_vehicle_reaches_the_other_bogie() -> None:
    """454 - 3 = 451 mm: 18 mm of diameter below 460, so the others go down to 451 + 2.5 and 451 + 5 mm."""
    lines = plan(wheelset(1, 20.0, 0.454), wheelset(2), wheelset(3), wheelset(4))
    assert summary(lines) == [
        (1, Cause.DUE, 1, 451.0),
        (2, Cause.TOGETHER, 1, 453.5),
        (3, Cause.TOGETHER, 1, 456.0),
        (4, Cause.TOGETHER, 1, 456.0),
    ]


def test_what_becomes_due_later_is_another_visit_unless_it_is_close() -> None:
    loose = replace(LIMITS, bogie_difference=None, vehicle_difference=None)
    lines = plan(wheelset(1, 10.0), wheelset(2, 39.0), wheelset(3, 41.0), wheelset(4, 91.0), limits=loose)
    assert summary(lines) == [(1, Cause.DUE, 1, 457.0), (2, Cause.DUE, 1, 457.0), (3, Cause.DUE, 2, 457.0)]


def test_what_was_turned_with_another_is_not_due_again_later() -> None:
    lines = plan(wheelset(1, 10.0), wheelset(2, 60.0))
    assert summary(lines) == [(1, Cause.DUE, 1, 457.0), (2, Cause.TOGETHER, 1, 457.0)]


def test_what_is_over_the_limit_is_due_now() -> None:
    over = replace(wheelset(1), over_limit=True, reason="limit exceeded")
    (line,) = plan(over)
    assert (line.cause, line.turn_by_ns, line.reason) == (Cause.DUE, NOW, "limit exceeded")
    assert plan(wheelset(1, -50.0))[0].turn_by_ns == NOW


def test_too_small_a_wheel_is_replaced() -> None:
    (line,) = plan(wheelset(1, 5.0, 0.4225))
    assert (line.cause, line.radius_after) == (Cause.REPLACE, None)
    assert line.reason == "due in 5.0 days; cannot be turned: 419.5 mm of radius would be left, 420.0 mm needed"


def test_left_and_right_are_made_alike_beside_one_that_is_due() -> None:
    uneven = replace(wheelset(2), radii=Radii(0.460, 0.4595))  # 1 mm of diameter
    lines = plan(wheelset(1, 20.0), uneven, limits=replace(LIMITS, bogie_difference=None))
    assert summary(lines) == [(1, Cause.DUE, 1, 457.0), (2, Cause.TOGETHER, 1, 456.5)]
    assert lines[1].reason == "left and right differ by 1.0 mm > 0.5 mm"


def test_without_radii_or_limits_it_says_what_was_not_checked() -> None:
    (line,) = plan(wheelset(1, 5.0, None), wheelset(2, None, None))
    assert line.not_checked == ("no measured radius on file: diameters were not checked",)
    (line,) = plan(wheelset(1, 5.0), wheelset(2), limits=DiameterLimits())
    assert len(line.not_checked) == 5


def test_what_is_not_known_is_a_line_of_its_own_at_the_end() -> None:
    unknown = replace(wheelset(2, radius=None), unknown=Reason(ReasonCode.NO_RECENT_DATA, "no data since 2026-01-03"))
    lines = plan(unknown, wheelset(1, 5.0, None))
    assert [line.cause for line in lines] == [Cause.DUE, Cause.NOT_ASSESSED]
    assert (lines[1].turn_by_ns, lines[1].reason) == (None, "no data since 2026-01-03")


vehicles = st.lists(
    st.tuples(
        st.one_of(st.none(), st.floats(-20.0, 120.0)),
        st.one_of(st.none(), st.floats(0.421, 0.46)),
        st.floats(-1e-3, 1e-3),
    ),
    min_size=1,
    max_size=6,
)
bounds = st.one_of(st.none(), st.floats(0.0, 15e-3))


def drawn(rows: list[tuple[float | None, float | None, float]], vehicle: str = "V") -> list[Candidate]:
    found = []
    for axle, (due, radius, uneven) in enumerate(rows, start=1):
        one = wheelset(axle, due, radius, vehicle)
        found.append(one if radius is None else replace(one, radii=Radii(radius, radius + uneven)))
    return found


@settings(max_examples=60, derandomize=True)
@given(vehicles, vehicles, st.one_of(st.none(), st.floats(0.0, 6e-3)), bounds, bounds, bounds)
def test_nobody_due_is_left_out_limits_hold_and_vehicles_are_apart(
    rows: list[tuple[float | None, float | None, float]],
    others: list[tuple[float | None, float | None, float]],
    cut: float | None,
    axle: float | None,
    bogie: float | None,
    vehicle: float | None,
) -> None:
    limits = DiameterLimits(cut, 0.42, axle, bogie, vehicle)
    own, foreign = drawn(rows), drawn(others, "W")
    lines = turning_plan(own, limits, NOW, 90 * DAY, 30 * DAY)
    both = turning_plan([*foreign, *own], limits, NOW, 90 * DAY, 30 * DAY)
    assert [line for line in both if line.candidate.vehicle == "V"] == lines
    due = {one.serial for one in own if one.due_ns is not None and one.due_ns <= NOW + 90 * DAY}
    assert due <= {line.candidate.serial for line in lines}
    if not lines:
        return
    replaced = {line.candidate.serial for line in lines if line.cause is Cause.REPLACE}
    after = {one.serial: one.radii.wheels for one in own if one.radii is not None and one.serial not in replaced}
    for line in lines:
        if line.radius_after is not None and line.candidate.serial in after:
            after[line.candidate.serial] = (line.radius_after,)
            assert line.radius_after >= 0.42 - 1e-8
    bogies = {one.serial: one.bogie for one in own}
    for first, wheels in after.items():
        for second, opposite in after.items():
            difference = 2.0 * (max(wheels) - min(opposite))
            for limit, applies in ((axle, first == second), (bogie, bogies[first] == bogies[second]), (vehicle, True)):
                if limit is not None and applies and (first != second or limit is axle):
                    assert difference <= limit + 1e-7, f"{first} beside {second}"

"""What does not belong among the passes of a section is refused with its reason, and moves no other pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper_class import WINDOWS
from section_runs import made, mirror_mounted, turned_windows, valid_passes, windows
from smooth_wheelset import GOOD, alignment, track

from estimation.track.gridded_pass import grid_pass
from estimation.track.panel.basis import Panel, PanelParameters, init, update
from estimation.track.panel.solution import PanelSolution, result
from estimation.track.passes import Pass, PassStatus, ProfileLife, examine
from estimation.track.screening.agreement import ScreeningParameters, alignment_segment, filter_pass
from estimation.track.screening.agreement import agreement as agree
from estimation.track.screening.screen import screen
from estimation.values.track import TrackAlignment

PANEL = PanelParameters(length=3000.0, basis_count=21)
KNOWN = alignment(track(1))


def reasons(
    found: list[Pass], bad: set[int], known: TrackAlignment | None = None, wanted: PassStatus = PassStatus.REFUSED
) -> set[str]:
    """Return why the bad ones were refused; all others must be used."""
    screened = screen(found, known)
    assert [o.status for i, o in enumerate(screened.outcomes) if i not in bad] == [PassStatus.USED] * (
        len(found) - len(bad)
    )
    assert [o.status for i, o in enumerate(screened.outcomes) if i in bad] == [wanted] * len(bad)
    assert list(screened.used) == [item for i, item in enumerate(found) if i not in bad]
    return {str(screened.outcomes[i].reason) for i in bad}


@pytest.mark.parametrize("known", [None, KNOWN], ids=["unknown track", "known track"])
def test_valid_passes_are_all_used(known: TrackAlignment | None) -> None:
    for seed in (1, 2):
        found = list(valid_passes(seed))
        reasons(found, set(), alignment(track(seed)) if known is not None else None)


BAD: dict[str, tuple[Callable[[Pass], Pass], str]] = {
    "another section": (lambda p: replace(p, displacement=p.displacement[::-1], difference=p.difference[::-1]),
                        "not of this section"),
    "axes reversed": (lambda p: replace(p, displacement=-p.displacement, difference=-p.difference), "mirror image"),
    "another unit": (lambda p: replace(p, displacement=1e3 * p.displacement), "times that of"),
    "too short": (lambda p: replace(p, at=p.at[:30], displacement=p.displacement[:30], difference=p.difference[:30],
                                    stiffness_term=None), "too short"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
@pytest.mark.parametrize("known", [None, KNOWN], ids=["unknown track", "known track"])
def test_a_bad_journey_is_refused_with_its_reason(kind: str, known: TrackAlignment | None) -> None:
    spoil, wanted = BAD[kind]
    found = list(valid_passes())
    bad = {i for i, item in enumerate(found) if item.vehicle == "V2"}
    status = PassStatus.TOO_SHORT if kind == "too short" else PassStatus.REFUSED
    for reason in reasons([spoil(item) if i in bad else item for i, item in enumerate(found)], bad, known, status):
        assert wanted in reason


def test_a_position_that_jumps_between_windows_is_refused_where_it_leaves_its_journey() -> None:
    found = list(valid_passes())
    for metres in (12.0, -30.0):
        bad = {next(i for i, item in enumerate(found) if item.vehicle == "V3" and item.start_ns > 0)}
        moved = [replace(item, at=item.at + metres) if i in bad else item for i, item in enumerate(found)]
        extra = [replace(item, start_ns=item.start_ns + 120 * 10**9) for item in made(windows(3)[:1])]
        (reason,) = reasons([*moved, *extra], bad)
        assert "away from the rest of its journey" in reason


def solved(used: Sequence[Pass]) -> PanelSolution:
    panel = Panel.of(PANEL)
    return result(update(init(panel), [grid_pass(item, panel.grid) for item in used]), parameters=PanelParameters())


@settings(max_examples=6)
@given(kind=st.sampled_from(sorted(BAD)), number=st.integers(0, 5), place=st.integers(0, 12))
def test_a_bad_pass_leaves_the_solution_of_the_others_as_it_was(kind: str, number: int, place: int) -> None:
    found = list(valid_passes())
    bad = replace(BAD[kind][0](found[2 * number]), life=ProfileLife("BAD"), vehicle="BAD")
    before = solved(screen(found).used)
    screened = screen([*found[:place], bad, *found[place:]])
    after = solved(screened.used)
    assert after.lives == before.lives
    np.testing.assert_allclose(after.curves, before.curves, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(after.alignment, before.alignment, rtol=1e-12, atol=1e-18)


def test_two_that_contradict_each_other_are_both_refused_and_a_known_alignment_decides() -> None:
    spoil = BAD["another section"][0]
    first, second = valid_passes()[0], spoil(valid_passes()[2])
    assert [o.status for o in screen([first, second]).outcomes] == [PassStatus.REFUSED] * 2
    assert [o.status for o in screen([first, second], KNOWN).outcomes] == [PassStatus.USED, PassStatus.REFUSED]
    assert "1 of 2 journeys" in screen([first, second]).outcomes[0].reason.text


def test_one_alone_and_nothing_are_left_to_the_panel() -> None:
    assert screen([valid_passes()[0]]).used == (valid_passes()[0],)
    assert screen([]).used == ()


def test_an_alignment_that_most_contradict_does_not_decide() -> None:
    wrong = replace(KNOWN, alignment=KNOWN.alignment[::-1])
    screened = screen(list(valid_passes()), wrong)
    assert len(screened.used) == len(valid_passes())


def test_chance_agrees_as_often_as_it_says() -> None:
    """Passes of two places far apart: the probability of their agreement is uniform, as far as it can be counted."""
    signals = [
        one for seed in (1, 2) for item in valid_passes(seed) if (one := filter_pass(item, 30.0, 1.0)) is not None
    ]
    found = []
    for k, one in enumerate(signals):
        for other in signals[k + 1 :]:
            backwards = replace(other, first=one.first, signals=other.signals[:, ::-1])
            found.append(agree(one, backwards, 45.0, 100.0, ScreeningParameters()).log10_chance)
    assert len(found) > 200
    assert np.mean(np.array(found) < -1.0) < 0.2
    assert min(found) > -6.0


def test_an_agreement_finds_shift_and_factor() -> None:
    item = filter_pass(replace(valid_passes()[0], at=valid_passes()[0].at + 7.0), 30.0, 0.5)
    assert item is not None
    d = alignment_segment(KNOWN, item.first - 100, item.last + 100, 30.0, 0.5)
    assert d is not None
    found = agree(item, d, 45.0, 100.0, ScreeningParameters())
    assert found.shift == pytest.approx(-7.0, abs=0.51)
    assert found.factor == pytest.approx(1.0, abs=0.05)
    assert found.correlation > 0.9


def test_the_other_direction_gives_the_same_alignment_and_the_same_wheelset() -> None:
    both = [*valid_passes(), *made(turned_windows(0)), *made(turned_windows(2))]
    assert {item.side for item in both} == {1, -1}
    assert all(np.all(np.diff(item.at) > 0) for item in both)
    screened = screen(both, KNOWN)
    assert len(screened.used) == len(both)
    apart = [replace(item, life=ProfileLife(item.wheelset + " turned")) if item.side < 0 else item for item in both]
    panel = Panel.of(replace(PANEL, length=13_000.0, reach=1.0e-3))
    both_ways = result(
        update(init(panel), [grid_pass(item, panel.grid) for item in apart]), parameters=PanelParameters()
    )
    for name in ("W0", "W2"):
        here, there = (both_ways.lives.index(ProfileLife(serial)) for serial in (name, f"{name} turned"))
        k = len(both_ways.knots)
        seen = (both_ways.weight[here, :k] > 50) & (both_ways.weight[there, :k] > 50)
        assert seen.sum() >= 3
        first, second = (both_ways.curves[0, number, :k][seen] for number in (here, there))
        assert np.abs(first - second).max() < 0.1 * np.ptp(first)


def test_a_wheelset_mounted_reversed_has_its_own_left_wheel_left() -> None:
    forward, reversed_ = made(windows(1))[0], made(windows(1), mounted_reversed=True)[0]
    assert (forward.side, reversed_.side) == (1, -1)
    np.testing.assert_array_equal(reversed_.difference, -forward.difference)
    np.testing.assert_array_equal(reversed_.displacement, forward.displacement)


WINDOW = windows(1)[0]


def refusal(window: object) -> str:
    found, reason = examine(window, WINDOWS)  # type: ignore[arg-type] - every caller hands a window
    assert found == ()
    return str(reason)


def test_windows_without_a_pass_say_why() -> None:
    n = len(WINDOW.valid)
    assert "stands or runs too slowly: at most 0.0 m/s" in refusal(
        replace(WINDOW, speed=np.zeros(n), distance=np.full(n, WINDOW.distance[0]))
    )
    assert "stands or runs too slowly: at most 2.0 m/s" in refusal(replace(WINDOW, speed=np.full(n, 2.0)))
    assert "no sample has a position" in refusal(replace(WINDOW, distance=np.full(n, np.nan)))
    assert "13.0% of the samples are clipped" in refusal(replace(WINDOW, quality=replace(GOOD, clipped=0.13)))
    assert "the sensor reports a fault" in refusal(replace(WINDOW, quality=replace(GOOD, sensor_fault=True)))
    assert "the position is not known well enough" in refusal(
        replace(WINDOW, quality=replace(GOOD, position_quality=0.0))
    )
    assert "no uninterrupted run of 10 s" in refusal(replace(WINDOW, valid=np.arange(n) % 2000 < 1500))
    assert "axes point against the direction" in refusal(mirror_mounted([WINDOW])[0])
    stuck = np.where(np.arange(n) > 800, WINDOW.distance[800], WINDOW.distance)
    assert "the position jumps" in refusal(replace(WINDOW, distance=stuck))


def test_valid_windows_are_examined_without_a_reason() -> None:
    for number in range(6):
        for window in (*windows(number), *turned_windows(0)):
            found, reason = examine(window, WINDOWS)
            assert len(found) == 1
            assert reason is None


@settings(max_examples=25)
@given(at=st.integers(3500, 11_500), metres=st.floats(2.0, 60.0), back=st.booleans())
def test_a_position_that_jumps_inside_a_window_ends_the_pass_there(at: int, metres: float, back: bool) -> None:  # noqa: FBT001 - drawn
    jump = -metres if back else metres
    jumped = replace(WINDOW, distance=WINDOW.distance + jump * (np.arange(len(WINDOW.valid)) >= at))
    found, reason = examine(jumped, WINDOWS)
    assert f"jumps once against the speed, by {metres:.1f} m" in str(reason)
    first, second = found
    before, after = WINDOW.distance[at - 1], WINDOW.distance[at] + jump
    assert first.at[-1] <= before
    assert before - first.at[-1] < 30.0
    assert second.at[0] >= after
    assert second.at[0] - after < 30.0

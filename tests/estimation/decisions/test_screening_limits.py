"""Which passes are compared, who is in the minority, whose position jumped: at the limits of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from test_agreement_limits import pair, smooth

from estimation.track.passes import Pass, PassStatus, ProfileLife
from estimation.track.screening.agreement import FilteredPass, ScreeningParameters, agreement
from estimation.track.screening.screen import Comparison, Link, _peers, compare_pairs, minority, misplaced, screen
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment

P = ScreeningParameters()
WHY = Reason(ReasonCode.OTHER_SECTION, "no")


def span(first: int, last: int) -> FilteredPass:
    return FilteredPass(first, np.zeros((2, last - first + 1)), 1.0)


def peers(i: int, spans: Sequence[tuple[int, int]], journey_of: Sequence[int], wanted: int = 6) -> list[int]:
    return _peers(
        i, {k: span(*ends) for k, ends in enumerate(spans)}, np.array(journey_of), wanted, ScreeningParameters()
    )


def test_peers_are_of_other_journeys_and_overlap_most() -> None:
    spans = [(0, 1000), (0, 1000), (0, 400), (0, 700), (0, 19), (2000, 3000)]
    assert peers(0, spans, [0, 0, 1, 2, 3, 4]) == [3, 2]
    assert peers(0, spans, [0, 0, 1, 2, 3, 4], wanted=1) == [3]
    assert peers(0, spans, [0, 1, 2, 3, 4, 5]) == [1, 3, 2]
    assert peers(0, spans, [0, 1, 1, 1, 4, 5]) == [1]


def test_an_overlap_counts_in_steps_of_twenty() -> None:
    assert peers(0, [(0, 1000), (0, 20)], [0, 1]) == [1]
    assert peers(0, [(0, 1000), (0, 19)], [0, 1]) == []
    # overlaps of 400 to 419 are one; then the next after the pass itself is taken first
    assert peers(1, [(0, 419), (0, 1000), (0, 401)], [0, 1, 2], wanted=1) == [2]
    assert peers(1, [(0, 421), (0, 1000), (0, 401)], [0, 1, 2], wanted=1) == [0]


def test_two_that_lead_on_are_compared_besides() -> None:
    spans = [(0, 1000), (0, 1000), (700, 1700), (790, 1790), (810, 1810), (600, 1600), (805, 900)]
    assert peers(0, spans, [0, 1, 2, 3, 4, 5, 6], wanted=1) == [1, 3, 2]
    assert peers(0, spans, [0, 1, 2, 0, 4, 5, 6], wanted=1) == [1, 2, 5]
    assert peers(1, spans, [0, 1, 2, 3, 4, 5, 6], wanted=1) == [0, 3, 2]
    assert peers(3, spans[:4], [0, 1, 2, 3], wanted=1) == [2]


def test_of_passes_that_overlap_alike_the_next_ones_are_taken() -> None:
    alike = [(0, 1000)] * 5
    assert [peers(i, alike, range(5), wanted=1) for i in range(5)] == [[1], [2], [3], [4], [0]]


def test_six_peers_are_enough() -> None:
    assert len(peers(0, [(0, 1000)] * 9, range(9), wanted=P.peers)) == 6


@pytest.mark.parametrize(("n", "samples"), [(260, 50), (700, 100)])
def test_a_low_correlation_of_few_samples_contradicts_nothing(n: int, samples: int) -> None:
    first, second = pair(n, 0, 50.0)
    found = compare_pairs({0: first, 1: second}, np.array([0, 1]), P)
    said = agreement(first, second, P.positions.largest_offset, P.cutoff_wavelength, ScreeningParameters())
    assert said.log10_chance > -6.0
    assert 0.5 * samples < said.samples < samples
    assert bool(found) is (samples > 50)
    assert all(one.reason is not None for one in found)


def test_a_high_correlation_of_few_samples_agrees() -> None:
    first, second = pair(260, 4, 0.01)
    (found,) = compare_pairs({0: first, 1: second}, np.array([0, 1]), P)
    assert found.reason is None
    assert (found.first, found.second, found.shift) == (0, 1, 2.0)
    assert compare_pairs({0: first, 1: second}, np.array([0, 0]), P) == []


@pytest.mark.parametrize(("factor", "agrees"), [(2.3, True), (2.7, False), (0.43, True), (0.37, False)])
def test_passes_of_one_place_have_one_scale(factor: float, *, agrees: bool) -> None:
    first, second = pair(600, 0, 0.01)
    scaled = replace(second, signals=1.5 / factor * second.signals)  # y of the first is one and a half times d
    (found,) = compare_pairs({0: first, 1: scaled}, np.array([0, 1]), P)
    assert (found.reason is None) is agrees


def same(first: int, second: int) -> Comparison:
    return Comparison(first, second, 0.0, None)


def apart(first: int, second: int) -> Comparison:
    return Comparison(first, second, 0.0, WHY)


def test_the_minority_is_refused_and_as_many_against_as_many_both() -> None:
    journey = np.arange(5)
    assert set(minority([same(0, 1), apart(1, 2)], journey)) == {2}
    assert set(minority([same(0, 1), same(2, 3), apart(1, 2)], journey)) == {1, 2}
    assert set(minority([same(0, 1), same(1, 2), same(3, 4), apart(1, 3), apart(0, 4)], journey)) == {3, 4}
    assert minority([same(0, 1), apart(0, 1)], journey) == {}
    text = minority([same(0, 1), apart(1, 2)], journey)[2].text
    assert text == "no; 1 of 3 journeys of the place agree with it"


def test_journeys_count_and_not_passes() -> None:
    assert set(minority([same(0, 1), apart(1, 2)], np.array([0, 0, 1]))) == {1, 2}


def test_what_a_known_alignment_confirms_is_right_against_any_majority() -> None:
    journey = np.arange(5)
    crowd = [same(0, 1), same(1, 2), apart(2, 3)]
    assert set(minority(crowd, journey, frozenset({3}))) == {2}
    assert set(minority(crowd, journey, frozenset({0}))) == {3}
    assert set(minority(crowd, journey, frozenset({2, 3}))) == set()
    assert set(minority([*crowd, same(3, 4), apart(0, 4)], journey, frozenset({4}))) == {0, 2}


def jumps(shifts: Sequence[float], middle: FloatArray, tolerance: float = P.misplaced) -> dict[int, float]:
    """Return which passes of one journey, linked to a pass each of a well-placed journey, are misplaced."""
    n = len(shifts)
    links = [Link(k, n + j, shift) for k, shift in enumerate(shifts) for j in range(n)]
    journey_of = np.array([0] * n + [1] * n)
    return dict(misplaced(links, journey_of, np.concatenate([middle, middle]), tolerance))


def test_a_position_may_jump_by_four_metres() -> None:
    middle = np.zeros(5)
    for metres, found in ((3.95, set()), (4.05, {2}), (-3.95, set()), (-4.05, {2})):
        shifts = [0.0, 0.0, metres, 0.0, 0.0]
        assert set(jumps(shifts, middle)) == found
    assert jumps([0.0, 0.0, 30.0, 0.0, 0.0], middle)[2] == pytest.approx(30.0, abs=1e-2)
    assert jumps([0.0, 0.0, -30.0, 0.0, 0.0], middle)[2] == pytest.approx(-30.0, abs=1e-2)
    assert jumps([], middle[:0]) == {}


def test_an_odometer_may_have_a_scale_of_its_own() -> None:
    middle = np.array([0.0, 1000.0, 2000.0, 3000.0, 4000.0])
    for scale, found in ((1.15e-3, set()), (1.25e-3, {3, 4})):
        shifts = [0.0, 0.0, 0.0, 4.0 + scale * 1000.0, 4.0 + scale * 1000.0]
        assert set(jumps(shifts, middle)) == found


def test_shifts_that_fit_within_thirty_centimetres_are_averaged() -> None:
    # pass 0 has shifts of 0, 0 and 0.5 m; least absolute values beyond 0.3 m, least squares within: 2 m = 0.3
    links = [Link(0, 2, 0.0), Link(0, 2, 0.0), Link(0, 2, 0.5), Link(1, 2, 30.0)]
    found = misplaced(links, np.array([0, 0, 1]), np.zeros(3), 4.0)
    assert found == {1: pytest.approx(30.0 - 0.15, abs=5e-3)}


def test_the_larger_part_of_a_journey_is_used() -> None:
    assert set(jumps([0.0, 0.0, 9.0, 9.0, 9.0], np.arange(5.0))) == {0, 1}


def test_groups_that_nothing_joins_are_not_compared() -> None:
    links = [Link(0, 2, 0.0), Link(1, 3, 50.0)]
    assert misplaced(links, np.array([0, 0, 1, 2]), np.zeros(4), 4.0) == {}
    joined = [*links, Link(2, 3, 0.0)]
    assert set(misplaced(joined, np.array([0, 0, 1, 2]), np.zeros(4), 4.0)) & {0, 1}


D = smooth(20, 2000, width=4)
PAUSE = 300 * 10**9


def a_pass(
    number: int, vehicle: str, *, start_ns: int = 0, first: int = 200, n: int = 1100, sign: float = 1.0,
    place: FloatArray = D, offset: float = 0.0,
) -> Pass:  # fmt: skip
    at = np.arange(first, first + n, dtype=np.float64)
    R = 0.7 * smooth(100 + number, n, width=4)
    y = sign * (place[first : first + n] + 0.2 * R + 0.1 * smooth(200 + number, n, width=4))
    return Pass(ProfileLife(f"W{number}"), vehicle, start_ns, at + offset, 1e-3 * y, sign * 1e-3 * R)


def known_track(place: FloatArray = D) -> TrackAlignment:
    n = len(place)
    zero = np.zeros(n)
    return TrackAlignment(
        "S", 1, np.arange(float(n)), 1e-3 * place, zero + 1e-4, zero, zero, np.ones(n, dtype=np.int64), Status.ESTIMATED
    )


def statuses(passes: Sequence[Pass], known: TrackAlignment | None = None) -> list[PassStatus]:
    return [one.status for one in screen(passes, known).outcomes]


USED, REFUSED, TOO_SHORT = PassStatus.USED, PassStatus.REFUSED, PassStatus.TOO_SHORT
ELSEWHERE = smooth(21, 2000, width=4)


def test_passes_of_one_place_are_used_and_one_of_another_is_not() -> None:
    good = [a_pass(k, f"V{k}") for k in range(3)]
    assert statuses(good) == [USED] * 3
    assert statuses([*good, a_pass(3, "V3", place=ELSEWHERE)]) == [USED] * 3 + [REFUSED]
    screened = screen([*good, a_pass(3, "V3", sign=-1.0)])
    assert screened.outcomes[3].reason is not None
    assert screened.outcomes[3].reason.code is ReasonCode.MIRRORED
    assert screened.used == tuple(good)
    short = screen([*good, a_pass(3, "V3", n=120)]).outcomes[3]
    assert short.status is TOO_SHORT
    assert short.reason is not None
    assert short.reason.text == "119 m long, too short for wavelengths up to 30 m"


def test_a_known_alignment_decides_unless_most_contradict_it() -> None:
    first, second = a_pass(0, "V0"), a_pass(1, "V1", place=ELSEWHERE)
    assert statuses([first, second]) == [REFUSED, REFUSED]
    both = [first, a_pass(3, "V3"), a_pass(4, "V4"), second, a_pass(2, "V2", place=ELSEWHERE)]
    assert statuses([first, *both[3:]], known_track()) == [REFUSED, USED, USED]
    assert statuses(both, known_track()) == [USED, USED, USED, REFUSED, REFUSED]
    lone = [first, both[1], second, both[4]]
    assert statuses(lone, replace(known_track(), status=Status.INVALID)) == [REFUSED] * 4
    crowd = [first, second, a_pass(2, "V2", place=ELSEWHERE)]
    wrong = screen(crowd, known_track())
    assert [one.status for one in wrong.outcomes] == [REFUSED, USED, USED]


def test_a_known_alignment_that_most_contradict_confirms_none() -> None:
    other = a_pass(1, "V1", place=ELSEWHERE)
    tall = [
        replace(other, vehicle=f"V{k}", displacement=size * other.displacement) for k, size in ((1, 9.0), (2, -9.0))
    ]
    found = screen([a_pass(0, "V0"), *tall], known_track())
    assert [one.status for one in found.outcomes] == [REFUSED] * 3


def test_passes_of_another_place_are_refused_for_that_and_not_for_their_positions() -> None:
    good = [a_pass(k, f"V{k}") for k in range(4)]
    lost = [
        a_pass(4, "V4", place=ELSEWHERE),
        a_pass(5, "V4", start_ns=10**9, place=ELSEWHERE, offset=20.0),
        a_pass(6, "V4", start_ns=2 * 10**9, place=ELSEWHERE),
        a_pass(7, "V5", place=ELSEWHERE),
    ]
    found = screen([*good, *lost]).outcomes
    assert [one.status for one in found] == [USED] * 4 + [REFUSED] * 4
    assert {one.reason.code for one in found if one.reason is not None} == {ReasonCode.OTHER_SECTION}


def test_few_samples_of_a_known_alignment_say_nothing() -> None:
    for n, status in ((480, USED), (500, REFUSED)):
        lone = a_pass(1, "V1", place=ELSEWHERE, n=n)
        good = [a_pass(5, "V5", first=900, n=1000), a_pass(6, "V6", first=900, n=1000)]
        for step in (1.0, 0.5):
            found = screen([lone, *good], known_track(), replace(P, step=step))
            assert [one.status for one in found.outcomes] == [status, USED, USED]


def test_the_usual_factor_is_that_of_the_passes() -> None:
    tall = replace(known_track(), alignment=3e-3 * D)
    assert statuses([a_pass(k, f"V{k}") for k in range(3)], tall) == [USED] * 3
    odd = a_pass(3, "V3")
    odd = replace(odd, displacement=3.0 * odd.displacement)
    found = screen([a_pass(0, "V0"), a_pass(1, "V1"), odd], known_track()).outcomes
    assert [one.status for one in found] == [USED, USED, REFUSED]
    assert found[2].reason is not None
    assert found[2].reason.code is ReasonCode.SCALE_DIFFERS


@pytest.mark.parametrize("scale", [0.55, 1.0, 1.8])
def test_where_as_many_are_mirrored_as_not_the_known_alignment_has_the_unit_of_the_passes(scale: float) -> None:
    right = a_pass(0, "V0")
    mirrored = replace(right, vehicle="V1", displacement=-right.displacement)
    found = screen([right, mirrored], replace(known_track(), alignment=1e-3 * D / scale))
    assert [one.status for one in found.outcomes] == [USED, REFUSED]
    assert found.outcomes[1].reason is not None
    assert found.outcomes[1].reason.code is ReasonCode.MIRRORED


@pytest.mark.parametrize(
    ("near", "far", "metres", "status"),
    [
        ((200, 700), (1200, 700), 5.0, USED),  # 4 m and 1.2 m for the kilometre between their middles
        ((200, 700), (1200, 700), 6.0, REFUSED),
        ((200, 300), (900, 1000), 5.0, USED),  # 1.05 km
        ((200, 1000), (1200, 300), 5.0, REFUSED),  # 0.65 km
    ],
)
def test_passes_of_a_journey_a_kilometre_apart_may_differ_by_the_scale_of_the_odometer(
    near: tuple[int, int], far: tuple[int, int], metres: float, status: PassStatus
) -> None:
    early = a_pass(0, "V0", first=near[0], n=near[1])
    late = a_pass(1, "V0", start_ns=10**9, first=far[0], n=far[1], offset=metres)
    others = [a_pass(2 + k, f"V{1 + k}", n=1700) for k in range(3)]
    found = screen([early, late, *others]).outcomes
    assert {one.status for one in found[2:]} == {USED}
    assert (found[0].status is REFUSED or found[1].status is REFUSED) is (status is REFUSED)


def test_a_pass_that_jumped_is_refused_by_its_journey() -> None:
    journey = [a_pass(k, "V0", start_ns=k * 10**9) for k in range(3)]
    others = [a_pass(3 + k, f"V{1 + k}") for k in range(3)]
    for metres, status in ((3.0, USED), (6.0, REFUSED)):
        moved = replace(journey[2], at=journey[2].at + metres)
        found = screen([*journey[:2], moved, *others]).outcomes
        assert [one.status for one in found] == [USED, USED, status, USED, USED, USED]
        if status is REFUSED:
            assert found[2].reason is not None
            assert found[2].reason.code is ReasonCode.APART_FROM_JOURNEY
    later = replace(journey[2], at=journey[2].at + 6.0, start_ns=PAUSE + 2 * 10**9)
    assert statuses([*journey[:2], later, *others]) == [USED] * 6

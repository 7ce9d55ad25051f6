"""The library of signatures: what it concludes, what it refuses, and that its intervals cover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from signature_draws import PARAMETERS, Draw, signature

from estimation.signatures import calibration
from estimation.signatures.answer import compared, judged, most_likely, states
from estimation.signatures.library import Libraries, Library, Subject, current, library
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import AxlePosition, Basis, ConicitySource, LibraryEntry, Place, SignatureAnswer

CONICITIES = np.linspace(0.16, 0.36, 21)


def known(entries: list[LibraryEntry]) -> Library:
    found = library(entries, PARAMETERS)
    assert isinstance(found, Library)
    return found


def ask(entries: list[LibraryEntry], of: Library) -> SignatureAnswer:
    return judged(entries[0].wheelset, [one.signature for one in entries], of, PARAMETERS)


def test_intervals_cover_and_are_not_much_wider_than_they_must_be(draw: Draw) -> None:
    held: dict[Basis, list[bool]] = {basis: [] for basis in Basis}
    errors, stds = [], []
    for seed in range(12):
        of = known(draw(seed, CONICITIES, 4))
        rng = np.random.default_rng([seed, 1])
        for basis, first in ((Basis.SAME_PLACES, 1), (Basis.OTHER_PLACES, 20 + seed)):
            for number, truth in enumerate(rng.uniform(0.17, 0.35, 8)):
                drawn = draw([seed, number, 7], np.array([truth]), 1, first_section=first, name="X")
                answer = ask(drawn, of)
                if answer.conicity.value is None:
                    continue
                assert answer.basis is basis
                assert answer.conicity.low is not None
                assert answer.conicity.high is not None
                held[basis].append(answer.conicity.low <= truth <= answer.conicity.high)
                errors.append(answer.conicity.value - truth)
                stds.append(answer.conicity.std)
    for basis, values in held.items():
        assert len(values) >= 70, basis
        assert np.mean(values) >= 0.88, basis
    assert np.mean([*held[Basis.SAME_PLACES], *held[Basis.OTHER_PLACES]]) < 0.995
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) / np.sqrt(np.mean(np.square(stds))) < 1.5


def test_where_the_track_is_known_the_answer_is_nearer(draw: Draw) -> None:
    of = known(draw(0, CONICITIES, 4))
    spread = []
    for first in (0, 30):
        drawn = [draw([first, n], np.array([0.25]), 1, first_section=first, name="X") for n in range(12)]
        answers = [ask(one, of).conicity for one in drawn]
        spread.append(np.median([one.std for one in answers if one.std is not None]))
    assert spread[0] < spread[1]


def test_any_order_of_entries_gives_the_same_answer(draw: Draw) -> None:
    entries = draw(0, CONICITIES, 3)
    asked = draw(1, np.array([0.23]), 1, name="X")
    shuffled = [entries[at] for at in np.random.default_rng(0).permutation(len(entries))]
    assert ask(asked, known(entries)) == ask(asked, known(shuffled))
    backwards = list(reversed(asked))
    first, second = ask(asked, known(entries)).conicity, ask(backwards, known(entries)).conicity
    assert first.value == pytest.approx(second.value, abs=1e-9)


def test_entries_of_another_class_or_axle_position_are_left_out_and_nothing_is_said_of_its_wheelsets(
    draw: Draw,
) -> None:
    entries = draw(0, CONICITIES, 2)
    other = [replace(one, signature=replace(one.signature, vehicle_class="D")) for one in entries[:8]]
    trailing = [replace(one, signature=replace(one.signature, position=AxlePosition.TRAILING)) for one in entries[8:16]]
    found = Libraries([*other, *trailing, *entries[16:]], PARAMETERS).admitted(Subject("X", "C", AxlePosition.SINGLE))
    assert found.left_out == {ReasonCode.OTHER_VEHICLE_CLASS: 16}
    assert len(found.entries) == len(entries) - 16
    asked = [replace(one, signature=replace(one.signature, vehicle_class="D")) for one in draw(1, CONICITIES[:1], 1)]
    answer = ask(asked, known(entries))
    assert answer.conicity.reason is not None
    assert answer.conicity.reason.code is ReasonCode.OTHER_VEHICLE_CLASS


@pytest.mark.parametrize(
    ("wheelsets", "code"), [(7, ReasonCode.LIBRARY_TOO_SMALL), (8, None)], ids=["too few", "just enough"]
)
def test_a_library_needs_eight_wheelsets(draw: Draw, wheelsets: int, code: ReasonCode | None) -> None:
    found = library(draw(0, np.linspace(0.16, 0.36, wheelsets), 3), PARAMETERS)
    assert (found.code if isinstance(found, Reason) else None) is code


@pytest.mark.parametrize(
    ("half", "alike"), [(0.014, True), (0.016, False)], ids=["std just below 0.015", "std just above"]
)
def test_a_library_needs_wheelsets_that_differ(draw: Draw, half: float, alike: bool) -> None:  # noqa: FBT001 - a case of the test
    found = library(draw(0, np.array([0.25 - half, 0.25 + half] * 8), 3, std=1e-9), PARAMETERS)
    assert isinstance(found, Reason) is alike
    if isinstance(found, Reason):
        assert found.code is ReasonCode.LIBRARY_ALIKE


@pytest.mark.parametrize(("sections", "answered"), [(2, False), (3, True)])
def test_other_sections_need_a_library_of_three(draw: Draw, sections: int, answered: bool) -> None:  # noqa: FBT001 - a case of the test
    answer = ask(draw(1, np.array([0.25]), 1, first_section=3, name="X"), known(draw(0, CONICITIES, sections)))
    assert (answer.conicity.status is Status.ESTIMATED) is answered
    if not answered:
        assert answer.conicity.reason is not None
        assert answer.conicity.reason.code is ReasonCode.NOT_IN_LIBRARY
        assert answer.states == ()
        assert answer.used == ()


@pytest.mark.parametrize(("beyond", "answered"), [(0.9, True), (1.1, False)])
def test_speeds_beyond_those_of_the_library_are_refused(draw: Draw, beyond: float, answered: bool) -> None:  # noqa: FBT001 - a case of the test
    of = known(draw(0, CONICITIES, 3))
    asked = draw(1, np.array([0.25]), 1, name="X")
    faster = [replace(one, signature=replace(one.signature, speed=of.speed[1] + beyond)) for one in asked]
    reason = ask(faster, of).conicity.reason
    assert (reason is None or "m/s" not in reason.text) is answered


@pytest.mark.parametrize(("rougher", "answered"), [(0.0, True), (1.5, False), (-1.5, False)])
def test_tracks_much_rougher_or_smoother_than_those_of_the_library_are_refused(
    draw: Draw,
    rougher: float,
    answered: bool,  # noqa: FBT001 - a case of the test
) -> None:
    """A conicity depends on the amplitude: what the library knows of it ends with its tracks."""
    of = known(draw(0, CONICITIES, 6))
    asked = draw(1, np.array([0.25]), 1, first_section=7, name="X", rougher=rougher)
    reason = ask(asked, of).conicity.reason
    assert (reason is None) is answered
    if reason is not None:
        assert reason.code is ReasonCode.NOT_IN_LIBRARY
        assert ("rougher" in reason.text) is (rougher > 0)


def test_tracks_may_be_as_far_outside_as_the_outermost_section_is_from_the_next(draw: Draw) -> None:
    of = known(draw(0, CONICITIES, 6))
    section = np.array([of.sections[place.section] for place in sorted(of.places, key=of.places.__getitem__)])
    mean = np.sort([of.model.levels[section == number].mean() for number in range(6)])
    within = np.std(of.model.levels - np.array([of.model.levels[section == number].mean() for number in section]))
    gap = max(mean[1] - mean[0], mean[-1] - mean[-2], 0.2)
    for places in (1, 4):
        reach = gap + 2.0 * within / np.sqrt(places)
        np.testing.assert_allclose(of.levels(places), (mean[0] - reach, mean[-1] + reach))


def test_a_conicity_beyond_the_library_is_refused(draw: Draw) -> None:
    of = known(draw(0, np.linspace(0.16, 0.26, 16), 3, std=1e-6))
    within = ask(draw(1, np.array([0.25]), 1, name="X"), of).conicity
    beyond = ask(draw(1, np.array([0.33]), 1, name="X"), of).conicity
    assert within.status is Status.ESTIMATED
    assert beyond.status is Status.UNESTIMATED
    assert beyond.reason is not None
    assert beyond.reason.code is ReasonCode.NOT_IN_LIBRARY


def test_signatures_unlike_everything_in_the_library_are_refused(draw: Draw) -> None:
    of = known(draw(0, CONICITIES, 3))
    asked = draw(1, np.array([0.25]), 1, name="X")
    sawtooth = np.where(np.arange(3 * PARAMETERS.bands) % 2, 0.6, -0.6)
    unlike = [
        replace(one, signature=signature("X0", one.signature.place, one.signature.powers + sawtooth)) for one in asked
    ]
    answer = ask(unlike, of)
    assert answer.conicity.value is None
    assert answer.conicity.reason is not None
    assert answer.conicity.reason.code is ReasonCode.NOT_IN_LIBRARY
    assert answer.novelty is not None
    assert answer.novelty > 1.0


@pytest.mark.parametrize(("first", "novel"), [(4, True), (8, False)], ids=["shorter half", "longer half"])
def test_roll_at_short_wavelengths_is_a_witness_of_its_own(
    draw: Draw,
    first: int,
    novel: bool,  # noqa: FBT001 - a case of the test
) -> None:
    """Where nothing else would be seen, wheels that roll otherwise are."""
    of = known(draw(0, CONICITIES, 3))
    calibrated = of.calibration[Basis.SAME_PLACES]
    assert not isinstance(calibrated, Reason)
    blind = replace(calibrated, whole=replace(calibrated.whole, mean=9.0))
    otherwise = np.zeros(3 * PARAMETERS.bands)
    otherwise[len(otherwise) - first : len(otherwise) - first + PARAMETERS.bands // 2] = 0.16
    asked = [
        replace(one, signature=signature("X0", one.signature.place, one.signature.powers + otherwise))
        for one in draw(1, np.array([0.25]), 1, name="X")
    ]
    answer = ask(asked, replace(of, calibration={Basis.SAME_PLACES: blind}))
    assert (answer.conicity.value is None) is novel
    assert answer.novelty is not None
    assert (answer.novelty > 1.0) is novel


def test_an_answer_names_the_entries_nearest_to_it(draw: Draw) -> None:
    answer = ask(draw(1, np.array([0.25]), 1, name="X"), known(draw(0, CONICITIES, 3)))
    assert answer.used
    assert all(one.section == "S0" for one in answer.used), "of the places that it passed"
    assert [one.weight for one in answer.used] == sorted((one.weight for one in answer.used), reverse=True)
    assert sum(one.weight for one in answer.used) <= 1.0 + 1e-9
    assert abs(answer.used[0].conicity - 0.25) < 0.03
    assert (answer.library_wheelsets, answer.library_sections) == (21, 3)


def test_errors_of_the_conicities_on_file_do_not_flatten_the_regression(draw: Draw) -> None:
    wide = np.tile(np.linspace(0.16, 0.36, 30), 2)
    answers = []
    for std in (1e-6, 0.015):
        of = known(draw(3, wide, 2, std=std))
        asked = [draw([4, n], np.array([truth]), 1, name="X") for n, truth in enumerate((0.19, 0.33))]
        values = [ask(one, of).conicity.value for one in asked]
        assert None not in values
        answers.append(float(np.diff(np.array(values, dtype=float))[0]))
    assert answers[1] == pytest.approx(answers[0], rel=0.12)


def test_states_are_shares_of_one_distribution() -> None:
    found = states(0.21, 0.02, PARAMETERS.states)
    assert len(found) == 7
    assert sum(one.probability for one in found) == pytest.approx(1.0)
    assert (most_likely(found).low, most_likely(found).high) == (0.20, 0.25)


def test_the_section_that_was_tamped_is_found_and_its_old_entries_retired(draw: Draw) -> None:
    changed = {Place("S1", cell): np.full(3 * PARAMETERS.bands, -0.8) for cell in (2, 3)}
    before = draw(0, CONICITIES, 3)
    after = draw(1, CONICITIES, 3, start_ns=10**6, shift=changed)
    found = current([*before, *after], SignatureParameters())
    assert {one.place for one in found.changes} == set(changed)
    assert {one.entry.signature.place for one in found.retired} == set(changed)
    assert all(one.entry.signature.start_ns < 10**6 for one in found.retired)
    assert all(one.reason.code is ReasonCode.SECTION_CHANGED for one in found.retired)
    assert len(found.entries) + len(found.retired) == len(before) + len(after)


def test_a_change_is_found_where_it_is_of_half_of_a_small_library(draw: Draw) -> None:
    """It does not hide in the scatter that it makes itself."""
    changed = {Place("S0", cell): np.linspace(-0.8, 0.8, 3 * PARAMETERS.bands) for cell in (2, 3)}
    few = CONICITIES[::2]
    found = current([*draw(0, few, 1), *draw(1, few, 1, start_ns=10**6, shift=changed)], SignatureParameters())
    assert {one.place for one in found.changes} == set(changed)


def test_track_that_was_left_alone_retires_nothing(draw: Draw) -> None:
    retired = 0
    for seed in range(6):
        found = current(
            [*draw(seed, CONICITIES, 3), *draw(50 + seed, CONICITIES, 3, start_ns=10**6)], SignatureParameters()
        )
        retired += len(found.retired)
    assert retired == 0


def test_what_decides_retirement_and_novelty_is_where_it_was_measured_to_be() -> None:
    assert (
        SignatureParameters().largest_distance,
        SignatureParameters().least_passes,
        SignatureParameters().library_rounds,
    ) == (5.5, 3, 2)
    assert (SIGNATURE.novel_quantile, calibration.COVERAGE) == (0.99, 0.95)


def estimate(value: float, half: float) -> Estimate:
    return Estimate(value, half / 1.96, value - half, value + half, 1.0, Status.ESTIMATED)


@pytest.mark.parametrize(("apart", "disagrees"), [(0.0399, False), (0.0401, True)])
def test_methods_disagree_where_their_intervals_are_apart(apart: float, disagrees: bool) -> None:  # noqa: FBT001 - a case of the test
    found = compared(estimate(0.2 + apart, 0.02), estimate(0.2, 0.02))
    assert found is not None
    assert found.disagrees is disagrees
    assert (found.reason is not None) is disagrees
    assert found.difference == pytest.approx(apart)


def test_nothing_is_compared_where_one_method_says_nothing() -> None:
    silent = Estimate.unknown(Reason(ReasonCode.NO_SIGNATURE, "none"))
    assert compared(silent, estimate(0.2, 0.02)) is None
    assert compared(estimate(0.2, 0.02), silent) is None


def test_measured_profiles_say_where_a_conicity_is_from(draw: Draw) -> None:
    entries = [replace(one, source=ConicitySource.MEASURED_PROFILES) for one in draw(0, CONICITIES, 3)]
    answer = ask(draw(1, np.array([0.25]), 1, name="X"), known(entries))
    assert {one.source for one in answer.used} == {ConicitySource.MEASURED_PROFILES}

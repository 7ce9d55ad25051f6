"""Which entries teach when a wheelset is judged: never its own, never what shares its samples, and libraries shared."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signature_draws import PARAMETERS, Draw

from estimation.signatures.answer import judged
from estimation.signatures.library import Libraries, Library, Subject
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters, families, folds, sharers
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import AxlePosition, DesignPair, LibraryEntry

CONICITIES = np.linspace(0.16, 0.36, 21)
SINGLE = AxlePosition.SINGLE


def subject(name: str, *partners: str) -> Subject:
    return Subject(name, "C", SINGLE, shares_data=frozenset(partners))


def names(entries: tuple[LibraryEntry, ...]) -> set[str]:
    return {one.wheelset for one in entries}


def test_a_wheelset_is_never_judged_by_itself_or_by_what_shares_its_samples(draw: Draw) -> None:
    entries = draw(0, CONICITIES, 2)
    partner = [replace(one, shares_data=("W3", "W4")) if one.wheelset == "W4" else one for one in entries]
    found = Libraries(partner, PARAMETERS).admitted(subject("W3"))
    assert {"W3", "W4"}.isdisjoint(names(found.entries))
    assert found.left_out[ReasonCode.SAME_WHEELSET] == 16
    assert len(found.entries) + sum(found.left_out.values()) == len(entries)
    by_subject = Libraries(entries, PARAMETERS).admitted(subject("W3", "W7"))
    assert {"W3", "W7"}.isdisjoint(names(by_subject.entries))
    assert by_subject.left_out[ReasonCode.SAME_WHEELSET] == 16


def test_nothing_of_a_wheelset_is_in_the_library_that_judges_it(draw: Draw) -> None:
    """Its answer is the same whatever its own entries say."""
    entries = draw(0, CONICITIES, 2)
    other = [replace(one, conicity=0.1, std=0.001) if one.wheelset == "W5" else one for one in entries]
    asked = [one.signature for one in entries if one.wheelset == "W5"]
    answers = []
    for known in (entries, other):
        found = Libraries(known, PARAMETERS).library(subject("W5"))
        assert isinstance(found, Library)
        assert "W5" not in names(found.entries)
        answers.append(judged("W5", asked, found, PARAMETERS).conicity)
    # other conicities on file may move W5 to another fold, with other company
    same = Libraries(entries, PARAMETERS).admitted(subject("W5")), Libraries(other, PARAMETERS).admitted(subject("W5"))
    if names(same[0].entries) == names(same[1].entries):
        assert answers[0] == answers[1]
    assert answers[0].value == pytest.approx(answers[1].value, abs=0.01)


def test_wheelsets_of_one_fold_share_a_library_and_small_libraries_leave_out_one_wheelset_only(draw: Draw) -> None:
    entries = draw(0, CONICITIES, 2)
    libraries = Libraries(entries, PARAMETERS)
    made = {id(libraries.library(subject(f"W{number}"))) for number in range(21)}
    assert len(made) == SIGNATURE.fold_count
    whole = libraries.library(subject("X"))
    assert isinstance(whole, Library)
    assert len(whole.entries) == len(entries), "who is not in it is judged by all"
    few = draw(0, CONICITIES[: SignatureParameters().most_own_folds], 2)
    for number in range(SignatureParameters().most_own_folds):
        found = Libraries(few, PARAMETERS).admitted(subject(f"W{number}"))
        assert found.left_out == {ReasonCode.SAME_WHEELSET: 8}
    one_more = Libraries(draw(0, CONICITIES[: SignatureParameters().most_own_folds + 1], 2), PARAMETERS).admitted(
        subject("W0")
    )
    assert one_more.left_out[ReasonCode.JUDGED_TOGETHER] > 0
    assert (SignatureParameters().most_own_folds, SIGNATURE.fold_count) == (12, 6)


def test_eight_others_are_enough_for_a_wheelset_of_a_small_library(draw: Draw) -> None:
    nine = Libraries(draw(0, np.linspace(0.16, 0.36, 9), 2), PARAMETERS)
    eight = Libraries(draw(0, np.linspace(0.16, 0.36, 8), 2), PARAMETERS)
    assert isinstance(nine.library(subject("W0")), Library)
    refused = eight.library(subject("W0"))
    assert isinstance(refused, Reason)
    assert refused.code is ReasonCode.LIBRARY_TOO_SMALL


def test_entries_of_other_profiles_are_left_out(draw: Draw) -> None:
    p8, other_rail = DesignPair("P8", "56E1 0.05"), DesignPair("P8", "60E1 0.05")
    entries = [replace(one, pair=p8) for one in draw(0, CONICITIES, 2)]
    entries[:4] = [replace(one, pair=DesignPair("S1002", "56E1 0.05")) for one in entries[:4]]
    entries[4:8] = [replace(one, pair=other_rail) for one in entries[4:8]]
    libraries = Libraries(entries, PARAMETERS)
    assert libraries.admitted(Subject("X", "C", SINGLE, p8)).left_out == {ReasonCode.OTHER_PROFILES: 8}
    anywhere = libraries.admitted(Subject("X", "C", SINGLE, DesignPair("P8", None)))
    assert anywhere.left_out == {ReasonCode.OTHER_PROFILES: 4}, "no position: any rails"


def test_of_too_many_entries_the_newest_of_every_place_are_used(draw: Draw) -> None:
    entries = draw(0, CONICITIES, 2)  # 21 of each of 8 places; later wheelsets ran later
    found = Libraries(entries, replace(PARAMETERS, most_entries=100)).admitted(subject("X"))
    assert found.left_out == {ReasonCode.NEWER_ENTRIES: 168 - 96}
    assert names(found.entries) == {f"W{number}" for number in range(9, 21)}
    assert PARAMETERS.most_entries == 4000
    every = Libraries(entries, replace(PARAMETERS, most_entries=168)).admitted(subject("X"))
    assert every.left_out == {}


groups_of = st.lists(st.frozensets(st.sampled_from("abcdefghij"), min_size=1, max_size=3), min_size=1, max_size=12)


def slow_families(groups: list[frozenset[str]]) -> set[frozenset[str]]:
    """Join any two that share a name until nothing moves."""
    found = set(groups)
    while True:
        pair = next((pair for pair in combinations(sorted(found, key=sorted), 2) if pair[0] & pair[1]), None)
        if pair is None:
            return found
        found = (found - set(pair)) | {pair[0] | pair[1]}


@given(groups_of)
@settings(max_examples=200)
def test_families_are_what_joining_pair_by_pair_gives(groups: list[frozenset[str]]) -> None:
    found = families(groups)
    assert set(found) == slow_families(groups)
    assert found == sorted(found, key=min)
    assert families(reversed(groups)) == found


def test_folds_part_the_wheelsets_and_no_family(draw: Draw) -> None:
    entries = draw(0, CONICITIES, 1)
    paired = [replace(one, shares_data=(one.wheelset, f"W{int(one.wheelset[1:]) // 2 * 2}")) for one in entries]
    found = folds(paired, SignatureParameters())
    assert sorted(name for fold in found for name in fold) == sorted(names(tuple(entries)))
    for entry in paired:
        assert sum(bool(fold & sharers(entry)) for fold in found) == 1
    means = [
        np.mean([one.conicity for one in entries if one.wheelset in fold])
        for fold in folds(entries, SignatureParameters())
    ]
    assert np.ptp(means) < 0.06, "every fold has all kinds"


def test_nothing_of_a_library_is_kept_between_two(draw: Draw) -> None:
    first = Libraries(draw(0, CONICITIES, 2), PARAMETERS)
    first.library(subject("X"))
    assert Libraries(draw(1, CONICITIES, 2), PARAMETERS)._made == {}

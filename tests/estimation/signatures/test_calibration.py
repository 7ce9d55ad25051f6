"""How wide intervals are: by errors of left-out wheelsets, and by what all that is on file may be off by in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from signature_draws import PARAMETERS, Draw

from estimation.signatures import calibration
from estimation.signatures.answer import judged
from estimation.signatures.calibration import NORMAL, share_apart
from estimation.signatures.families import sharers
from estimation.signatures.library import NEAR, Library, library, rows_of
from estimation.signatures.mixed_model import CONICITY, LARGEST_SHARE, Likelihood, _less, fitted
from estimation.values.arrays import FloatArray
from estimation.values.signatures import ConicitySource, LibraryEntry

CONICITIES = np.linspace(0.16, 0.36, 21)


def answers(errors: FloatArray, std: float = 0.004, on_file: float = 0.0) -> list[calibration._Judged]:
    return [calibration._Judged(number, float(error), std, on_file, 1.0, 1.0) for number, error in enumerate(errors)]


def test_the_factor_covers_where_stds_are_off_by_as_much_as_it_expects() -> None:
    rng = np.random.default_rng(0)
    held = []
    for _ in range(1500):
        scale = 0.004 * np.exp(calibration.FACTOR_STD * rng.standard_normal())
        errors = np.hypot(scale, 0.003) * rng.standard_normal(14)
        factor = calibration._factor(answers(errors, on_file=0.003))
        held.append(abs(scale * rng.standard_normal()) <= NORMAL * factor * 0.004)
    assert np.mean(held) == pytest.approx(0.95, abs=0.015)
    assert calibration.FACTOR_STD == 0.3


@pytest.mark.parametrize("true", [0.5, 1.0, 2.0])
def test_many_wheelsets_show_the_factor(true: float) -> None:
    errors = true * 0.004 * np.random.default_rng(1).standard_normal(4000)
    assert calibration._factor(answers(errors)) == pytest.approx(true, rel=0.03)


def test_answers_about_one_wheelset_count_as_one() -> None:
    errors = 0.006 * np.random.default_rng(2).standard_normal(10)
    often = [one for one in answers(errors) for _ in range(7)]
    assert calibration._factor(often) == pytest.approx(calibration._factor(answers(errors)))


def test_of_one_more_wheelset_of_the_same_kind_one_in_a_hundred_is_novel() -> None:
    rng = np.random.default_rng(4)
    novel = []
    for _ in range(6000):
        drawn = rng.normal(0.3, 0.5, 15)
        reach = calibration._reach(list(np.exp(drawn[:14])), 14)
        novel.append(np.exp(drawn[14]) > reach.largest)
    assert np.mean(novel) == pytest.approx(0.01, abs=0.004)
    assert calibration.NOVEL == 0.99


def test_novelty_is_that_of_all_features_or_that_of_roll() -> None:
    reach = calibration.Reach(0.0, 0.5, 14)
    of = calibration.Calibration(1.0, reach, replace(reach, mean=1.0), 14, 30)
    grid = np.array([0.2, 0.3])
    far = Likelihood(grid, grid, whole=2.0 * reach.largest, roll=0.0)
    rolling = Likelihood(grid, grid, whole=0.0, roll=2.0 * reach.largest)
    assert of.novelty(far) == pytest.approx(2.0)
    assert of.novelty(rolling) == pytest.approx(2.0 / np.e)


def shares(entries: Sequence[LibraryEntry]) -> float:
    std = np.array([one.std for one in entries])
    rows = rows_of(entries, np.zeros(len(entries)))
    return share_apart(rows, std, [sharers(one) for one in entries], PARAMETERS.margin)


def shifted(
    entries: Sequence[LibraryEntry], by: float, std: float, source: ConicitySource = ConicitySource.MEASURED_PROFILES
) -> list[LibraryEntry]:
    return [replace(one, conicity=one.conicity + by, std=std, source=source) for one in entries]


def test_errors_of_each_wheelset_alone_are_seen_to_be_that_and_errors_in_common_are_not(draw: Draw) -> None:
    own = [shares(draw(seed, CONICITIES, 2, std=0.01)) for seed in range(4)]
    assert np.mean(own) > 0.8
    common = [shares(shifted(draw(seed, CONICITIES, 2, std=1e-6), 0.01, 0.01)) for seed in range(4)]
    assert max(common) < 0.3
    assert shares(shifted(draw(0, CONICITIES, 2, std=1e-6), 0.0, 0.0)) == 1.0, "nothing is claimed"


def test_errors_of_geometries_are_all_taken_to_be_shared_and_those_of_measured_profiles_as_far_as_they_must(
    draw: Draw,
) -> None:
    exact = draw(0, CONICITIES, 2, std=0.006)
    found = {}
    for source in ConicitySource:
        of = library([replace(one, source=source) for one in exact], PARAMETERS)
        assert isinstance(of, Library)
        found[source] = of.shared_std(0.25)
    assert found[ConicitySource.GEOMETRY] == pytest.approx(0.006)
    assert found[ConicitySource.MEASURED_PROFILES] < 0.004


@pytest.mark.parametrize("source", ConicitySource)
@pytest.mark.parametrize("by", [-0.012, 0.012])
def test_answers_cover_where_everything_on_file_is_off_by_the_same(
    draw: Draw, by: float, source: ConicitySource
) -> None:
    of = library(shifted(draw(0, CONICITIES, 2, std=1e-6), by, 0.01, source), PARAMETERS)
    assert isinstance(of, Library)
    for number, truth in enumerate((0.2, 0.26, 0.32)):
        asked = [one.signature for one in draw([3, number], np.array([truth]), 1, name="X")]
        conicity = judged("X0", asked, of, PARAMETERS).conicity
        assert conicity.value is not None
        assert conicity.low is not None
        assert conicity.high is not None
        assert conicity.value - truth == pytest.approx(by, abs=0.008), "nothing in the library shows it"
        assert conicity.low <= truth <= conicity.high


def test_conicities_with_errors_that_do_not_show_do_not_draw_answers_to_the_mean(draw: Draw) -> None:
    exact = draw(5, CONICITIES, 2, std=1e-6)
    asked = [draw([6, n], np.array([truth]), 1, name="X") for n, truth in enumerate((0.19, 0.33))]
    found = []
    for entries in (exact, shifted(exact, 0.0, 0.02)):
        of = library(entries, PARAMETERS)
        assert isinstance(of, Library)
        found.append([judged("X0", [one.signature for one in ask], of, PARAMETERS).conicity.value for ask in asked])
    np.testing.assert_allclose(np.array(found[0], float), np.array(found[1], float), atol=0.002)


def test_what_is_shared_adds_up_as_it_is_and_counts_near_by(draw: Draw) -> None:
    known = draw(0, CONICITIES, 2, std=1e-6)
    entries = [replace(one, std=0.02 if one.conicity < 0.2 else 0.002, source=ConicitySource.GEOMETRY) for one in known]
    of = library(entries, PARAMETERS)
    assert isinstance(of, Library)
    mean = np.mean([one.std for one in entries])
    assert of.shared_std(0.34) == pytest.approx(mean, rel=1e-6)
    assert of.shared_std(0.16) > 1.5 * of.shared_std(0.34)
    assert NEAR == 0.03


def test_the_ends_of_a_library_are_less_certain_than_its_middle(draw: Draw) -> None:
    """Three coefficients are fitted to the wheelsets: at an end they rest on few."""
    model = fitted(rows_of(draw(0, CONICITIES, 2, std=1e-6), np.zeros(21 * 8)))
    terms = [np.array([1.0, c, c * c]) for c in np.log(np.array([0.16, 0.26]) / CONICITY)]
    end, middle = (float(term @ model.leverage @ term) for term in terms)
    assert middle < 0.15
    assert end > 0.25
    hat = [
        float(t @ model.leverage @ t)
        for c in CONICITIES
        for x in [np.log(c / CONICITY)]
        for t in [np.array([1, x, x * x])]
    ]
    assert np.sum(hat) == pytest.approx(3.0, rel=0.01), "the trace of the hat matrix is the number of coefficients"


def test_a_covariance_less_a_part_of_it_is_the_rest_and_never_less_than_a_tenth() -> None:
    rng = np.random.default_rng(0)
    first, second = (a @ a.T for a in rng.standard_normal((2, 5, 9)))
    whole = first + 9 * second
    np.testing.assert_allclose(_less(whole, first), 9 * second, rtol=1e-8)
    np.testing.assert_allclose(_less(first, 3 * first), 0.1 * first, rtol=1e-8)
    assert LARGEST_SHARE == 0.9

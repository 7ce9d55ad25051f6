"""How wide intervals are: by errors of left-out wheelsets, and by what all that is on file may be off by in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from signature_draws import PARAMETERS, Draw

from estimation.signatures import calibration
from estimation.signatures.answer import judged
from estimation.signatures.calibration import NORMAL, SHARES, Calibration, differences, judged_by, unjudged
from estimation.signatures.library import Library, library, rows_of
from estimation.signatures.mixed_model import Likelihood, _less, fitted
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters, sharers
from estimation.values.arrays import FloatArray
from estimation.values.signatures import Basis, ConicitySource, LibraryEntry

CONICITIES = np.linspace(0.16, 0.36, 21)


def answers(errors: FloatArray, std: float = 0.004, on_file: float = 0.0) -> list[calibration._Judged]:
    return [
        calibration._Judged(number, float(error), std, on_file**2, 0.0, 1.0, 1.0, like=True)
        for number, error in enumerate(errors)
    ]


NOTHING = np.eye(len(SHARES))[0]
REACH = calibration.Reach(0.0, 0.5, 14)


def of_weights(weights: FloatArray) -> Calibration:
    return Calibration(weights, REACH, replace(REACH, mean=1.0))


def factor(found: list[calibration._Judged]) -> float:
    """Return the factor on the std of an answer where nothing on file is off in common."""
    return of_weights(calibration._weights(found, NOTHING, SignatureParameters())).std(1.0, np.zeros(len(SHARES)))


def test_the_factor_covers_where_stds_are_off_by_as_much_as_it_expects() -> None:
    rng = np.random.default_rng(0)
    held = []
    for _ in range(1500):
        scale = 0.004 * np.exp(SignatureParameters().factor_std * rng.standard_normal())
        errors = np.hypot(scale, 0.003) * rng.standard_normal(14)
        half = NORMAL * factor(answers(errors, on_file=0.003)) * 0.004
        held.append(abs(scale * rng.standard_normal()) <= half)
    assert np.mean(held) == pytest.approx(0.95, abs=0.015)
    assert SignatureParameters().factor_std == 0.3


@pytest.mark.parametrize("true", [0.5, 1.0, 2.0])
def test_many_wheelsets_show_the_factor(true: float) -> None:
    errors = true * 0.004 * np.random.default_rng(1).standard_normal(4000)
    assert factor(answers(errors)) == pytest.approx(true, rel=0.03)


def test_answers_about_one_wheelset_count_as_one() -> None:
    errors = 0.006 * np.random.default_rng(2).standard_normal(10)
    often = [one for one in answers(errors) for _ in range(7)]
    assert factor(often) == pytest.approx(factor(answers(errors)))


def test_answers_about_tracks_that_are_refused_do_not_count_for_the_factor() -> None:
    good = answers(0.004 * np.random.default_rng(3).standard_normal(20))
    refused = [replace(one, error=0.05, like=False) for one in good[:5]]
    found = calibration._of(iter([*good, *refused]), NOTHING, SignatureParameters())
    assert isinstance(found, Calibration)
    assert found.std(1.0, np.zeros(len(SHARES))) == pytest.approx(factor(good))
    alone = calibration._of(iter(replace(one, like=False) for one in good), NOTHING, SignatureParameters())
    assert isinstance(alone, Calibration), "where all are refused they are better than nothing"


def test_sections_rougher_than_all_others_are_left_out_of_the_factor(draw: Draw) -> None:
    smooth = draw(0, CONICITIES, 4, std=1e-6)
    rough = draw(1, CONICITIES, 1, first_section=9, std=1e-6, rougher=3.0)
    entries = sorted([*smooth, *rough], key=lambda one: (one.wheelset, one.signature.start_ns))
    rows, before = rows_of(entries, np.zeros(len(entries))), unjudged(entries)
    apart = calibration._folds(rows, [sharers(one) for one in entries])
    judged_rows = list(calibration._judged(rows, before, apart, Basis.OTHER_PLACES, PARAMETERS.margin))
    assert any(one.like for one in judged_rows)
    assert any(not one.like for one in judged_rows)
    same = calibration._judged(rows, before, apart, Basis.SAME_PLACES, PARAMETERS.margin)
    assert all(one.like for one in same), "places that the library has are like themselves"


def test_an_interval_is_that_of_the_mixture_over_shares_and_factors() -> None:
    rng = np.random.default_rng(5)
    weights = rng.dirichlet(np.ones(len(SHARES) * len(calibration.FACTORS))).reshape(len(SHARES), -1)
    shared = 0.01 * np.sqrt(1.0 - SHARES)
    std = of_weights(weights).std(0.004, shared)
    drawn = rng.choice(weights.size, 200_000, p=weights.ravel())
    share_at, factor_at = np.unravel_index(drawn, weights.shape)
    errors = np.hypot(0.004 * calibration.FACTORS[factor_at], shared[share_at]) * rng.standard_normal(len(drawn))
    assert np.mean(np.abs(errors) <= NORMAL * std) == pytest.approx(0.95, abs=0.002)


@pytest.mark.parametrize("at", [0, -1])
def test_a_factor_that_is_certain_is_the_least_or_the_largest_that_is_tried(at: int) -> None:
    weights = np.zeros((len(SHARES), len(calibration.FACTORS)))
    weights[at, at] = 1.0
    found = of_weights(weights).std(0.004, np.zeros(len(SHARES)))
    assert found == pytest.approx(0.004 * calibration.FACTORS[at])


def test_errors_that_a_share_explains_do_not_raise_the_factor() -> None:
    errors = 0.010 * np.random.default_rng(6).standard_normal(200)
    found = [replace(one, claimed=0.01**2) for one in answers(errors)]
    certain = np.zeros((2, len(SHARES)))
    certain[0, 0] = certain[1, -1] = 1.0
    weights = [calibration._weights(found, shares, SignatureParameters()) for shares in certain]
    np.testing.assert_allclose([one.sum() for one in weights], 1.0)
    none, whole = (float(np.sum(one @ calibration.FACTORS)) for one in weights)
    assert none > 2.0
    assert whole < 1.0


def test_of_one_more_wheelset_of_the_same_kind_one_in_a_hundred_is_novel() -> None:
    rng = np.random.default_rng(4)
    novel = []
    for _ in range(6000):
        drawn = rng.normal(0.3, 0.5, 15)
        reach = calibration._reach(list(np.exp(drawn[:14])), 14)
        novel.append(np.exp(drawn[14]) > reach.largest)
    assert np.mean(novel) == pytest.approx(0.01, abs=0.004)
    assert SIGNATURE.novel_quantile == 0.99


def test_novelty_is_that_of_all_features_or_that_of_roll() -> None:
    of = of_weights(np.ones((1, len(calibration.FACTORS))))
    grid = np.array([0.2, 0.3])
    far = Likelihood(grid, grid, whole=2.0 * REACH.largest, roll=0.0)
    rolling = Likelihood(grid, grid, whole=0.0, roll=2.0 * REACH.largest)
    assert of.novelty(far) == pytest.approx(2.0)
    assert of.novelty(rolling) == pytest.approx(2.0 / np.e)


def share(entries: Sequence[LibraryEntry]) -> float:
    """Return the share of the variances that is taken to be each wheelset's own."""
    before, groups = unjudged(entries), [sharers(one) for one in entries]
    rows = rows_of(entries, np.zeros(len(entries)))
    of = judged_by(before, differences(rows, before, groups, PARAMETERS.margin), SignatureParameters())
    return float(np.mean(of.alone**2) / np.mean([one.std**2 for one in entries]))


def shifted(
    entries: Sequence[LibraryEntry], by: float, std: float, source: ConicitySource = ConicitySource.MEASURED_PROFILES
) -> list[LibraryEntry]:
    return [replace(one, conicity=one.conicity + by, std=std, source=source) for one in entries]


def test_errors_of_each_wheelset_alone_are_seen_to_be_that_and_errors_in_common_are_not(draw: Draw) -> None:
    own = [share(draw(seed, CONICITIES, 2, std=0.01)) for seed in range(4)]
    assert np.mean(own) > 0.8
    common = [share(shifted(draw(seed, CONICITIES, 2, std=1e-6), 0.01, 0.01)) for seed in range(4)]
    assert max(common) < 0.3


@pytest.mark.parametrize("own", [0.0, 0.5])
def test_of_geometries_as_much_is_own_as_the_differences_need(draw: Draw, own: float) -> None:
    """Claimed is 0.012; where all of it is in common the differences are those of the answers."""
    found = []
    for seed in range(4):
        entries = draw(seed, CONICITIES, 2, std=max(0.012 * np.sqrt(own), 1e-6))
        found.append(share(shifted(entries, 0.012 * np.sqrt(1.0 - own), 0.012, ConicitySource.GEOMETRY)))
    assert np.mean(found) == pytest.approx(0.8 * own, abs=0.1)
    assert np.ptp(found) < 0.4


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


def test_the_ends_of_a_library_are_less_certain_than_its_middle(draw: Draw) -> None:
    """Three coefficients are fitted to the wheelsets: at an end they rest on few."""
    model = fitted(rows_of(draw(0, CONICITIES, 2, std=1e-6), np.zeros(21 * 8)))
    terms = [np.array([1.0, c, c * c]) for c in np.log(np.array([0.16, 0.26]) / SIGNATURE.middle_conicity)]
    end, middle = (float(term @ model.leverage @ term) for term in terms)
    assert middle < 0.15
    assert end > 0.25
    hat = [
        float(t @ model.leverage @ t)
        for c in CONICITIES
        for x in [np.log(c / SIGNATURE.middle_conicity)]
        for t in [np.array([1, x, x * x])]
    ]
    assert np.sum(hat) == pytest.approx(3.0, rel=0.01), "the trace of the hat matrix is the number of coefficients"


def test_a_covariance_less_a_part_of_it_is_the_rest_and_never_less_than_a_tenth() -> None:
    rng = np.random.default_rng(0)
    first, second = (a @ a.T for a in rng.standard_normal((2, 5, 9)))
    whole = first + 9 * second
    np.testing.assert_allclose(_less(whole, first), 9 * second, rtol=1e-8)
    np.testing.assert_allclose(_less(first, 3 * first), 0.1 * first, rtol=1e-8)
    assert SIGNATURE.largest_share == 0.9

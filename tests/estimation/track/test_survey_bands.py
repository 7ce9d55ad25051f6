"""Survey and passes weighed against each other by place and band: what is learnt of both, and what follows."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimation.filters import high_pass, local_cubic_kernel
from estimation.track.panel.basis import PanelParameters
from estimation.track.parameters import TRACK
from estimation.track.passes import Pass, ProfileLife
from estimation.track.results import position_std, shrunk
from estimation.track.section import SectionEstimate, estimate_section
from estimation.track.settings import SectionParameters
from estimation.track.survey_posterior import (
    SurveyPosterior,
    _bands_of,
    _learnt,
    _local_excess,
    survey_bands,
    survey_posterior,
    total_variance,
)
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.track import TrackAlignment

LENGTH = 1600
N = LENGTH + 1
P = SectionParameters(panel=PanelParameters(length=float(LENGTH), groups=4, block=100.0, basis_count=21))
SHARED = slice(250, -250)  # where all bands are compared


def waves(seed: int, n: int, width: float, size: float) -> FloatArray:
    """Return noise of this rms (m), smoothed over a width."""
    rng = np.random.default_rng(seed)
    u = np.arange(-5 * width, 5 * width + 1) / width
    smooth = np.convolve(rng.standard_normal(n + 400), np.exp(-0.5 * u * u), mode="same")[200 : 200 + n]
    return np.asarray(size * smooth / smooth.std())


TRUE = waves(1, N + 600, 4.0, 1.2e-3)  # m, from 300 m before the section to 300 m behind it


def a_pass(number: int, follows: float = 0.0) -> Pass:
    """Return a pass whose y is off by its own noise, and by a share of the track that all passes follow."""
    x = waves(100 + number, len(TRUE), 2.5, 0.7e-3)
    R = x / 0.5 + waves(300 + number, len(TRUE), 1.0, 0.05e-3)
    y = (1.0 + follows) * TRUE + x + waves(200 + number, len(TRUE), 3.0, 0.05e-3)
    at = np.arange(-300.0, len(TRUE) - 300.0)
    return Pass(ProfileLife(f"W{number}"), f"V{number}", number * 10**13, at, y, R)


def survey(std: float, stated: float, seed: int = 7, **errors: FloatArray) -> TrackAlignment:
    d = TRUE[300:-300] + waves(seed, N, 1.0, 1.0) * std + errors.get("added", np.zeros(N))
    zero = np.zeros(N)
    return TrackAlignment(
        "S", 1, np.arange(float(N)), d, zero + stated, zero, zero, zero.astype(np.int64), Status.ESTIMATED
    )


@cache
def estimate(
    std: float, stated: float, journeys: int = 6, follows: float = 0.0
) -> tuple[SectionEstimate, TrackAlignment]:
    on_file = survey(std, stated)
    return estimate_section("S", [a_pass(k, follows) for k in range(journeys)], on_file, P), on_file


def posterior(std: float, stated: float, journeys: int = 6, follows: float = 0.0) -> SurveyPosterior:
    found, on_file = estimate(std, stated, journeys, follows)
    assert found.iterated is not None
    made = survey_posterior(found.iterated, on_file, P)
    assert made is not None
    return made


def error(d: FloatArray) -> float:
    rest = high_pass(d - TRUE[300:-300], local_cubic_kernel(TRACK.band_edges[0], 1.0))
    return float(np.sqrt(np.mean(rest[SHARED] ** 2)))


@pytest.mark.parametrize("std", [0.3e-3, 1.0e-3])
@pytest.mark.parametrize("misstated", [1.0, 0.3, 3.0])
def test_the_std_of_a_survey_is_learnt_whatever_is_on_file(std: float, misstated: float) -> None:
    made = posterior(std, misstated * std)
    assert made.bands.survey_std == pytest.approx(std, rel=0.25)
    assert made.std_factor == pytest.approx(1.0 / misstated, rel=0.25)


@pytest.mark.parametrize("std", [0.03e-3, 0.3e-3, 3e-3])
def test_both_together_are_no_worse_than_the_better_one(std: float) -> None:
    made = posterior(std, std)
    alone = sum(one.passes for one in made.bands.bands) + made.bands.long_waves
    best = min(error(made.before.alignment), error(np.asarray(alone)))
    assert error(made.alignment.alignment) < 1.2 * best
    stated = float(np.median(made.alignment.alignment_std[SHARED]))
    assert 0.5 * stated < error(made.alignment.alignment) < 2.5 * stated


def test_what_follows_the_motion_is_taken_off_the_passes_and_is_no_error_of_the_survey() -> None:
    made = posterior(0.1e-3, 0.1e-3, follows=0.1)
    assert made.bands.coherent_std(120.0) == pytest.approx(0.12e-3, rel=0.25)
    assert made.bands.survey_std < 0.15e-3
    assert error(made.alignment.alignment) < 0.08e-3


def test_passes_count_by_the_share_that_curves_leave_of_them() -> None:
    """Curves are flattened by it, alike for all passes: it is not in their scatter."""
    found, on_file = estimate(0.3e-3, 0.3e-3)
    assert found.iterated is not None
    assert found.iterated.slope is not None
    stds = []
    for explained in (1.0, 0.99, 0.8):
        slope = replace(found.iterated.slope, explained=explained)
        bands = survey_bands(replace(found.iterated, slope=slope), on_file, 0.02e-3, SectionParameters())
        assert bands is not None
        passes = [np.where(np.isfinite(one.passes_variance), one.passes_variance, 0.0) for one in bands.bands]
        stds.append(float(np.sqrt(np.median(total_variance(passes)[SHARED]))))
    assert stds[1] < 1.1 * stds[0]
    assert stds[2] > 2.0 * stds[0]


def test_a_survey_in_the_motion_keeps_its_longest_waves() -> None:
    made = posterior(0.3e-3, 0.3e-3)
    change = np.sum([one.posterior - one.survey for one in made.bands.bands[1:]], axis=0)
    np.testing.assert_allclose(made.in_motion - made.before.alignment, change, atol=1e-12)
    assert np.abs(made.alignment.alignment - made.in_motion).max() > 1e-5


def test_where_both_differ_more_than_elsewhere_neither_is_believed() -> None:
    found, on_file = estimate(0.1e-3, 0.1e-3)
    assert found.iterated is not None
    tamped = np.where((np.arange(N) > 700) & (np.arange(N) < 900), waves(9, N, 3.0, 1e-3), 0.0)
    bands = survey_bands(
        found.iterated, replace(on_file, alignment=on_file.alignment + tamped), 0.02e-3, SectionParameters()
    )
    assert bands is not None
    std = bands.posterior_std(120.0)
    assert np.median(std[750:850]) > 4.0 * np.median(std[300:600])


def test_one_journey_shows_nothing_of_its_own_errors() -> None:
    made = posterior(0.2e-3, 0.2e-3, journeys=1)
    assert np.isfinite(made.alignment.alignment).all()
    assert 0.1e-3 < made.bands.survey_std < 0.4e-3


def test_a_survey_that_no_pass_meets_is_not_weighed() -> None:
    found, on_file = estimate(0.2e-3, 0.2e-3)
    assert found.iterated is not None
    assert survey_bands(found.iterated, replace(on_file, s=on_file.s + 1e4), 0.02e-3, SectionParameters()) is None


def test_a_variance_is_learnt_as_far_as_passes_can_tell_it_from_their_own() -> None:
    assert _learnt(4.0, 1.0, 0.0, 1.0, 100.0, SectionParameters()) == pytest.approx(
        (100.0 * 3.0 + SectionParameters().filed_samples) / (100.0 + SectionParameters().filed_samples)
    )
    assert _learnt(1.0, 2.0, 1.0, 0.5, 100.0, SectionParameters()) == pytest.approx(
        0.5
    )  # passes explain all of it: as on file
    assert _learnt(1.0, 2.0, 1.0, 5.0, 100.0, SectionParameters()) == pytest.approx(
        1.0
    )  # but it is no more than both differ by
    trust = 100.0 * (3.0 / 6.0) ** 2
    assert _learnt(4.0, 1.0, np.sqrt(3.0), 1.0, 100.0, SectionParameters()) == pytest.approx(
        (trust * 3.0 + 6.0) / (trust + 6.0)
    )


@pytest.mark.parametrize(("factor", "excess"), [(0.98, False), (1.02, True)])
def test_a_local_difference_counts_from_four_stds_on(factor: float, *, excess: bool) -> None:
    length = 4.0
    chance = 1.0 + SectionParameters().local_stds * np.sqrt(2.0 * length / SectionParameters().local_length)
    rest = np.where((np.arange(600) >= 250) & (np.arange(600) < 350), np.sqrt(factor * chance), 1.0)
    found = _local_excess(rest, np.ones(600, np.bool_), 1.0, length, 1.0, SectionParameters())
    assert found.any() == excess
    assert not found[:190].any()


def test_bands_add_up_and_so_do_their_variances() -> None:
    kernels = [local_cubic_kernel(edge, 1.0) for edge in TRACK.band_edges]
    white = np.random.default_rng(3).standard_normal(40_000)
    bands = _bands_of(white, kernels)
    np.testing.assert_allclose(bands.sum(axis=0), high_pass(white, kernels[0]), atol=1e-12)
    inside = slice(200, -200)
    variances = [np.array([float(np.var(one[inside]))]) for one in bands]
    assert total_variance(variances)[0] == pytest.approx(float(np.var(bands.sum(axis=0)[inside])), rel=0.05)


def test_positions_are_shrunk_to_what_was_reported_as_far_as_they_are_not_known() -> None:
    found, _ = estimate(0.2e-3, 0.2e-3)
    iterated = found.iterated
    assert iterated is not None
    for std, share in ((None, 1.0), (1.0, 0.5), (3.0, 0.1)):
        noise = iterated.noise if std is None else iterated.noise * std / next(iter(position_std(iterated).values()))
        now = replace(iterated, noise=noise)
        journey = next(iter(now.corrections))
        raw = iterated.corrections[journey].offset
        assert shrunk(now)[journey].offset == pytest.approx(share * raw, rel=0.01, abs=1e-9)
    empty = replace(iterated, solution=replace(iterated.solution, alignment=np.zeros(N)))
    assert set(position_std(empty).values()) == {float("inf")}


def test_the_shipped_figures() -> None:
    from estimation.track import survey_posterior as shipped  # noqa: PLC0415 - its figures

    assert TRACK.band_edges == (120.0, 60.0, 30.0, 15.0, 7.5, 4.0)
    assert (
        SectionParameters().shortest_wavelength,
        SectionParameters().filed_samples,
        SectionParameters().local_length,
        SectionParameters().local_stds,
    ) == (2.5, 6.0, 100.0, 4.0)
    assert (
        SectionParameters().curve_share_factor,
        TRACK.neighbour_correlation,
        TRACK.second_neighbour_correlation,
    ) == (2.0, 0.48, 0.06)
    assert (TRACK.correlated_length, TRACK.reported_position_std) == (20.0, 1.0)
    assert (shipped.STATED, SectionParameters().survey_error_length, SectionParameters().most_difference_error) == (
        60.0,
        5.0,
        0.08,
    )

"""When a survey is used: unit, sides, place and misfit at their limits, against what they are made with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from test_agreement_limits import smooth

from estimation.filters import high_pass, local_cubic_kernel
from estimation.track.positions import peak_position
from estimation.track.survey_check import (
    SurveyCheck,
    SurveyCheckParameters,
    _by_lag,
    _memory,
    _misplaced,
    _unit,
    check_survey,
)
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.track import AlignmentSource, TrackAlignment

N = 1500
S = np.arange(float(N))
D = 2e-3 * smooth(31, N, width=6)
STD = 1e-4
P = SurveyCheckParameters()


def track(alignment: FloatArray, std: float = STD, **changes: object) -> TrackAlignment:
    n = len(alignment)
    zero = np.zeros(n)
    plain = TrackAlignment(
        "S", 1, np.arange(float(n)), alignment, zero + std, zero, zero, np.ones(n, dtype=np.int64), Status.ESTIMATED,
        cutoff_wavelength=120.0,
    )  # fmt: skip
    return replace(plain, **changes)  # type: ignore[arg-type]


def checked(recorded: FloatArray, *, place_std: float = 0.0, std: float = STD, scale_std: float = 0.0) -> SurveyCheck:
    return check_survey(
        track(recorded, std), track(D, std, source=AlignmentSource.FLEET, scale_std=scale_std), place_std=place_std
    )


def moved(metres: float) -> FloatArray:
    return np.interp(S + metres, S, D)


def test_a_survey_that_is_right_is_used_with_its_figures() -> None:
    found = checked(moved(2.0))
    assert (found.usable, found.reason, found.sign) == (True, None, 1)
    assert found.shift == pytest.approx(2.0, abs=0.05)
    assert found.scale == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("place_std", "limit"), [(0.0, 3.0), (2.0, 9.0)])
def test_a_survey_may_be_shifted_by_three_metres_and_what_the_fleet_leaves_open(place_std: float, limit: float) -> None:
    for sign in (-1.0, 1.0):
        assert checked(moved(sign * (limit - 0.15)), place_std=place_std, std=1e-3).usable
        refused = checked(moved(sign * (limit + 0.15)), place_std=place_std, std=1e-3)
        assert not refused.usable
        assert code_of(refused.reason) is ReasonCode.SURVEY_DISPLACED
        assert ("too far back" if sign > 0 else "too far along") in str(refused.reason)


@pytest.mark.parametrize(("scale_std", "most"), [(0.0, 1.25), (0.05, 1.5)])
def test_a_survey_may_be_scaled_by_a_quarter_and_what_the_fleet_leaves_open(scale_std: float, most: float) -> None:
    for factor, usable in (
        (most - 0.01, True),
        (most + 0.01, False),
        (1 / most + 0.01, True),
        (1 / most - 0.01, False),
    ):
        assert checked(factor * D, std=2e-3, scale_std=scale_std).usable is usable


def test_a_survey_with_left_and_right_exchanged_is_refused() -> None:
    found = checked(-D)
    assert (found.usable, found.sign) == (False, -1)
    assert code_of(found.reason) is ReasonCode.SURVEY_MIRRORED


def test_two_sections_have_no_more_in_common_than_chance() -> None:
    found = checked(2e-3 * smooth(77, N, width=6))
    assert not found.usable
    assert code_of(found.reason) is ReasonCode.SURVEY_UNRELATED
    assert found.correlation < 0.6


def test_the_chance_of_what_two_have_in_common_is_a_millionth() -> None:
    other = 2e-3 * smooth(77, N, width=6)
    verdicts = []
    for share in np.linspace(0.3, 0.9, 25):
        recorded = share * D + np.sqrt(1 - share**2) * other
        found = checked(recorded, std=1.0)
        lags = 2.0 * 60.0 / (N / found.samples)
        chance = chi2.logsf(-(found.samples - 3.0) * np.log1p(-(found.correlation**2)), 1) / np.log(10.0)
        chance += np.log10(max(lags, 1.0))
        assert (code_of(found.reason) is ReasonCode.SURVEY_UNRELATED) is bool(chance > -6.0)
        verdicts.append(chance)
    assert min(abs(one + 6.0) for one in verdicts if one > -6.0) < 3.0
    assert min(abs(one + 6.0) for one in verdicts if one < -6.0) < 3.0


def test_twenty_independent_samples_and_two_lengths_of_correlation_are_needed() -> None:
    samples = {}
    for n in range(60, 600, 20):
        d, base = D[:n], track(D[:n], source=AlignmentSource.FLEET)
        found = check_survey(track(d), base)
        memory = _memory(np.where(d == 0, 0, d), d, 1.0)
        said = n >= 120 and n / memory >= 20.0
        assert code_of(found.reason) is (None if said else ReasonCode.SURVEY_NOT_ASSESSABLE)
        assert found.usable
        assert np.isnan(found.scale) is not said or not said
        samples[n] = n / memory
    assert any(n >= 120 and 10.0 < one < 20.0 for n, one in samples.items())
    assert any(20.0 <= one < 30.0 for one in samples.values())
    wide = 2e-3 * np.random.default_rng(3).standard_normal(130)
    for n, said in ((119, False), (121, True)):
        assert (check_survey(track(wide[:n]), track(wide[:n], source=AlignmentSource.FLEET)).reason is None) is said


def test_a_survey_is_filtered_as_the_fleet_is() -> None:
    weights = local_cubic_kernel(120.0, 1.0)
    reach = len(weights) // 2
    whole = D + 1e-2 * np.sin(2 * np.pi * S / 900.0)
    fleet = track(high_pass(whole, weights), source=AlignmentSource.FLEET)
    raw = track(whole, cutoff_wavelength=np.inf)
    assert check_survey(raw, fleet).usable
    assert check_survey(raw, fleet).scale == pytest.approx(1.0, abs=1e-6)
    assert check_survey(replace(raw, cutoff_wavelength=120.0), fleet).correlation < 0.9
    assert check_survey(raw, fleet).samples == pytest.approx(
        (N - 0.0) / _memory(np.where((reach <= S) & (N - reach > S), fleet.alignment, 0.0),
                            np.where((reach <= S) & (N - reach > S), fleet.alignment, 0.0), 1.0), rel=0.35,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1e3, "millimetres were taken for metres"),
        (1.11e3, "millimetres were taken for metres"),
        (1.13e3, None),
        (0.9e-3, "metres were taken for millimetres"),
        (25.4, "millimetres were taken for inches"),
        (3.28, "feet were taken for metres"),
        (2.0, None),
    ],
)
def test_a_unit_is_named_where_the_factor_is_near_to_it(factor: float, words: str | None) -> None:
    text = _unit(factor, SurveyCheckParameters())
    assert text.endswith(f": {words}") if words else ":" not in text


def found_with(**changes: object) -> SurveyCheck:
    plain = SurveyCheck(usable=True, reason=None, scale=1.0, shift=0.0, sign=1, correlation=1.0, samples=50.0)
    return replace(plain, **changes)  # type: ignore[arg-type]


def test_the_limits_of_unit_sides_and_place() -> None:
    for scale, wrong in ((1.249, False), (1.251, True), (1 / 1.249, False), (1 / 1.251, True)):
        assert bool(_misplaced(found_with(scale=scale), 1.0, 0.0, P)) is wrong
    for scale, wrong in ((2.49, False), (2.51, True), (1 / 2.49, False), (1 / 2.51, True)):
        assert bool(_misplaced(found_with(scale=scale), 2.0, 0.0, P)) is wrong
    for shift, wrong in ((2.99, False), (3.01, True), (-2.99, False), (-3.01, True)):
        assert bool(_misplaced(found_with(shift=shift), 1.0, 0.0, P)) is wrong
        assert bool(_misplaced(found_with(shift=2.0 * shift), 1.0, 3.0, P)) is wrong
    assert len(_misplaced(found_with(sign=-1, shift=9.0, scale=9.0), 1.0, 0.0, P)) == 3
    assert "within 1.0 m" in _misplaced(found_with(shift=9.0), 1.0, 1.0, P)[0].text


def test_correlation_and_factor_at_every_lag() -> None:
    n, reach = 60, 5
    r, f = smooth(1, n), smooth(2, n)
    f[:7] = 0.0
    r[50:] = 0.0
    weight = np.linspace(1.0, 2.0, n)
    score, factor = _by_lag(r, f, weight, reach)
    for lag in range(-reach, reach + 1):
        pairs = [(r[i], f[i + lag], weight[i + lag]) for i in range(n) if 0 <= i + lag < n]
        cross = sum(w * a * b for a, b, w in pairs)
        own = sum(w * a * a for a, b, w in pairs if b != 0.0)
        measured = sum(w * b * b for a, b, w in pairs if a != 0.0)
        assert score[lag + reach] == pytest.approx(cross / np.sqrt(own * measured))
        assert factor[lag + reach] == pytest.approx(cross / measured)


def test_a_peak_between_samples_is_that_of_the_parabola() -> None:
    lags = np.arange(9.0)
    assert peak_position(3.0 - (lags - 5.3) ** 2, 5) == pytest.approx(5.3)
    assert peak_position(3.0 - (lags - 1.8) ** 2, 2) == pytest.approx(1.8)
    assert peak_position(lags, 8) == 8.0
    assert peak_position(-lags, 0) == 0.0
    assert peak_position(0.0 * lags, 4) == 4.0
    assert peak_position((lags - 4.0) ** 2, 4) == 4.0


def test_the_length_of_an_independent_sample() -> None:
    r, f = smooth(1, 300, width=5), smooth(2, 300, width=4)

    def own(x: FloatArray, lag: int) -> float:
        return float(x[: len(x) - lag] @ x[lag:] / (x @ x))

    for step in (1.0, 0.5):
        far = round(60.0 / step)
        expected = step * (1.0 + 2.0 * sum(own(r, k) * own(f, k) for k in range(1, far + 1)))
        assert _memory(r, f, step) == pytest.approx(expected)
    sharp = np.array([1.0, -1.0] * 40)
    assert _memory(sharp, np.array([1.0, 1.0, -1.0, -1.0] * 20), 2.0) >= 2.0


def test_what_only_one_knows_is_not_compared() -> None:
    hole = np.where((S > 300) & (S < 700), np.nan, D)
    found = checked(hole)
    assert found.usable
    assert found.samples == pytest.approx(checked(D).samples * 1101 / N, rel=0.2)
    elsewhere = replace(track(D), s=S + 5000.0)
    nothing_shared = check_survey(elsewhere, track(D, source=AlignmentSource.FLEET))
    assert code_of(nothing_shared.reason) is ReasonCode.SURVEY_NOT_ASSESSABLE
    unknown = replace(track(D), alignment_std=np.full(N, np.nan))
    assert check_survey(unknown, track(D, source=AlignmentSource.FLEET)).samples == 0.0

"""What two signals have in common, against canonical correlations and chances worked out the slow way."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from estimation.filters import local_cubic_kernel
from estimation.track.passes import Pass, ProfileLife
from estimation.track.screening.agreement import (
    NOTHING,
    Agreement,
    FilteredPass,
    ScreeningParameters,
    _canonical,
    _pieces,
    agreement,
    alignment_segment,
    disagreement,
    filter_pass,
)
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.track import TrackAlignment


def smooth(seed: int, n: int, width: int = 3) -> FloatArray:
    noise = np.random.default_rng(seed).standard_normal(n + 8 * width)
    weights = np.exp(-0.5 * (np.arange(-4 * width, 4 * width + 1) / width) ** 2)
    return np.convolve(noise, weights, "same")[4 * width : 4 * width + n]


def correlations(X: FloatArray, Z: FloatArray) -> FloatArray:
    """Return the canonical correlations of centred signals."""
    bases = [np.linalg.qr((signals - signals.mean(axis=1, keepdims=True)).T)[0] for signals in (X, Z)]
    return np.asarray(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False))


def autocorrelation(x: FloatArray, lag: int) -> float:
    x = x - x.mean()
    return float(x[:-lag] @ x[lag:] / (x @ x))


def by_hand(X: FloatArray, Z: FloatArray, lag: int, reach: int, step: float) -> Agreement:
    n = X.shape[1] - abs(lag)
    X, Z = (X[:, :n], Z[:, lag:]) if lag >= 0 else (X[:, -lag:], Z[:, :n])
    rho = correlations(X, Z)
    far = min(int(60.0 / step), n - 1)
    widths = [
        1.0 + 2.0 * sum(autocorrelation(a, k) * autocorrelation(b, k) for k in range(1, far + 1)) for a in X for b in Z
    ]
    width = max(*widths, 1.0, 1.0)
    samples = n / width
    wilks = -(samples - 0.5 * (len(X) + len(Z) + 3)) * float(np.log1p(-(rho**2)).sum())
    chance = chi2.logsf(wilks, len(X) * len(Z)) / np.log(10.0) + np.log10(max(2 * reach / width, 1.0))
    targets = [one - one.mean() for one in (*X[1:], *Z)]
    factor = np.linalg.lstsq(np.stack(targets).T, X[0] - X[0].mean(), rcond=None)[0][len(X) - 1]
    return Agreement(float(rho[0]), min(float(chance), 0.0), lag * step, float(factor), samples)


def near(found: Agreement, expected: Agreement) -> bool:
    pairs = zip(
        (found.correlation, found.log10_chance, found.shift, found.factor, found.samples),
        (expected.correlation, expected.log10_chance, expected.shift, expected.factor, expected.samples),
        strict=True,
    )
    return all(one == pytest.approx(other, rel=1e-6, abs=1e-9) for one, other in pairs)


def pair(n: int, lag: int, noise: float, *, rows: int = 2, first: int = 0, step: float = 0.5) -> list[FilteredPass]:
    """Return two signals, the first of which is ``lag`` samples further along by the second."""
    d, R, Q = smooth(1, n + 100), 0.7 * smooth(2, n), 0.9 * smooth(3, n)
    own, other = d[50 : 50 + n], d[50 - lag : 50 - lag + n]
    y = 1.5 * own + 0.3 * R + noise * smooth(4, n)
    z = other + 0.2 * Q + noise * smooth(5, n)
    return [
        FilteredPass(first, np.stack([y, R]), step),
        FilteredPass(first, np.stack([z, Q]) if rows == 2 else z[None, :], step),
    ]


@pytest.mark.parametrize("lag", [-9, 0, 14])
@pytest.mark.parametrize("rows", [1, 2])
def test_an_agreement_is_the_canonical_correlation_with_its_chance(lag: int, rows: int) -> None:
    first, second = pair(240, lag, 0.4, rows=rows)
    found = agreement(first, second, 12.0, 30.0, ScreeningParameters())
    assert near(found, by_hand(first.signals, second.signals, lag, 24, 0.5))
    assert found.shift == 0.5 * lag
    assert -60.0 < found.log10_chance < -1.0


def test_no_more_than_a_quarter_of_what_is_shared_is_searched() -> None:
    first, second = pair(240, 0, 0.4)
    assert near(
        agreement(first, second, 500.0, 30.0, ScreeningParameters()), by_hand(first.signals, second.signals, 0, 60, 0.5)
    )


def test_what_is_shared_is_compared_and_thirty_metres_are_needed() -> None:
    first, second = pair(240, 0, 0.3)
    cut = FilteredPass(60, second.signals[:, 60:], 0.5)
    assert near(
        agreement(first, cut, 12.0, 30.0, ScreeningParameters()),
        by_hand(first.signals[:, 60:], cut.signals, 0, 24, 0.5),
    )
    assert near(
        agreement(cut, first, 12.0, 30.0, ScreeningParameters()),
        by_hand(cut.signals, first.signals[:, 60:], 0, 24, 0.5),
    )
    assert agreement(first, cut, 12.0, 90.0, ScreeningParameters()) != NOTHING
    assert agreement(first, cut, 12.0, 90.5, ScreeningParameters()) == NOTHING
    assert (cut.last, cut.length) == (239, 89.5)
    early = FilteredPass(20, first.signals[:, 20:200], 0.5)
    for one, other in ((early, cut), (cut, early)):
        X, Z = (item.signals[:, 60 - item.first : 200 - item.first] for item in (one, other))
        assert near(agreement(one, other, 12.0, 30.0, ScreeningParameters()), by_hand(X, Z, 0, 24, 0.5))


@pytest.mark.parametrize("rows", [1, 2])
def test_the_largest_canonical_correlation_at_every_offset(rows: int) -> None:
    n = 240
    X, Z = (one.signals - one.signals.mean(axis=1, keepdims=True) for one in pair(n, 9, 0.4, rows=rows))
    expected = []
    for lag in range(-30, 31):
        A, B = X[:, max(0, -lag) : n - max(0, lag)], Z[:, max(0, lag) : n - max(0, -lag)]
        cross = A @ B.T / A.shape[1]
        M = np.linalg.inv(np.cov(X, bias=True)) @ cross @ np.linalg.inv(np.atleast_2d(np.cov(Z, bias=True))) @ cross.T
        expected.append(np.linalg.eigvals(M).real.max())
    np.testing.assert_allclose(_canonical(X, Z, 30), expected, rtol=1e-6)
    assert int(np.argmax(expected)) == 39


def test_samples_are_no_more_than_there_are() -> None:
    quick, slow = (np.diff(smooth(30 + k, 241, width=1), n=1) for k in (0, 1)), (smooth(40 + k, 240) for k in (0, 1))
    first, second = (FilteredPass(0, np.stack(list(signals)), 0.5) for signals in (quick, slow))
    found = agreement(first, second, 0.0, 1.0, ScreeningParameters())
    assert found.samples == 240.0
    assert near(found, by_hand(first.signals, second.signals, 0, 0, 0.5))


def test_a_signal_that_is_nothing_has_no_part() -> None:
    first, second = pair(240, 4, 0.4)
    flat = FilteredPass(0, np.stack([first.signals[0], np.zeros(240)]), 0.5)
    found = agreement(flat, second, 12.0, 30.0, ScreeningParameters())
    alone = by_hand(first.signals[:1], second.signals, 4, 24, 0.5)
    assert (found.correlation, found.shift) == (pytest.approx(alone.correlation, rel=1e-6), 2.0)


def test_the_same_twice_leaves_what_the_inverse_cannot_resolve() -> None:
    one = pair(240, 0, 0.0)[0]
    found = agreement(one, one, 0.0, 30.0, ScreeningParameters())
    unexplained = 2 * 1e-12  # of each signal
    wilks = (found.samples - 3.5) * 2 * -np.log(unexplained)
    assert found.log10_chance == pytest.approx(chi2.logsf(wilks, 4) / np.log(10.0), rel=1e-3)


def test_a_correlation_is_below_one_even_where_rounding_would_have_it_above() -> None:
    wholly = []
    for seed in range(40):
        y = smooth(seed, 240)
        both = FilteredPass(0, np.stack([y, y]), 0.5)  # R says nothing that y does not
        found = agreement(both, both, 0.0, 30.0, ScreeningParameters())
        assert np.isfinite(found.log10_chance)
        wholly.append(found.correlation)
    assert max(wholly) ** 2 == pytest.approx(1.0 - 1e-12, abs=1e-13)
    assert min(wholly) == pytest.approx(1.0, abs=1e-3)


def test_eight_independent_samples_are_needed() -> None:
    said = set()
    for n in range(40, 100, 6):
        first, second = pair(n, 0, 1.0)
        found = agreement(first, second, 0.0, 1.0, ScreeningParameters())
        expected = by_hand(first.signals, second.signals, 0, 0, 0.5)
        assert near(found, expected if expected.samples >= 8.0 else NOTHING)
        said |= {"few"} if 5.0 < expected.samples < 8.0 else set()
        said |= {"enough"} if 8.0 <= expected.samples < 11.0 else set()
    assert said == {"few", "enough"}


def test_long_stretches_are_compared_in_three_pieces_of_a_kilometre() -> None:
    assert _pieces(2000, 1.0, ScreeningParameters()) == [slice(0, 2000)]
    assert _pieces(2001, 1.0, ScreeningParameters()) == [slice(0, 1000), slice(500, 1500), slice(1001, 2001)]
    assert _pieces(4000, 0.5, ScreeningParameters()) == [slice(0, 4000)]
    assert _pieces(5000, 0.5, ScreeningParameters()) == [slice(0, 2000), slice(1500, 3500), slice(3000, 5000)]


def test_of_three_pieces_neither_the_best_nor_the_worst_counts() -> None:
    one = pair(4200, 3, 1.0, step=1.0)
    for order in itertools.permutations((0.2, 1.5, 6.0)):
        noise = np.concatenate([np.full(1400, size) for size in order])
        second = FilteredPass(300, one[1].signals + noise * np.stack([smooth(8, 4200), smooth(9, 4200)]), 1.0)
        parts = [slice(0, 1000), slice(1600, 2600), slice(3200, 4200)]
        pieces = [[FilteredPass(0, item.signals[:, part], 1.0) for item in (one[0], second)] for part in parts]
        by_piece = [agreement(*piece, 40.0, 30.0, ScreeningParameters()) for piece in pieces]
        usual = sorted(by_piece, key=lambda item: item.log10_chance)[1]
        found = agreement(replace(one[0], first=300), second, 40.0, 30.0, ScreeningParameters())
        assert found.log10_chance == usual.log10_chance
        middle = by_piece[1]
        assert found.shift == (middle.shift if middle.log10_chance <= usual.log10_chance else usual.shift)


S = np.arange(0.0, 400.0, 2.0)


def track(alignment: FloatArray, cutoff: float = np.inf) -> TrackAlignment:
    n = len(S)
    zero = np.zeros(n)
    return TrackAlignment(
        "S", 1, S, alignment, zero + 1e-4, zero, zero, np.ones(n, dtype=np.int64), Status.ESTIMATED,
        cutoff_wavelength=cutoff,
    )  # fmt: skip


def a_pass(n: int, side: int = 1) -> Pass:
    return Pass(ProfileLife("W"), "V", 0, 7.3 + np.arange(n) * 1.0, smooth(1, n), smooth(2, n), side)


def test_a_pass_is_filtered_where_the_filter_fits_and_needs_twice_its_length() -> None:
    weights = local_cubic_kernel(30.0, 1.0)
    k = len(weights)
    assert filter_pass(a_pass(2 * k + 1), 30.0, 1.0) is None
    item = a_pass(2 * k + 2, side=-1)
    found = filter_pass(item, 30.0, 1.0)
    assert found is not None
    grid = np.arange(8, 8 + 2 * k + 1) * 1.0
    y, R = (np.interp(grid, item.at, values) for values in (item.displacement, -item.difference))
    expected = np.stack([one[k // 2 : -(k // 2)] - np.convolve(one, weights, "valid") for one in (y, R)])
    assert found.first == 8 + k // 2
    np.testing.assert_allclose(found.signals, expected, atol=1e-9)


def test_the_longest_known_stretch_of_an_alignment_is_taken() -> None:
    d = smooth(3, len(S))
    d[[20, 150]] = np.nan
    found = alignment_segment(track(d, cutoff=120.0), 0, 390, 30.0, 1.0)
    assert found is not None
    assert (found.first, found.last) == (42, 298)
    at = np.arange(42.0, 299.0)
    known = np.isfinite(d)
    np.testing.assert_allclose(found.signals[0], np.interp(at, S[known], d[known]))
    fine = alignment_segment(track(d, cutoff=120.0), 0, 780, 30.0, 0.5)
    assert fine is not None
    assert (fine.first, fine.last, fine.step) == (84, 596, 0.5)
    raw = alignment_segment(track(d), 0, 390, 30.0, 1.0)
    assert raw is not None
    weights = local_cubic_kernel(30.0, 1.0)
    reach = len(weights) // 2
    whole = np.interp(at, S[known], d[known])
    assert raw.first == 42 + reach
    np.testing.assert_allclose(raw.signals[0], whole[reach:-reach] - np.convolve(whole, weights, "valid"), atol=1e-9)
    assert alignment_segment(track(d), 60, 60 + 2 * len(weights) - 1, 30.0, 1.0) is None
    assert alignment_segment(track(d), 60, 60 + 2 * len(weights), 30.0, 1.0) is not None
    beyond = alignment_segment(track(d, cutoff=120.0), 250, 600, 30.0, 1.0)
    assert beyond is not None
    assert (beyond.first, beyond.last) == (302, 398)
    assert alignment_segment(track(d, cutoff=120.0), 600, 900, 30.0, 1.0) is None
    lonely = np.where(np.arange(len(S)) == 5, 1.0, np.nan)
    assert alignment_segment(track(lonely, cutoff=120.0), 0, 390, 30.0, 1.0) is None
    two = alignment_segment(track(np.where(np.arange(len(S)) // 2 == 3, d, np.nan), cutoff=120.0), 0, 390, 30.0, 1.0)
    assert two is not None
    assert (two.first, two.last) == (12, 14)


GOOD = Agreement(0.8, -20.0, 0.0, 1.0, 60.0)
LIMITS = ScreeningParameters()


@pytest.mark.parametrize(
    ("changes", "usual", "code"),
    [
        ({}, 1.0, None),
        ({"log10_chance": -6.01}, 1.0, None),
        ({"log10_chance": -5.99}, 1.0, ReasonCode.OTHER_SECTION),
        ({"factor": -0.9}, 1.0, ReasonCode.MIRRORED),
        ({"factor": -0.9}, -1.0, None),
        ({"factor": 0.41}, 1.0, None),
        ({"factor": 0.39}, 1.0, ReasonCode.SCALE_DIFFERS),
        ({"factor": 2.49}, 1.0, None),
        ({"factor": 2.51}, 1.0, ReasonCode.SCALE_DIFFERS),
        ({"factor": 2.51}, 2.0, None),
        ({"factor": 0.41}, 2.0, ReasonCode.SCALE_DIFFERS),
    ],
)
def test_why_two_signals_are_not_of_one_place(changes: dict[str, float], usual: float, code: ReasonCode | None) -> None:
    reason = disagreement(replace(GOOD, **changes), usual, LIMITS, "others")
    assert (None if reason is None else reason.code) is code

"""Irregularities like those of recorded lines: long waves, kurtosis, defects, switches and joints."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import welch

from estimation.errors import ParameterError
from ingest.simulator.irregularity import (
    Isolated,
    IsolatedKind,
    Waves,
    density,
    isolated,
    kurtosis_of,
    periodic,
    superpose,
    with_kurtosis,
)
from ingest.simulator.track import TrackRecipe, make_track

SHORT = Waves("gauge", 1e-3, (3.0, 70.0))
LONG = Waves("alignment", 2e-3, (100.0, 1000.0))


def gauge(seed: int, kurtosis: float, length: float = 4000.0) -> np.ndarray:
    rngs = [np.random.default_rng([seed, part]) for part in range(2)]
    return superpose([SHORT, LONG], rngs, length=length, interval=0.5, kurtosis=kurtosis)


@pytest.mark.parametrize("kurtosis", [4.0, 6.0, 9.0])
def test_kurtosis_of_every_seed_is_that_asked_for_at_the_same_standard_deviation(kurtosis: float) -> None:
    for seed in range(8):
        values = gauge(seed, kurtosis)
        assert kurtosis_of(values) == pytest.approx(kurtosis, rel=0.02)
        assert values.std() == pytest.approx(math.hypot(1e-3, 2e-3), rel=0.03)
        assert abs(values.mean()) < 1e-12


def test_kurtosis_keeps_the_spectrum() -> None:
    seeds = range(12)
    expected, found = (
        np.mean([welch(gauge(seed, kurtosis), 2.0, nperseg=4096)[1] for seed in seeds], axis=0)
        for kurtosis in (3.0001, 9.0)  # 3 itself has other phases
    )
    wavelength = 0.5 * 4096 / np.arange(1, 2049)
    for short, long in pairwise([3.5, 5.0, 9.0, 20.0, 60.0, 120.0, 300.0, 900.0]):
        inside = np.flatnonzero((wavelength >= short) & (wavelength < long)) + 1
        assert found[inside].sum() == pytest.approx(expected[inside].sum(), rel=0.1)


def test_a_period_keeps_the_amplitude_of_every_line() -> None:
    period = periodic("alignment", 3000, 0.5, (3.0, 70.0), np.random.default_rng(1))
    changed = with_kurtosis(period, 3000, 6.0)
    lines = np.abs(np.fft.rfft(period))
    np.testing.assert_allclose(np.abs(np.fft.rfft(changed)), lines, atol=1e-9 * lines.max())
    assert np.abs(np.corrcoef(changed, period)[0, 1]) > 0.5


def test_a_kurtosis_that_cannot_be_made_is_refused() -> None:
    few_waves = np.sin(np.linspace(0.0, 6.0 * np.pi, 900, endpoint=False))
    with pytest.raises(ParameterError, match="cannot be made: too few waves") as refused:
        with_kurtosis(few_waves, 900, 6.0)
    assert refused.value.field == "kurtosis"
    recipe = TrackRecipe(
        length=1000.0, gauge_std=0.0, long_gauge=Waves("alignment", 2e-3, (400.0, 900.0)), gauge_kurtosis=9
    )
    with pytest.raises(ParameterError) as named:
        make_track(recipe, np.random.SeedSequence(1))
    assert named.value.field == "section.gauge_kurtosis"


def test_long_waves_of_gauge_leave_the_rest_of_the_track_as_it_is() -> None:
    plain = TrackRecipe(length=3000.0, gauge_std=1e-3)
    long = TrackRecipe(length=3000.0, gauge_std=1e-3, long_gauge=LONG)
    without, with_long = (make_track(recipe, np.random.SeedSequence(3)) for recipe in (plain, long))
    np.testing.assert_array_equal(with_long.alignment, without.alignment)
    added = with_long.gauge_deviation - without.gauge_deviation
    assert added.std() == pytest.approx(2e-3, rel=1e-9)
    per_metre, power = welch(added, 4.0, nperseg=8192, detrend=False)
    assert power[per_metre > 1.0 / 80.0].sum() < 1e-3 * power.sum()
    assert density("alignment", np.array([2 * np.pi / 900.0])) > density("alignment", np.array([2 * np.pi / 120.0]))


def test_isolated_irregularities_have_their_place_length_and_size() -> None:
    s = 0.25 * np.arange(4001)
    defect = Isolated(IsolatedKind.DEFECT, 12.0, 4e-3, -1e-3, at=(300.0,))
    switch = Isolated(IsolatedKind.SWITCH, 20.0, 2e-3, -3e-3, at=(600.0,))
    joint = Isolated(IsolatedKind.JOINT, 4.0, 1e-3, 0.0, at=(900.0,))
    alignment, wide = isolated([defect, switch, joint], s, [np.random.default_rng(0)] * 3)
    for at, length, height in ((300.0, 12.0, 4e-3), (600.0, 20.0, 2e-3), (900.0, 4.0, 1e-3)):
        assert alignment[s == at] == pytest.approx(height)
        near = np.abs(s - at) < 0.5 * length
        assert np.abs(alignment[(np.abs(s - at) < 30.0) & ~near]).max() < 1e-9
    assert wide[s == 300.0] == pytest.approx(-1e-3)
    np.testing.assert_allclose(wide[np.abs(s - 600.0) <= 5.0], -3e-3)
    # a kink: the slope changes at once from rise to fall
    slope = np.diff(alignment[(s >= 899.5) & (s <= 900.5)]) / 0.25
    assert slope[1] > 4e-4
    assert slope[2] < -4e-4


def test_isolated_irregularities_are_drawn_at_their_rate_to_both_sides() -> None:
    s = 0.5 * np.arange(80_001)
    defects = Isolated(IsolatedKind.DEFECT, 8.0, 5e-3, 2e-3, per_metre=1e-3)
    alignment, wide = isolated([defects], s, [np.random.default_rng(4)])
    peaks = np.flatnonzero((wide[1:-1] > wide[:-2]) & (wide[1:-1] >= wide[2:]) & (wide[1:-1] > 0.5e-3)) + 1
    assert len(peaks) == pytest.approx(40, abs=15)
    assert {float(side) for side in np.sign(alignment[peaks])} == {-1.0, 1.0}
    assert wide.min() >= 0.0
    assert np.ptp(wide[peaks]) > 1e-3


def test_irregularities_stand_where_the_section_counts_from() -> None:
    defect = Isolated(IsolatedKind.DEFECT, 12.0, 4e-3, 0.0, at=(100.0,))
    track = make_track(
        TrackRecipe(length=900.0, alignment_std=0.0, isolated=(defect,), begin=-200.0), np.random.SeedSequence(1)
    )
    assert track.s[0] == -200.0
    assert track.s[np.argmax(track.alignment)] == 100.0

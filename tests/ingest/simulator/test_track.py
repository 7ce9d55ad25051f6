"""Track irregularities against their spectra, and recorded tracks from files, good and bad."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
from scipy.signal import welch

from estimation.errors import ParameterError, ScenarioError
from ingest.simulator.irregularity import (
    CRITICAL_WAVENUMBER,
    LOW_WAVENUMBER,
    Irregularity,
    density,
    synthesise,
)
from ingest.simulator.track import TrackRecipe, make_track, read_track, write_track


def standard_deviation(kind: Irregularity, wavelengths: tuple[float, float]) -> float:
    """Return the standard deviation of the density over a band, m."""
    shortest, longest = wavelengths
    band = 2.0 * math.pi / longest, 2.0 * math.pi / shortest
    variance, _ = scipy.integrate.quad(lambda w: float(density(kind, np.array(w))), *band)
    return math.sqrt(variance)


@pytest.mark.parametrize("kind", ["alignment", "gauge"])
def test_spectrum_of_a_long_track_has_the_form_of_the_formula(kind: Irregularity) -> None:
    interval, band = 0.5, (3.0, 70.0)
    values = synthesise(
        kind, length=60_000.0, interval=interval, target_std=2e-3, wavelengths=band, rng=np.random.default_rng(4)
    )
    assert values.std() == pytest.approx(2e-3, rel=1e-12)
    assert abs(values.mean()) < 1e-12
    per_metre, power = welch(values, 1.0 / interval, nperseg=4096)
    wavenumber, measured = 2.0 * math.pi * per_metre, power / (2.0 * math.pi)
    expected = (2e-3 / standard_deviation(kind, band)) ** 2 * density(kind, wavenumber)
    edges = np.geomspace(2.0 * math.pi / 60.0, 2.0 * math.pi / 3.5, 9)
    for low, high in pairwise(edges):
        inside = (wavenumber >= low) & (wavenumber < high)
        assert measured[inside].mean() == pytest.approx(expected[inside].mean(), rel=0.12)
    outside = (wavenumber > 2.0 * math.pi / 2.8) | (wavenumber < 2.0 * math.pi / 90.0)
    assert measured[outside].max() < 0.02 * expected[np.argmin(np.abs(wavenumber - 0.1))]


def test_standard_deviation_of_the_alignment_is_the_integral_in_closed_form() -> None:
    a, b, level = LOW_WAVENUMBER, CRITICAL_WAVENUMBER, 2.119e-7

    def primitive(w: float) -> float:
        return level * b**2 / (b**2 - a**2) * (math.atan(w / a) / a - math.atan(w / b) / b)

    variance = primitive(2.0 * math.pi / 3.0) - primitive(2.0 * math.pi / 70.0)
    assert standard_deviation("alignment", (3.0, 70.0)) == pytest.approx(math.sqrt(variance), rel=1e-9)


def test_a_seed_gives_one_track_and_gauge_does_not_follow_alignment() -> None:
    recipe = TrackRecipe(length=3000.0, gauge_std=1e-3, gauge_offset=2e-3)
    first, again, other = (make_track(recipe, np.random.SeedSequence(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.alignment, again.alignment)
    assert np.abs(np.corrcoef(first.alignment, other.alignment)[0, 1]) < 0.2
    assert np.abs(np.corrcoef(first.alignment, first.gauge_deviation)[0, 1]) < 0.2
    assert first.gauge_deviation.mean() == pytest.approx(2e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wavelengths": (0.9, 70.0)}, "cannot carry"),
        ({"length": 50.0}, "shorter than the longest"),
    ],
)
def test_impossible_recipes_are_refused(change: dict[str, float], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        make_track(TrackRecipe(**{"length": 1000.0, **change}), np.random.SeedSequence(1))  # type: ignore[arg-type]


def test_a_written_track_is_read_back(tmp_path: Path) -> None:
    track = make_track(TrackRecipe(length=500.0, gauge_std=1e-3), np.random.SeedSequence(5))
    write_track(tmp_path / "track.csv", track)
    read = read_track(tmp_path / "track.csv")
    np.testing.assert_allclose(read.s, track.s, atol=1e-9)
    np.testing.assert_allclose(read.alignment, track.alignment, atol=1e-9)
    np.testing.assert_allclose(read.gauge_deviation, track.gauge_deviation, atol=1e-9)


def test_an_uneven_track_is_resampled_on_its_own_curve(tmp_path: Path) -> None:
    s = np.cumsum(np.random.default_rng(6).uniform(0.3, 0.7, 600))
    rows = [f"x,{1e3 * 2e-3 * math.sin(at / 5.0):.9f},{at:.9f},0.0" for at in s]
    path = tmp_path / "uneven.csv"
    path.write_text("\n".join(["note, alignment_mm, s_m, gauge_deviation_mm", *rows]) + "\n")
    track = read_track(path)
    assert track.interval == pytest.approx(np.median(np.diff(s)))
    np.testing.assert_allclose(track.alignment, 2e-3 * np.sin(track.s / 5.0), atol=2e-6)


GOOD_ROWS = [f"{0.5 * i},0.1,0.0" for i in range(12)]


@pytest.mark.parametrize(
    ("line", "text", "field"),
    [
        (1, "s_m,alignment_mm,gauge", "gauge_deviation_mm"),
        (4, "1.0,nan,0.0", "alignment_mm"),
        (4, "1.0,0.1", "gauge_deviation_mm"),
        (4, "1.0,a,0.0", "alignment_mm"),
        (4, "0.5,0.1,0.0", "s_m"),
        (4, ",0.1,0.0", "s_m"),
    ],
)
def test_bad_track_files_name_line_and_column(tmp_path: Path, line: int, text: str, field: str) -> None:
    lines = ["s_m,alignment_mm,gauge_deviation_mm", *GOOD_ROWS]
    lines[line - 1] = text
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(ScenarioError) as refused:
        read_track(path)
    assert (refused.value.file, refused.value.line, refused.value.field) == (str(path), line, field)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00bin", b"s_m,alignment_mm,gauge_deviation_mm\n0,0,0\n"])
def test_a_file_that_is_no_track_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "none.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ScenarioError, match=r"none\.csv"):
        read_track(path)

"""From windows to signatures: places, directions, wavelengths, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bench.signature_cases import Wheelset, tracks, wheelset, window_of, window_parameters
from estimation.signatures.window_signatures import SignatureParameters, band_spectra, window_signatures
from estimation.values.arrays import FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import Place, Signature
from estimation.values.track import TrackLayout
from estimation.values.windows import Window

PARAMETERS = SignatureParameters()


@pytest.fixture(scope="module")
def runner() -> Wheelset:
    return wheelset("W", 0.5e-3, 2, np.random.default_rng(3))


@pytest.fixture(scope="module")
def window(runner: Wheelset) -> Window:
    (track,) = tracks(1, 0).values()
    return window_of(runner, "S0", track, 18.0, np.random.default_rng(4))


def found(window: Window, layout: TrackLayout | None = None) -> tuple[Signature, ...]:
    signatures = window_signatures(window, window_parameters(), PARAMETERS, layout)
    assert not isinstance(signatures, Reason)
    return signatures


def reason(window: Window, layout: TrackLayout | None = None) -> ReasonCode:
    refused = window_signatures(window, window_parameters(), PARAMETERS, layout)
    assert isinstance(refused, Reason)
    return refused.code


def test_every_place_that_was_passed_whole_has_a_signature(window: Window) -> None:
    first, last = float(window.distance[0]), float(window.distance[-1])
    size = PARAMETERS.cell
    whole = [k for k in range(20) if first + 10 < k * size and (k + 1) * size < last - 10]
    assert [one.place for one in found(window)] == [Place("S0", k) for k in whole]
    assert len(whole) == 10
    assert [one.order for one in found(window)] == list(range(10))


def test_a_run_against_the_section_has_the_same_places_and_nearly_the_same_powers(window: Window) -> None:
    """A mirrored time axis is a vehicle that runs the other way over the same motion: rates change their sign."""
    names = ("lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration", "speed")
    other = replace(window, distance=window.distance[::-1], **{name: getattr(window, name) for name in names})
    there, back = found(window), found(other)
    assert {one.place for one in there} == {one.place for one in back}
    # the stretch that was run first is now the last of the section
    assert [one.place.cell for one in back if one.place] == sorted(one.place.cell for one in there if one.place)
    total = [np.mean([one.powers for one in group], axis=0) for group in (there, back)]
    np.testing.assert_allclose(total[0], total[1], atol=0.3)


def test_without_section_or_position_signatures_have_no_place(window: Window) -> None:
    for unknown in (
        replace(window, track_section=None),
        replace(
            window, quality=replace(window.quality, position_quality=0.0), distance=np.full(len(window.valid), np.nan)
        ),
    ):
        signatures = found(unknown)
        assert {one.place for one in signatures} == {None}
        assert len(signatures) >= 8
        placed = np.mean([one.powers for one in found(window)], axis=0)
        np.testing.assert_allclose(np.mean([one.powers for one in signatures], axis=0), placed, atol=0.5)


def test_the_peak_is_near_the_wavelength_of_klingel(window: Window) -> None:
    peaks = [one.peak_wavelength for one in found(window)]
    assert all(5.0 < peak < 25.0 for peak in peaks)  # 2 pi sqrt(r0 l / gamma) is 7 m at 0.4, 11.5 m at 0.1


def test_a_gap_ends_a_stretch(window: Window) -> None:
    valid = window.valid.copy()
    at = int(np.searchsorted(window.distance, 1250.0))
    valid[at : at + 200] = False
    values = np.where(valid, window.lateral_acceleration, np.nan)
    left = found(replace(window, valid=valid, lateral_acceleration=values))
    assert Place("S0", int(1250.0 // PARAMETERS.cell)) not in {one.place for one in left}
    assert Place("S0", 8) in {one.place for one in left}


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"sensor_fault": True}, ReasonCode.SENSOR_FAULT),
        ({"coverage": 0.2}, ReasonCode.TOO_FEW_SAMPLES),
        ({"clipped": 0.2}, ReasonCode.CLIPPED),
    ],
)
def test_windows_of_poor_quality_are_refused(window: Window, change: dict[str, float], code: ReasonCode) -> None:
    assert reason(replace(window, quality=replace(window.quality, **change))) is code


def test_a_signal_that_does_not_move_gives_no_signature(window: Window) -> None:
    """Its power is zero, which has no logarithm."""
    still = np.zeros(len(window.valid))
    quiet = replace(window, roll_acceleration=still)
    assert reason(quiet) is ReasonCode.NOT_FINITE


def test_standing_short_curved_and_reversed_windows_are_refused(window: Window) -> None:
    n = len(window.valid)
    assert reason(replace(window, speed=np.full(n, 1.0))) is ReasonCode.NOT_MOVING
    assert reason(replace(window, valid=np.arange(n) < 12 * 250)) is ReasonCode.PASS_TOO_SHORT
    assert reason(replace(window, yaw_acceleration=-window.yaw_acceleration)) is ReasonCode.AXES_REVERSED
    s = np.linspace(0.0, 4000.0, 401)
    assert reason(window, TrackLayout("S0", 1, s, np.full(401, 1e-3), np.zeros(401))) is ReasonCode.IN_CURVES
    curved = window.lateral_acceleration + np.where(np.arange(n) > n // 2, 0.5, 0.0)
    assert reason(replace(window, lateral_acceleration=curved)) is ReasonCode.CURVE_DETECTED


def slow_spectra(signals: FloatArray) -> FloatArray:
    """Return band spectra by sums over samples, block by block: slow and plain."""
    size, step = round(PARAMETERS.block / PARAMETERS.step), PARAMETERS.step
    ends = 1.0 / np.array(PARAMETERS.wavelengths)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / (size - 1))
    starts = list(range(0, signals.shape[1] - size + 1, size // 2))
    rows = []
    for low, high in pairwise(ends):
        lines = [k for k in range(size // 2 + 1) if low <= k / (size * step) < high]
        matrix = np.zeros((3, 3), dtype=complex)
        for start in starts:
            block = signals[:, start : start + size]
            t = np.arange(size)
            flat = np.stack([row - np.polyval(np.polyfit(t, row, 1), t) for row in block]) * window
            for k in lines:
                waves = flat @ np.exp(-2j * np.pi * k * t / size)
                matrix += np.outer(waves, waves.conj())
        matrix *= step / (len(lines) * len(starts) * np.sum(window**2))
        rows.append(
            [matrix[i, i].real for i in range(3)]
            + [part for i, k in ((0, 1), (0, 2), (1, 2)) for part in (matrix[i, k].real, matrix[i, k].imag)]
        )
    return np.array(rows)


def test_spectra_are_those_of_plain_sums() -> None:
    signals = np.random.default_rng(0).standard_normal((3, 1200)).cumsum(axis=1)
    spectra, _ = band_spectra(signals, PARAMETERS)
    np.testing.assert_allclose(spectra, slow_spectra(signals), rtol=1e-9)


def test_a_wave_is_in_its_band_and_at_its_wavelength() -> None:
    s = np.arange(2000) * PARAMETERS.step
    wave = np.sin(2 * np.pi * s / 9.0)
    spectra, peak = band_spectra(np.stack([wave, wave, wave]), PARAMETERS)
    band = next(k for k in range(PARAMETERS.bands) if PARAMETERS.wavelengths[k] > 9.0 > PARAMETERS.wavelengths[k + 1])
    assert np.argmax(spectra[:, 1]) == band
    assert peak == pytest.approx(9.0, rel=0.05)

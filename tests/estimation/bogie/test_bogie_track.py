"""The alignment of a section from coaches' bogies alone, against the truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bogie_case import CLASS, runs
from scipy.interpolate import CubicSpline
from smooth_wheelset import track

from estimation.bogie.fit import Beforehand
from estimation.bogie.parameters import BOGIE_TRACK
from estimation.bogie.signals import BogieRun
from estimation.bogie.track import BogieAndRun, FoundAlignment, alignment_of_bogies
from estimation.values.reasons import Reason

SEED, LENGTH = 1, 2048.0
BOGIES = ((0.06, 0.16), (0.12, 0.08), (0.2, 0.1))


def _against(run: BogieRun) -> BogieRun:
    """Return the run of a bogie that goes the other way, over the section as it is seen from there."""
    return replace(run, place=LENGTH - run.place, facing=-1)


@cache
def _runs() -> list[BogieAndRun]:
    flat = []
    for bogie, cones in enumerate(BOGIES):
        for draw in range(2):
            own = runs(1, SEED, cones=cones, noise_seed=10 * bogie + draw)
            flat += [(bogie, run.over(np.zeros_like(run.ahead))) for _, run in own]
    return flat


def _found(given: list[BogieAndRun]) -> FoundAlignment:
    known = [Beforehand.of(CLASS)] * len(BOGIES)
    found = alignment_of_bogies(known, given, LENGTH)
    assert not isinstance(found, Reason)
    return found


def _error(found: FoundAlignment) -> np.ndarray:
    """Return the error (n,), m, of waves of 8 to 35 m where the alignment is known, at the place that fits best."""
    of, inside = track(SEED), np.isfinite(found.alignment)
    spline = CubicSpline(of.s, of.alignment)

    def band(values: np.ndarray) -> np.ndarray:
        spectrum = np.fft.rfft((values - values.mean()) * np.hanning(len(values)))
        wave = np.fft.rfftfreq(len(values), 0.25)
        return np.fft.irfft(np.where((wave > 1 / 35) & (wave < 1 / 8), spectrum, 0.0), len(values))

    ours = band(found.alignment[inside])
    errors = [ours - band(spline(found.place[inside] + shift)) for shift in np.arange(-2.0, 2.01, 0.05)]
    return min(errors, key=lambda error: float(error @ error))


@pytest.mark.slow
def test_bogies_find_the_track_that_they_run_over() -> None:
    found = _found(_runs())
    assert np.isfinite(found.alignment).mean() > 0.2
    assert found.moved < BOGIE_TRACK.most_moved
    error = float(np.sqrt(np.mean(_error(found) ** 2) / np.mean(np.hanning(100) ** 2)))
    assert error < 0.15e-3
    assert 0.3 * error < np.nanmedian(found.std) < 10.0 * error


@pytest.mark.slow
def test_a_run_the_other_way_is_one_over_the_mirrored_section() -> None:
    along = _found(_runs())
    against = _found([(bogie, _against(run)) for bogie, run in _runs()])
    both = np.isfinite(along.alignment[::-1]) & np.isfinite(against.alignment[: len(along.alignment)])
    assert both.any()
    difference = (along.alignment[::-1] + against.alignment)[both]
    assert np.sqrt(np.mean(difference**2)) < 0.1 * np.nanstd(along.alignment)

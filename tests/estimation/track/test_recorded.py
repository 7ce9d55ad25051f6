"""A surveyed alignment with a mistake in it is detected by what the fleet has measured; a correct one is accepted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.filters import high_pass, local_cubic_kernel
from estimation.track.survey_check import check_survey
from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource, TrackAlignment
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track

LENGTH, STEP, CUT_OFF = 4000.0, 0.5, 30.0
FLEET_STD = 0.07e-3


def truth(seed: int) -> TrackTruth:
    return make_track(TrackRecipe(length=LENGTH, alignment_std=2e-3), np.random.SeedSequence(seed))


def lying(s: np.ndarray, d: np.ndarray, std: float) -> TrackAlignment:
    zero = np.zeros(len(s))
    return TrackAlignment(
        "S", 1, s, d, np.full(len(s), std), zero, zero, np.zeros(len(s), dtype=np.int64), Status.ESTIMATED
    )


def fleet(seed: int, *, offset: float = 0.0, stretch: float = 0.0) -> TrackAlignment:
    """Return what a fleet would find: high-passed, a little too small, with smooth errors, NaN at its ends."""
    rng = np.random.default_rng(seed)
    track, grid = truth(seed), np.arange(0.0, LENGTH, STEP)
    weights = local_cubic_kernel(CUT_OFF, STEP)
    error = np.convolve(rng.standard_normal(len(grid)), np.hanning(17), mode="same")
    place = grid + offset + stretch * (grid - LENGTH / 2)
    d = high_pass(np.stack([np.interp(place, track.s, track.alignment), error]), weights)
    measured = 0.98 * d[0] + FLEET_STD * d[1] / d[1].std()
    reach = len(weights) // 2
    measured[:reach] = measured[-reach:] = np.nan
    return replace(lying(grid, measured, FLEET_STD), source=AlignmentSource.FLEET, cutoff_wavelength=CUT_OFF)


def recording(seed: int, std: float, spacing: float = 0.25) -> TrackAlignment:
    rng, track = np.random.default_rng(seed + 500), truth(seed)
    s = np.arange(0.0, LENGTH, spacing)
    return lying(s, np.interp(s, track.s, track.alignment) + std * rng.standard_normal(len(s)), std)


@pytest.mark.parametrize("std", [0.05e-3, 0.5e-3])
@pytest.mark.parametrize("spacing", [0.25, 1.0])
def test_correct_surveys_are_accepted_wherever_the_fleet_is_within_its_position_std(std: float, spacing: float) -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        found = fleet(seed, offset=rng.uniform(-2, 2), stretch=rng.uniform(-3e-4, 3e-4))
        verdict = check_survey(recording(seed, std, spacing), found)
        assert verdict.usable, (seed, verdict)
        assert verdict.scale == pytest.approx(1.0, abs=0.06)
        assert verdict.sign == 1


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1e3, "millimetres were taken for metres"), (1e-3, "metres were taken for millimetres"),
     (25.4, "taken for inches"), (1 / 25.4, "inches were taken for millimetres"), (2.0, "it is 2.")],
)  # fmt: skip
@pytest.mark.parametrize("of_std", [False, True])
def test_a_wrong_unit_is_named(factor: float, said: str, *, of_std: bool) -> None:
    for seed in range(3):
        good = recording(seed, 0.05e-3)
        std = good.alignment_std * (factor if of_std else 1.0)
        verdict = check_survey(replace(good, alignment=factor * good.alignment, alignment_std=std), fleet(seed))
        assert not verdict.usable
        assert said in str(verdict.reason)
        assert verdict.scale == pytest.approx(factor, rel=0.05)


@pytest.mark.parametrize("shift", [10.0, -10.0, 4.5])
def test_a_shifted_recording_is_found_and_measured(shift: float) -> None:
    for seed in range(4):
        good = recording(seed, 0.1e-3)
        verdict = check_survey(replace(good, s=good.s + shift), fleet(seed))
        assert not verdict.usable
        assert f"{abs(verdict.shift):.1f} m too far {'along' if shift > 0 else 'back'}" in str(verdict.reason)
        assert verdict.shift == pytest.approx(-shift, abs=0.3)
        excused = check_survey(replace(good, s=good.s + shift), fleet(seed), place_std=4.0)
        assert excused.usable  # a fleet that does not know its own place cannot say


def place_std(journeys: int, reach: float = 20.0) -> float:
    """Return the position std of so many journeys, whose positions are off by up to ``reach`` m, alike."""
    return reach / np.sqrt(3.0) / np.sqrt(journeys)


@pytest.mark.parametrize(
    ("journeys", "fleet_off", "found"),
    [
        (12, 0.0, False),  # 13 m are tolerated
        (20, 0.0, False),
        (30, 0.0, True),
        (70, 0.0, True),
        (70, -2.0, True),  # also where the fleet as a whole is two of its standard deviations off
        (70, 2.0, True),
    ],
)
def test_with_uncertain_positions_a_shift_of_10_m_takes_many_journeys_to_be_found(
    journeys: int, fleet_off: float, *, found: bool
) -> None:
    """The limit, stated in docs/sections.md: 3 m + 3 std / sqrt(n); 25 journeys at +-20 m, 70 to be nearly sure."""
    for seed in range(3):
        good = recording(seed, 0.1e-3)
        off = fleet_off * place_std(journeys)
        verdict = check_survey(replace(good, s=good.s + 10.0), fleet(seed, offset=off), place_std=place_std(journeys))
        assert verdict.usable is not found
        assert ("too far along" in str(verdict.reason)) is found


def test_mirrored_and_foreign_recordings_are_refused() -> None:
    for seed in range(6):
        good, found = recording(seed, 0.05e-3), fleet(seed)
        mirrored = check_survey(replace(good, alignment=-good.alignment), found)
        assert not mirrored.usable
        assert mirrored.sign == -1
        assert "mirror image" in str(mirrored.reason)
        for other in (recording(seed + 50, 0.05e-3), replace(good, alignment=good.alignment[::-1])):
            verdict = check_survey(other, found)
            assert not verdict.usable
            assert "no more in common" in str(verdict.reason)


def test_a_fleet_that_knows_too_little_says_nothing_against_a_recording() -> None:
    found = fleet(1)
    few = replace(found, alignment=np.where(np.arange(len(found.s)) < 300, found.alignment, np.nan))
    none = replace(found, alignment=np.full(len(found.s), np.nan))
    elsewhere = replace(recording(1, 1e-4), s=recording(1, 1e-4).s + 1e5)
    for verdict in (
        check_survey(recording(1, 1e-4), few), check_survey(recording(1, 1e-4), none),
        check_survey(elsewhere, found),
    ):  # fmt: skip
        assert verdict.usable
        assert verdict.sign == 0
        assert "does not know enough" in str(verdict.reason)

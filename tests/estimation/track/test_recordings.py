"""A recorded gauge that varies: the recording is kept, and what its gauge does to wheelsets is found on it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from gauge_passes import LENGTH, Section, Wheels, passes, section

from estimation.track.panel.basis import PanelParameters
from estimation.track.passes import ProfileLife
from estimation.track.settings import AlignmentSettings, SectionParameters
from estimation.track.update import AlignmentUpdate, UpdateOutcome, update_alignment
from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord

RECORD = TrackSectionRecord("S", 1, "Section", "56E1", 0.05, 1.435, LENGTH)
SETTINGS = AlignmentSettings(section=SectionParameters(panel=PanelParameters(basis_count=21)))
CONES = {ProfileLife("A", 0, 0): 0.16, ProfileLife("B", 0, 0): 0.08, ProfileLife("C", 0, 0): 0.12}


def recording(place: Section, gauge_std: float = 0.1e-3) -> TrackAlignment:
    zero = np.zeros(len(place.s))
    return TrackAlignment(
        "S", 1, place.s, place.alignment, zero + 0.05e-3, place.gauge, zero + gauge_std, zero.astype(np.int64),
        Status.ESTIMATED,
    )  # fmt: skip


@cache
def first(gauge_std: float) -> AlignmentUpdate:
    place = section(gauge_std)
    return update_alignment(RECORD, passes(place, CONES, 3), recording(place), SETTINGS, survey_checked=True)


def test_the_gauge_shift_of_wheelsets_is_found_on_a_surveyed_gauge() -> None:
    place = section(1e-3)
    found = first(1e-3)
    assert found.outcome is UpdateOutcome.SURVEY_EXTENDED
    first_version = found.alignment
    assert first_version is not None
    assert first_version.source == AlignmentSource.RECORDED
    np.testing.assert_array_equal(first_version.alignment, place.alignment)
    np.testing.assert_array_equal(first_version.gauge_deviation, place.gauge)
    assert first_version.findings is not None
    rng = np.random.default_rng(1)
    x, e = 1.5e-3 * rng.standard_normal(400), 1e-3 * rng.standard_normal(400)
    everywhere = np.linspace(-9e-3, 9e-3, 2001)
    for name, cone in CONES.items():
        wheels = Wheels(cone)
        R = wheels.difference(x, e)
        true = x - np.interp(R, wheels.difference(everywhere, np.zeros(2001)), everywhere)
        shift = first_version.findings.gauge_shifts[name.wheelset].at(R, e)
        assert (shift - true).var() < 0.5 * true.var(), name


def test_the_same_again_makes_no_version_and_a_turned_wheelset_makes_one() -> None:
    place, first_version = section(1e-3), first(1e-3).alignment
    assert first_version is not None
    again = update_alignment(
        RECORD, passes(place, CONES, 3, seed=7), replace(first_version, version=2), SETTINGS, survey_checked=True
    )
    assert again.outcome is UpdateOutcome.SURVEY_KEPT
    assert again.alignment is not None
    turned = {ProfileLife("A", 1, 0): 0.05, ProfileLife("B", 0, 0): 0.08, ProfileLife("C", 0, 0): 0.12}
    other = update_alignment(
        RECORD, passes(place, turned, 3, seed=8), replace(first_version, version=2), SETTINGS, survey_checked=True
    )
    assert other.outcome is UpdateOutcome.SURVEY_EXTENDED


def test_a_gauge_on_file_that_does_not_vary_changes_nothing() -> None:
    found = first(0.0)
    assert found.outcome is UpdateOutcome.SURVEY_KEPT
    assert found.alignment is not None
    assert found.alignment.findings is None

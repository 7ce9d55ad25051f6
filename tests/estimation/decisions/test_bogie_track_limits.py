"""When the alignment that stiff bogies find of a section is used, and when a bogie is estimated on one of the fleet."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from test_section_limits import LENGTH, P, prior, three  # noqa: F401 - a fixture

from estimation.bogie.parameters import BOGIE_TRACK
from estimation.bogie.track import FoundAlignment
from estimation.jobs.steps.bogie_geometry import known_well
from estimation.jobs.steps.bogie_track import updated, with_bogies
from estimation.track.section import SectionEstimate
from estimation.track.settings import AlignmentSettings
from estimation.track.update import AlignmentUpdate, UpdateOutcome
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord

SECTION = TrackSectionRecord("S", 1, "S", "56E1", 0.05, 1.435, float(LENGTH))
SHARE = (40.0 / P.cutoff_wavelength) ** 1.5  # of the std of all waves, in those of the motion


def _update(estimate: SectionEstimate, *, mean_passes: float = 20.0) -> AlignmentUpdate:
    report = replace(estimate.report, mean_passes=mean_passes, reason=Reason(ReasonCode.STIFFNESS_OPEN, "open"))
    return AlignmentUpdate(UpdateOutcome.UNESTIMATED, replace(estimate, alignment=None, report=report), None, ())


def _found(*, std: float = 0.1e-3, moved: float = 0.0) -> FoundAlignment:
    place = np.arange(0.125, LENGTH, 0.25)
    flat = np.ones(len(place))
    return FoundAlignment(place, 1e-3 * np.sin(place / 3.0), std * flat, 6.0 * flat, np.array([0.2, 0.4]), moved)


def _outcome(estimate: SectionEstimate, found: FoundAlignment) -> AlignmentUpdate:
    journeys = [("V0", 5), ("V0", 5)]
    return updated(_update(estimate), SECTION, found, journeys, None, AlignmentSettings().section)


@pytest.mark.parametrize(("std", "used"), [(0.149e-3, True), (0.151e-3, False)])
def test_an_alignment_is_used_that_is_known_to_150_um(three: SectionEstimate, std: float, used: bool) -> None:  # noqa: F811, FBT001
    made = _outcome(three, _found(std=std))
    assert (made.outcome is UpdateOutcome.NEW_VERSION) == used
    assert (made.alignment is not None) == used


@pytest.mark.parametrize(("moved", "used"), [(0.079e-3, True), (0.081e-3, False)])
def test_an_alignment_is_used_that_has_come_to_rest(three: SectionEstimate, moved: float, used: bool) -> None:  # noqa: F811, FBT001
    assert (_outcome(three, _found(moved=moved)).alignment is not None) == used


def test_journeys_are_where_their_runs_were(three: SectionEstimate) -> None:  # noqa: F811
    made = _outcome(three, _found()).estimate
    assert three.iterated is not None
    before = three.iterated.corrections
    assert made.corrections["V0", 5].offset == pytest.approx(before["V0", 5].offset + 0.3)
    assert made.corrections["V1", 5] == before["V1", 5]


def test_nothing_is_tried_with_fewer_than_eight_runs_of_a_place(three: SectionEstimate) -> None:  # noqa: F811
    few = _update(three, mean_passes=2.0 * BOGIE_TRACK.mean_runs - 0.1)
    nobody = cast("Any", None)  # nothing is read
    assert with_bogies(nobody, SECTION, (), nobody, nobody, few, None) is few
    assert BOGIE_TRACK.mean_runs == 8.0


def _of_fleet(std: float) -> TrackAlignment:
    return replace(
        prior(), source=AlignmentSource.FLEET, cutoff_wavelength=120.0, alignment_std=np.full(LENGTH + 1, std)
    )


def test_a_bogie_is_estimated_as_one_on_a_survey_or_where_the_fleet_knows_the_track() -> None:
    assert known_well(replace(prior(), alignment_std=np.full(LENGTH + 1, 1e-3)))
    assert known_well(_of_fleet(0.149e-3 / SHARE))
    assert not known_well(_of_fleet(0.151e-3 / SHARE))
    assert not known_well(None)


def test_what_decides_how_well_an_alignment_of_bogies_is_known_stays() -> None:
    stds = (BOGIE_TRACK.std_factor, BOGIE_TRACK.own_std, BOGIE_TRACK.scale_std, BOGIE_TRACK.wave_std)
    assert stds == (1.5, 0.1e-3, 0.025, 1.3e-3)
    assert (BOGIE_TRACK.fewest_runs, BOGIE_TRACK.held) == (4, 0.15)
    assert (BOGIE_TRACK.start_rounds, BOGIE_TRACK.start_share, BOGIE_TRACK.response_floor) == (4, 0.3, 0.02)
    assert BOGIE_TRACK.bend_stds == tuple(1e-6 * bend for bend in (3, 3, 5, 8, 12, 18, 26, 36, 50, 50, 50, 50, 50))

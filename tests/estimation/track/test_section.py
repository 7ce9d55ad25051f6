"""An epoch of passes and what was known before become an alignment, journeys put where they were."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from smooth_wheelset import alignment as recorded_alignment
from smooth_wheelset import track
from test_panel import PARAMETERS, fleet_passes
from test_positions import OFFSETS, SCALES

from estimation.filters import high_pass, local_cubic_kernel
from estimation.track.passes import Pass
from estimation.track.section import SectionEstimate, estimate_section
from estimation.track.settings import SectionParameters
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import AlignmentSource, Iterated, TrackAlignment

SECTION = SectionParameters(panel=PARAMETERS)


def displaced(passes: tuple[Pass, ...]) -> list[Pass]:
    moved = []
    for item in passes:
        offset, scale = OFFSETS.get(item.vehicle, 0.0), SCALES.get(item.vehicle, 0.0)
        moved.append(replace(item, at=item.at + offset + scale * (item.at - 1000.0)))
    return moved


@cache
def first_version() -> SectionEstimate:
    return estimate_section("S", displaced(fleet_passes()), None, SECTION)


def known(estimate: SectionEstimate) -> TrackAlignment:
    assert estimate.alignment is not None
    return replace(estimate.alignment, version=1)


def error(alignment: TrackAlignment, shift: float = 0.0) -> float:
    """Return the std of the error of an alignment over that of the true one."""
    truth = track(1)
    weights = local_cubic_kernel(alignment.cutoff_wavelength, PARAMETERS.step)
    true = high_pass(np.interp(alignment.s + shift, truth.s, truth.alignment), weights)
    seen = np.isfinite(alignment.alignment) & (alignment.s > 100) & (alignment.s < 1700)
    return float((alignment.alignment - true)[seen].std() / true[seen].std())


def test_positions_and_alignment_converge_together() -> None:
    found = first_version()
    assert found.report.status is Status.ESTIMATED
    assert found.report.converged
    assert found.report.moved_m < SECTION.iteration.position_tolerance
    ended = {one.of: one for one in found.report.convergence}
    assert ended[Iterated.POSITIONS].change == found.report.moved_m
    assert ended[Iterated.STIFFNESS_RATIOS].change < SECTION.iteration.ratio_tolerance
    assert {one.rounds for one in ended.values()} == {found.report.rounds}
    assert found.report.evidence == ()
    assert all(journey.used for journey in found.report.journeys)
    assert known(found).source == AlignmentSource.FLEET
    fleet_offset = np.mean([OFFSETS[c] for c in OFFSETS])  # the position of the fleet as a whole is not known
    assert error(known(found), -fleet_offset) < 0.12
    json.dumps(found.report.as_json(), allow_nan=False)


@pytest.mark.parametrize(
    ("limits", "named", "not_named"),
    [
        ({"ratio_tolerance": 0.0}, "stiffness ratios", "positions"),
        ({"position_tolerance": 0.0}, "positions", "stiffness ratios"),
    ],
)
def test_what_has_not_converged_makes_no_alignment_and_says_so(
    limits: dict[str, float], named: str, not_named: str
) -> None:
    impatient = replace(SECTION, iteration=replace(SECTION.iteration, **limits))  # type: ignore[arg-type] - floats all
    found = estimate_section("S", displaced(fleet_passes()), None, impatient)
    assert (found.report.status, found.alignment, found.corrections) == (Status.UNESTIMATED, None, {})
    assert not found.report.converged
    assert str(found.report.reason).startswith(f"not converged after {found.report.rounds} rounds: {named} still")
    assert not_named not in str(found.report.reason)
    assert first_version().report.reason is None


def test_a_prior_alignment_fixes_the_position_and_more_passes_make_it_no_worse() -> None:
    """The next epoch is elsewhere by its odometers, and is moved to where the last version is."""
    first = known(first_version())
    again = [replace(item, at=item.at + 11.0, start_ns=item.start_ns + 10**15) for item in displaced(fleet_passes())]
    second = estimate_section("S", again, first, SECTION)
    assert second.report.evidence == ("fleet version 1",)
    before = {journey[0]: c for journey, c in first_version().corrections.items()}
    for (vehicle, _), correction in second.corrections.items():
        offsets = correction.at(np.array([1011.0])) - before[vehicle].at(np.array([1000.0]))
        assert np.abs(offsets).max() < 0.3
    after = known(second)
    held = np.isfinite(first.alignment)
    assert np.isfinite(after.alignment[held]).all()
    assert np.nanmedian(after.alignment_std) < np.nanmedian(first.alignment_std)
    assert (after.passes >= first.passes).all()
    fleet_offset = np.mean([OFFSETS[c] for c in OFFSETS])
    assert error(after, -fleet_offset) < 1.1 * error(first, -fleet_offset)


def test_a_recorded_alignment_is_evidence_that_one_wheelset_can_be_read_against() -> None:
    alone = [item for item in displaced(fleet_passes()) if item.wheelset == "cone 0.05"]
    blind = estimate_section("S", alone, None, SECTION)
    assert blind.alignment is None
    assert code_of(blind.report.reason) is ReasonCode.SINGLE_WHEELSET
    truth = recorded_alignment(track(1))
    recorded = replace(truth, alignment_std=np.full(len(truth.s), 0.05e-3))
    assert estimate_section("S", alone, recorded, SECTION).report.status is Status.ESTIMATED
    found = estimate_section("S", displaced(fleet_passes()), recorded, SECTION)
    for (vehicle, _), correction in found.corrections.items():
        true = np.array([400.0, 1600.0])
        measured = true + OFFSETS[vehicle] + SCALES[vehicle] * (true - 1000.0)
        assert np.abs(correction.at(measured) - true).max() < 0.5, vehicle


def test_a_journey_of_another_place_is_refused_and_the_others_stay_as_they_were() -> None:
    rng = np.random.default_rng(1)
    stranger = [
        replace(item, vehicle="stranger", displacement=1e-3 * rng.standard_normal(len(item.at)))
        for item in fleet_passes()
        if item.vehicle == "17 m/s"
    ]
    found = estimate_section("S", [*displaced(fleet_passes()), *stranger], None, SECTION)
    (refused,) = [journey for journey in found.report.journeys if not journey.used]
    assert refused.vehicle == "stranger"
    assert code_of(refused.reason) is ReasonCode.JOURNEY_DISAGREES
    for journey, correction in first_version().corrections.items():
        assert found.corrections[journey].offset == pytest.approx(correction.offset, abs=0.02)


def test_no_pass_and_passes_all_alike_give_no_alignment_but_a_reason() -> None:
    assert estimate_section("S", [], None, SECTION).report.reason == Reason(ReasonCode.NO_PASS, "no pass")
    alike = estimate_section("S", fleet_passes(alike=True), None, SECTION)
    assert alike.alignment is None
    assert alike.report.status is Status.UNESTIMATED
    assert code_of(alike.report.reason) is ReasonCode.PASSES_ALIKE
    json.dumps(alike.report.as_json(), allow_nan=False)

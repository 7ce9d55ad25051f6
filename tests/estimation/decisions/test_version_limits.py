"""By how much two versions of an alignment may differ, each just inside and just outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.track.settings import (
    AlignmentSettings,
    _apart,
    carry_over_findings,
    changed_vehicles,
    gauge_shift_changed,
    requires_reestimation,
)
from estimation.track.survey_verdict import place_of
from estimation.track.update import UpdateOutcome
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource, Correction, GaugeShift, TrackAlignment, TrackFindings

N = 1000
S = np.arange(float(N))
WAVE = 2e-3 * np.sin(2 * np.pi * S / 50.0)  # m
OTHER = np.cos(2 * np.pi * S / 50.0) * np.sqrt(2.0)  # rms 1, orthogonal to the wave
SETTINGS = AlignmentSettings()


def made(**changes: object) -> TrackAlignment:
    plain = TrackAlignment(
        section="S",
        version=1,
        s=S,
        alignment=WAVE,
        alignment_std=np.full(N, 1e-4),
        gauge_deviation=np.zeros(N),
        gauge_deviation_std=np.zeros(N),
        passes=np.ones(N, dtype=np.int64),
        status=Status.ESTIMATED,
        source=AlignmentSource.FLEET,
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def again(old: TrackAlignment, **changes: object) -> bool:
    return requires_reestimation(old, replace(old, **changes), SETTINGS)  # type: ignore[arg-type]


def test_the_same_again_changes_nothing() -> None:
    assert not again(made())
    assert not again(made(findings=TrackFindings({"V": 1.1}, 0.0, {})))


def test_what_an_alignment_is_of_decides() -> None:
    assert again(made(), source=AlignmentSource.RECORDED)
    assert again(made(), cutoff_wavelength=120.0)
    assert again(made(), gauge_known=False)
    assert again(made(), s=S + 1.0)
    shorter = {
        name: getattr(made(), name)[:-1]
        for name in ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes")
    }
    assert again(made(), **shorter)


def without(points: int) -> FloatArray:
    return np.where(np.arange(N) < points, np.nan, WAVE)


def test_two_in_a_hundred_of_the_section_may_be_known_or_not() -> None:
    assert not again(made(), alignment=without(19))
    assert not again(made(alignment=without(19)), alignment=WAVE)
    assert again(made(), alignment=without(21))
    assert again(made(alignment=without(21)), alignment=WAVE)
    assert not again(made(alignment=without(N)), alignment=without(N))


@pytest.mark.parametrize(("std", "limit"), [(1e-4, 1e-4), (0.01e-3, 0.05e-3)])
def test_an_alignment_differs_from_its_std_on_or_from_what_the_geometry_shows(std: float, limit: float) -> None:
    old = made(alignment_std=np.full(N, std))
    assert not again(old, alignment=WAVE + 0.99 * limit * OTHER)
    assert again(old, alignment=WAVE + 1.01 * limit * OTHER)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_stretch_of_half_a_percent_does_not_average_out(sign: float) -> None:
    assert not again(made(), alignment=WAVE * (1.0 + sign * 0.0049))
    assert again(made(), alignment=WAVE * (1.0 + sign * 0.0051))


def test_much_more_certain_is_another_alignment() -> None:
    assert not again(made(), alignment_std=np.full(N, 0.51e-4))
    assert again(made(), alignment_std=np.full(N, 0.49e-4))
    assert not again(made(alignment_std=np.full(N, 0.049e-3)), alignment_std=np.full(N, 1e-6))
    assert again(made(alignment_std=np.full(N, 0.051e-3)), alignment_std=np.full(N, 1e-6))


def test_a_scale_that_becomes_known_is_another_alignment() -> None:
    assert not again(made(scale_std=0.02), scale_std=0.0101)
    assert again(made(scale_std=0.02), scale_std=0.0099)
    assert not again(made(scale_std=0.0099), scale_std=0.0)
    assert again(made(scale_std=0.0101), scale_std=0.0)


def test_gauge_differs_from_three_tenths_of_a_millimetre() -> None:
    for before in (0.0, 2e-3):
        old = made(gauge_deviation=before * OTHER)
        assert not again(old, gauge_deviation=(before + 0.29e-3) * OTHER)
        assert again(old, gauge_deviation=(before + 0.31e-3) * OTHER)


def vehicles(old: TrackAlignment, findings: TrackFindings | None) -> dict[str, float]:
    return changed_vehicles(old, replace(old, findings=findings), SETTINGS, {"W": "V"})


@pytest.mark.parametrize(("std", "limit"), [(0.0, 0.02), (0.009, 0.02), (0.02, 0.04)])
def test_a_stiffness_ratio_differs_by_two_percent_or_twice_its_std(std: float, limit: float) -> None:
    old = made(findings=TrackFindings({"V": 1.1}, std, {}))
    for ratio, differs in ((1.1 + limit - 1e-4, False), (1.1 + limit + 1e-4, True), (1.1 - limit - 1e-4, True)):
        findings = TrackFindings({"V": ratio}, 0.0, {})
        assert vehicles(old, findings) == ({"V": ratio} if differs else {})
        assert not again(old, findings=findings)  # for the windows of other vehicles
    assert vehicles(old, TrackFindings({}, 0.0, {})) == ({"V": 1.0} if limit < 0.1 else {})
    assert vehicles(old, None) == {}


def test_a_vehicle_that_is_met_matters_for_itself() -> None:
    for ratio in (0.9, 1.0):
        assert vehicles(made(), TrackFindings({"V": ratio}, 0.0, {})) == {"V": ratio}
    for ratio, differs in ((1.019, False), (1.021, True), (0.979, True)):
        known = made(findings=TrackFindings({"V": ratio}, 0.0, {}))
        assert bool(vehicles(known, TrackFindings({}, 0.0, {}))) is differs  # without a ratio it is as assumed


def shift_of(size: float) -> GaugeShift:
    """Return a shift of ``size`` times the gauge deviation, whatever R."""
    gauge = np.array([-5e-3, 0.0, 5e-3])
    return GaugeShift(np.array([-2e-3, 0.0, 2e-3]), gauge, np.tile(size * gauge, (3, 1)))


def test_the_shift_of_a_wheelset_that_is_met_matters_for_its_vehicle() -> None:
    shifts = TrackFindings({}, 0.0, {"W": shift_of(0.3)})
    for known in (None, TrackFindings({}, 0.0, {})):
        assert vehicles(made(findings=known), shifts) == {"V": 1.0}
        assert not again(made(findings=known), findings=shifts)
    assert vehicles(made(findings=shifts), shifts) == {}


def test_a_shift_differs_by_fifteen_in_a_hundred_of_the_gauge() -> None:
    gauge = 1e-3 * OTHER
    old = made(gauge_deviation=gauge, findings=TrackFindings({}, 0.0, {"W": shift_of(0.3), "X": shift_of(0.3)}))
    for size, changed in ((0.3 + 0.149, False), (0.3 + 0.151, True), (0.3 - 0.149, False), (0.3 - 0.151, True)):
        new = replace(old, findings=TrackFindings({}, 0.0, {"W": shift_of(size), "Y": shift_of(9.0)}))
        assert gauge_shift_changed(old, new, SETTINGS) is changed
    assert not gauge_shift_changed(replace(old, findings=None), old, SETTINGS)
    assert not gauge_shift_changed(old, replace(old, findings=None), SETTINGS)


def test_a_shift_is_compared_where_passes_are() -> None:
    grid, gauge = np.linspace(-4e-3, 4e-3, 81), np.array([-5e-3, 0.0, 5e-3])
    for bound, changed in ((1.05e-3, False), (0.5e-3, True)):
        table = np.where(np.abs(grid) > bound, 0.6, 0.0)[:, None] * gauge
        old = made(gauge_deviation=1e-3 * OTHER, findings=TrackFindings({}, 0.0, {"W": shift_of(0.0)}))
        new = replace(old, findings=TrackFindings({}, 0.0, {"W": GaugeShift(grid, gauge, table)}))
        assert gauge_shift_changed(old, new, SETTINGS) is changed


def test_shifts_are_compared_at_41_places_from_minus_one_to_one_millimetre() -> None:
    places = [-1e-3 + 0.05e-3 * k for k in range(41)]
    grid, gauge = np.linspace(-4e-3, 4e-3, 81), np.array([-5e-3, 0.0, 5e-3])
    shift = GaugeShift(grid, gauge, np.outer(grid / 1e-3 + 0.5, 0.1 * gauge))
    squares = [(0.1 * (R / 1e-3 + 0.5) * e) ** 2 for R in places for e in (-2e-3, 2e-3)]
    assert _apart(shift, shift_of(0.0), 2e-3, AlignmentSettings()) == pytest.approx(
        np.sqrt(sum(squares) / len(squares)), rel=1e-9
    )


def test_nothing_is_a_stretch_of_no_alignment() -> None:
    flat = made(alignment=np.zeros(N))
    assert not again(flat)
    assert not again(flat, alignment=0.99e-4 * OTHER)
    assert again(flat, alignment=1.01e-4 * OTHER)


def test_what_was_found_before_is_carried_over_with_its_std() -> None:
    before = made(findings=TrackFindings({"V": 1.1, "U": 1.2}, 0.03, {"W": shift_of(0.1)}), gauge_deviation=WAVE)
    found = made(findings=TrackFindings({"V": 1.0}, 0.01, {"X": shift_of(0.2)}), gauge_deviation=WAVE)
    kept = carry_over_findings(found, before).findings
    assert kept is not None
    assert kept.stiffness_ratio == {"V": 1.0, "U": 1.2}
    assert kept.stiffness_ratio_std == 0.03
    assert set(kept.gauge_shifts) == {"W", "X"}
    same = made(findings=TrackFindings({"V": 1.1}, 0.03, {}))
    alone = carry_over_findings(found, same).findings
    assert alone is not None
    assert alone.stiffness_ratio_std == 0.01
    no_shift = made(findings=TrackFindings({}, 0.01, {}), gauge_deviation=WAVE)
    none = carry_over_findings(no_shift, before).findings
    assert none is not None
    assert none.gauge_shifts == {}
    assert carry_over_findings(found, None) is found
    assert carry_over_findings(found, made()) is found
    assert carry_over_findings(made(), before).findings is None


@pytest.mark.parametrize(("correlation", "kept"), [(0.79, False), (0.81, True), (-0.81, False), (1.0, True)])
def test_shifts_stay_with_a_gauge_that_correlates_by_four_fifths(correlation: float, *, kept: bool) -> None:
    wave = np.sin(2 * np.pi * S / 50.0) * np.sqrt(2.0)
    for size in (1e-3, 4e-3):
        gauge = size * (correlation * wave + np.sqrt(1.0 - correlation**2) * OTHER)
        before = made(findings=TrackFindings({}, 0.0, {"W": shift_of(0.1)}), gauge_deviation=1e-3 * wave)
        found = made(findings=TrackFindings({}, 0.0, {"X": shift_of(0.2)}), gauge_deviation=gauge)
        findings = carry_over_findings(found, before).findings
        assert findings is not None
        assert ("W" in findings.gauge_shifts) is kept
    flat = made(findings=TrackFindings({}, 0.0, {"X": shift_of(0.2)}))
    of_flat = carry_over_findings(flat, replace(before, gauge_deviation=np.zeros(N))).findings
    assert of_flat is not None
    assert "W" not in of_flat.gauge_shifts


def test_a_fleet_knows_its_place_by_the_scatter_of_its_journeys() -> None:
    corrections = {("V", k): Correction(offset) for k, offset in enumerate((1.0, 3.0, 5.0, 7.0))}
    assert place_of(corrections) == (pytest.approx(4.0), pytest.approx(np.sqrt(5.0) / 2.0))
    assert place_of({}) == (0.0, 0.0)


def test_which_outcomes_make_a_version_and_have_valid_positions() -> None:
    assert {one for one in UpdateOutcome if one.makes_version} == {
        UpdateOutcome.NEW_VERSION,
        UpdateOutcome.SURVEY_EXTENDED,
        UpdateOutcome.SURVEY_REFUSED,
    }
    assert {one for one in UpdateOutcome if one.windows_wait} == {
        UpdateOutcome.UNESTIMATED,
        UpdateOutcome.SURVEY_REFUSED,
    }
    assert {one for one in UpdateOutcome if one.positions_valid} == {
        UpdateOutcome.SURVEY_KEPT,
        UpdateOutcome.SURVEY_EXTENDED,
    }

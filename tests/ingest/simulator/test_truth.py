"""The true contact geometry of a simulated wheelset: at nominal gauge, with every contact jump where it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from estimation.contact.conicity import equivalent_conicity, nonlinearity_parameter, zero_crossing
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import TreadWear, worn
from estimation.values.arrays import FloatArray
from ingest.simulator.axle_motion import AMPLITUDES, contact_of, true_geometry, truth_of, wear_at, worn_contact
from ingest.simulator.campaign import scenario_track
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import read_scenario

NO_GAUGE = SMALL.replace("gauge_std_mm = 0.5\nsurvey_alignment_std_mm = 0.1\nsurvey_gauge_std_mm = 0.2\n", "")
FINE = 2e-6  # m
WEAR = 'serial = "C"\ninitial_wear_mm = 0.8\nflange_wear_share = 1.0'


def scenario_of(folder: Path, text: str) -> Scenario:
    path = folder / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    return read_scenario(path)


def finely_tabulated(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Return displacement and radius difference of the third wheelset at nominal gauge, every 2 um."""
    plan = scenario.vehicles[0].wheelsets[2]
    wheel = worn(wheel_profile("P8"), TreadWear(0.8e-3, plan.wear_centre, plan.wear_half_width, 0.8e-3))
    wheelset = WheelsetOnTrack.symmetric(wheel, rail_profile("56E1"), 1 / 20, 1.435, radius=plan.nominal_radius)
    x = FINE * np.arange(-3500, 3501)
    table = contact_table(wheelset, x, method=ContactMethod.EN15302, outside="hold")
    return x, table.rolling_radius_difference[:, 0]


def test_the_true_conicity_has_the_contact_jumps_where_they_are(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, NO_GAUGE.replace('serial = "C"', WEAR))
    track, plan = scenario_track(scenario), scenario.vehicles[0].wheelsets[2]
    contact = contact_of(scenario, track, plan, 0.0)
    truth = true_geometry(scenario, plan, contact)
    x, R = finely_tabulated(scenario)
    expected = equivalent_conicity(x, R, AMPLITUDES)
    np.testing.assert_allclose(truth.equivalent_conicity, expected, atol=1e-3)
    assert truth.nonlinearity == pytest.approx(nonlinearity_parameter(x, R), abs=5e-4)
    assert truth.zero_crossing == pytest.approx(zero_crossing(x, R), abs=1e-6)
    table = contact.table
    coarse = equivalent_conicity(table.lateral_displacement, table.rolling_radius_difference[:, 0], AMPLITUDES)
    assert np.nanmax(np.abs(coarse - expected)) > 3e-3  # the case is one where that matters


def test_the_truth_is_at_nominal_gauge_on_a_line_that_never_has_it(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, NO_GAUGE)
    assert scenario.section.recipe is not None
    plan = scenario.vehicles[0].wheelsets[2]
    wide = replace(
        scenario, section=replace(scenario.section, recipe=replace(scenario.section.recipe, gauge_offset=4e-3))
    )
    contacts = [contact_of(item, scenario_track(item), plan, 0.0) for item in (scenario, wide)]
    nominal, on_wide = (true_geometry(scenario, plan, contact) for contact in contacts)
    np.testing.assert_array_equal(on_wide.equivalent_conicity, nominal.equivalent_conicity)
    same = np.searchsorted(on_wide.lateral_displacement, nominal.lateral_displacement - 1e-9)
    np.testing.assert_allclose(
        on_wide.rolling_radius_difference[same], nominal.rolling_radius_difference, rtol=0.0, atol=1e-12
    )
    table = contacts[1].table
    assert table.gauge_deviation.min() > 1e-3
    found = equivalent_conicity(table.lateral_displacement, table.rolling_radius_difference[:, 0], AMPLITUDES)
    assert np.nanmax(np.abs(found - nominal.equivalent_conicity)) > 0.01


def test_the_truth_does_not_depend_on_which_gauges_the_line_has_beside_the_nominal_one(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, NO_GAUGE.replace('serial = "C"', WEAR))
    plan = scenario.vehicles[0].wheelsets[2]
    wear = wear_at(plan, 0.0)
    alone, among = (
        truth_of(worn_contact(plan, wear, scenario.section, np.array(gauges), 6e-3))
        for gauges in ((0.0,), (-1e-3, 0.0, 1e-3))
    )
    np.testing.assert_array_equal(among.rolling_radius_difference, alone.rolling_radius_difference)
    np.testing.assert_array_equal(among.equivalent_conicity, alone.equivalent_conicity)
    assert among.nonlinearity == alone.nonlinearity

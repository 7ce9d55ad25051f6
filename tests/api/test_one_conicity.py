"""One wheelset on one track has one equivalent conicity, whoever is asked: that of EN 15302, to the last digit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import orjson
import pytest

from api.terminal.contact import Contact, table_text
from estimation.accuracy.wheel_contact import AMPLITUDES, RailShare, WheelContact, WheelPair, wheel_contact
from estimation.contact.conicity import MeasuredShapes, equivalent_conicity
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import rail_profile
from estimation.contact.smoothed_profile import exact
from estimation.rails.cell import conicity_on_rails
from estimation.track.panel.basis import measured_curve
from ingest.simulator.axle_motion import WearState, truth_of, worn_contact, worn_profiles
from ingest.simulator.scenario_file import load_scenario

SCENARIO = Path(__file__).parents[2] / "ingest" / "simulator" / "scenarios" / "demo.toml"
PRINTED = 0.5e-3  # half of the last digit of a conicity on the page and in tables


@pytest.mark.parametrize("depth", [0.0, 0.4e-3, 1.0e-3])
def test_every_face_has_the_same_conicity(depth: float) -> None:
    scenario = load_scenario(SCENARIO)
    plan, section = scenario.vehicles[0].wheelsets[0], scenario.section
    wear = WearState(0.0, 0, depth, 0.8 * depth)
    ran = worn_contact(plan, wear, section, np.zeros(1), 12e-3)
    truth = truth_of(ran)
    true = np.interp(AMPLITUDES[:5], truth.amplitude, truth.equivalent_conicity)

    left, right = worn_profiles(plan, wear)
    wheels = WheelPair(left, right, plan.nominal_radius)
    rails = RailShare(section.rail_profile, section.inclination, section.nominal_gauge, 1.0)
    compared = wheel_contact(wheels, (rails,))
    assert isinstance(compared, WheelContact)
    beside_the_estimate = np.array([one.value for one in compared.conicity[:5]], dtype=np.float64)
    of_rails, _ = conicity_on_rails(wheels, rails, AMPLITUDES[:5])

    rail = exact(rail_profile(section.rail_profile))
    shapes = MeasuredShapes(exact(left), exact(right), rail, rail)
    asked = Contact(ran.wheelset, shapes, ContactMethod.EN15302, "1:20", 120.0)
    printed = orjson.loads(table_text(asked, as_json=True))["equivalent_conicity"]
    by_command = np.interp(1e3 * AMPLITUDES[:5], printed["amplitude_mm"], np.array(printed["value"], dtype=np.float64))

    turned = measured_curve("W", left, right, 0.0, rail=rails.rail, inclination=rails.inclination, gauge=rails.gauge)
    of_alignment = equivalent_conicity(turned.displacement, turned.difference, AMPLITUDES[:3])

    for face in (beside_the_estimate, of_rails, by_command):
        np.testing.assert_allclose(face, true, rtol=0.0, atol=0.1 * PRINTED)
    np.testing.assert_allclose(of_alignment, true[:3], rtol=0.0, atol=PRINTED)

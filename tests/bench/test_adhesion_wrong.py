"""Rows of the adhesion bench whose file is another one: what is changed, and that the truth stays; what is printed."""

from __future__ import annotations

import numpy as np
import pytest

from bench.adhesion import FILES, GROUPS, LEAST_HELD, ROWS, SCENARIOS, friction_table, summary
from bench.adhesion_case import StoredPasses
from bench.adhesion_fleet import GOOD, Fleet, SensedWindow, TrueForces, class_of
from bench.adhesion_rows import OF, ONE, QUIET, WRONG, WrongFile, as_on_file, first_vehicle, with_others
from estimation.adhesion.window_adhesion import refused
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window
from ingest.simulator.campaign import scenario_track
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario_file import load_scenario


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    scenario = with_seed(load_scenario(SCENARIOS / f"{OF}.toml"), 0)
    track, two = scenario_track(scenario), np.zeros(2)
    alignment = TrackAlignment("S", 1, track.s[:2], two, two, two, two, two.astype(np.int64), Status.ESTIMATED)
    windows = tuple(_sensed(vehicle.code) for vehicle in scenario.vehicles[:2])
    return Fleet(scenario, track, alignment, class_of(scenario), windows)


def _sensed(vehicle: str) -> SensedWindow:
    one = np.ones(3)
    window = Window(
        wheelset=f"{vehicle}-1",
        vehicle=vehicle,
        axle=1,
        start_ns=0,
        length_ns=1,
        sample_interval_s=0.004,
        lateral_acceleration=one,
        yaw_acceleration=one,
        roll_acceleration=one,
        mass_lateral_acceleration=one,
        speed=one,
        distance=one,
        valid=np.ones(3, np.bool_),
        resolution=(1e-4, 1e-4, 1e-4, 1e-4),
        track_section="S",
        odometer_m=0.0,
        quality=GOOD,
        frame_yaw_acceleration=one,
    )
    return SensedWindow(window, 0, TrueForces(one, one, one, one))


def test_rows_are_known_by_name_and_as_a_group() -> None:
    assert (*FILES, *QUIET, *WRONG, *ONE) == ROWS
    assert {"wrong_file": (*WRONG, *ONE), "quiet_rows": tuple(QUIET)} == GROUPS
    assert OF in FILES
    assert LEAST_HELD == 0.92


def test_sensors_and_class_are_changed_and_the_truth_is_not(fleet: Fleet) -> None:
    seen = as_on_file(fleet, WrongFile(masses=0.8, load=0.5, yaw=1.05, lateral=0.95))
    window, p, on_file = seen.windows[0].window, fleet.vehicle_class.parameters, seen.vehicle_class.parameters
    assert (window.yaw_acceleration == 1.05).all()
    for values in (window.lateral_acceleration, window.mass_lateral_acceleration, window.frame_yaw_acceleration):
        assert values is not None
        assert (values == 0.95).all()
    assert (window.roll_acceleration == 1.0).all()
    assert seen.windows[0].truth is fleet.windows[0].truth
    assert (on_file.load, on_file.wheelset_mass) == (0.4 * p.load, 0.8 * p.wheelset_mass)
    assert on_file.yaw_stiffness == p.yaw_stiffness
    assert on_file.longitudinal_creep_coefficient == p.longitudinal_creep_coefficient
    bogie, on_file_bogie = fleet.vehicle_class.bogie, seen.vehicle_class.bogie
    assert bogie is not None
    assert on_file_bogie is not None
    assert on_file_bogie.body_mass == 0.4 * bogie.body_mass
    assert as_on_file(fleet, WrongFile()).vehicle_class == fleet.vehicle_class


def test_the_exact_survey_is_the_track(fleet: Fleet) -> None:
    seen = as_on_file(fleet, WrongFile(survey_exact=True))
    assert seen.alignment.alignment == pytest.approx(fleet.track.alignment[:2])
    assert as_on_file(fleet, WrongFile()).alignment is fleet.alignment


def test_one_vehicle_alone_is_wrong(fleet: Fleet) -> None:
    first, second = (one.code for one in fleet.scenario.vehicles[:2])
    assert {one.window.vehicle for one in first_vehicle(fleet).windows} == {first}
    why = Reason(ReasonCode.NOT_FINITE, "")
    right, wrong = (
        StoredPasses("S", tuple(refused("W", 0, code, "S", digest, why) for code in codes), np.ones(2), np.ones(2), 1.0)
        for codes, digest in (((first, second), "right"), ((first,), "wrong"))
    )
    found = with_others(wrong, right)
    assert [(one.vehicle, one.content_digest) for one in found.passes] == [(first, "wrong"), (second, "right")]


def test_the_page_prints_what_holds_in_the_worst_row() -> None:
    unknown = {"error": 1.0, "force": 400.0}
    case = {
        "seed": 0,
        "found": [],
        "stretches": [],
        "alarms": [(0.0, 50.0, 0.16)],
        "vehicle_km": 10.0,
        "wheelset_seconds": 1e5,
        "force_seconds": 1.0,
        "conicity_all": [],
        "conicity_left_out": [],
        "left_out": ["V"],
        "cells": [
            {
                "value": 0.14,
                "low": low,
                "mean": 0.12,
                "least": 0.11,
                "high": 0.2,
                "at_least": low,
                "probability": 0.1,
                "from": 0.0,
            }
            for low in (0.05, 0.13)
        ],
    } | dict.fromkeys(("lateral", "moment", "contact", "newton_contact", "newton_moment"), unknown)
    right = case | {"row": OF, "alarms": [], "found": [True], "stretches": [(0.0, 60.0)]}
    rows = {row.what: row for row in summary([right, case | {"row": "yaw_large"}])}
    (wrong,) = (row for what, row in rows.items() if what.startswith("file or sensors wrong"))
    assert wrong.measured.startswith("50.0 %, 50.0 %; alarms without friction < 0.15: 1 in 10")
    assert not wrong.met
    (alarms,) = (row for what, row in rows.items() if what.startswith("alarms without friction"))
    assert alarms.met
    assert alarms.measured.startswith("0 in 10 vehicle-km: 0.0 per 1,000 km, with 95 % at most 299.6 (0 in 5991 km")
    (stretches,) = (row for what, row in rows.items() if what.startswith("stretches of friction"))
    assert "chosen on: 0 of 0; of those that reach below 0.12: 1 of 1" in stretches.measured
    table = friction_table([case | {"row": "yaw_large"}])
    printed = dict(zip(table.header, table.rows[0], strict=True))
    assert printed["seeds with a vehicle left out"] == "1"
    assert printed["error of friction at 0.12 to 0.18, mean and std"] == "+0.020, 0.000"

"""What file and sensors leave open of the friction: from the classes, in the intervals, and in the stds of forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_friction import KNOWN, NO_ERRORS, TRUE, a_pass, section_friction

from estimation.adhesion.creep_forces import FileErrors, force_errors, lateral_scale_std
from estimation.adhesion.parameters import FORCES
from estimation.values.opinions import CellFriction
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import (
    Arrangement,
    SensorChannel,
    SensorLayout,
    VehicleClass,
    VehicleParameters,
    default_relative_std,
)

CLASS = VehicleClass("A", "A", "test", Arrangement.SINGLE_WHEELSET, VehicleParameters())
WELL_KNOWN = replace(
    CLASS,
    sensors=SensorLayout(*(SensorChannel(scale_std=std) for std in (0.01, 0.004, 0.5, 0.02))),
    relative_std={"load": 0.02, "yaw_stiffness": 0.2, "longitudinal_creep_coefficient": 0.05},
)


def test_what_no_file_states_is_that_of_passengers_and_of_sensors_that_nobody_calibrated() -> None:
    assert (VEHICLE.load_std, VEHICLE.unstated_scale_std, FORCES.yaw_scale_creep, FORCES.lateral_scale_creep) == (
        0.12,
        0.03,
        0.55,
        0.35,
    )
    assert default_relative_std("load") == VEHICLE.load_std
    assert FileErrors.of([]) == FileErrors.of([CLASS]) == FileErrors() == FileErrors(0.1, 0.05, 0.12, 0.03, 0.03)
    assert FileErrors().factor_std == pytest.approx(np.sqrt(0.1**2 + 0.05**2 + 0.12**2))
    assert FileErrors().creep_std == pytest.approx(0.03 * np.sqrt(0.55**2 + 0.35**2))


def test_classes_state_their_own_and_the_largest_of_several_counts() -> None:
    assert FileErrors.of([WELL_KNOWN]) == FileErrors(0.05, 0.2, 0.02, 0.004, 0.02)
    assert FileErrors.of([WELL_KNOWN, CLASS]) == FileErrors(0.1, 0.2, 0.12, 0.03, 0.03)
    assert lateral_scale_std(SensorLayout(lateral=SensorChannel(scale_std=0.05))) == 0.05


def inverse_ends(cell: CellFriction) -> tuple[float, float, float]:
    """Return 1/mu of a place, and of both ends of its interval."""
    found = cell.friction
    assert found.value is not None
    assert found.low is not None
    assert found.high is not None
    return 1.0 / found.value, 1.0 / found.low, 1.0 / found.high


def test_the_load_scales_the_interval_and_the_sensors_add_to_it_at_every_friction() -> None:
    passes = [a_pass(number, TRUE) for number in range(8)]

    def halves(file: FileErrors) -> list[tuple[float, float]]:
        cells = section_friction(passes, replace(KNOWN, law_std=0.0, file=file, least_upper=1e9))
        ends = [inverse_ends(cell) for cell in cells]
        return [(inverse, 0.5 * (low - high)) for inverse, low, high in ends]

    none, load, scale = (halves(one) for one in (NO_ERRORS, FileErrors(0, 0, 0.2, 0, 0), FileErrors(0, 0, 0, 0.05, 0)))
    added = []
    for (inverse, own), (_, loaded), (_, scaled) in zip(none, load, scale, strict=True):
        if own < 0.9 * inverse and loaded < 0.9 * inverse:
            assert np.sqrt(loaded**2 - own**2) == pytest.approx(1.96 * 0.2 * inverse, rel=0.02)
        added.append(np.sqrt(scaled**2 - own**2))
    assert min(added) > 0.4
    assert max(added) < 1.2 * min(added)  # while 1/mu is four times as large


def test_a_lower_bound_holds_what_scales_of_sensors_do() -> None:
    passes = [a_pass(number, [0.35] * 8) for number in range(8)]
    sharp = section_friction(passes, replace(KNOWN, file=NO_ERRORS))
    for one, other in zip(section_friction(passes, KNOWN), sharp, strict=True):
        assert 0.05 < one.at_least < other.at_least


def test_where_friction_is_low_is_decided_without_the_scales_of_sensors() -> None:
    passes = [a_pass(number, TRUE) for number in range(8)]
    coarse = replace(KNOWN, file=replace(KNOWN.file, yaw_scale=0.2, lateral_scale=0.2))
    overloaded = replace(KNOWN, file=replace(KNOWN.file, load=0.4))
    loads = []
    for one, other, load in zip(*(section_friction(passes, p) for p in (KNOWN, coarse, overloaded)), strict=True):
        assert one.low_probability == other.low_probability
        assert other.at_least < one.at_least
        loads.append(abs(load.low_probability - one.low_probability))
    assert max(loads) > 0.05


def test_stds_of_forces_hold_springs_masses_load_and_sensors() -> None:
    """Each by its own terms, and by no others."""
    stds = {"wheelset_mass": 0.03, "lateral_stiffness": 0.06, "yaw_stiffness": 0.2, "load": 0.12}
    lateral, moment, load = force_errors(replace(WELL_KNOWN, relative_std=stds))
    scale = lateral_scale_std(WELL_KNOWN.sensors)
    assert lateral == pytest.approx(np.sqrt(0.03**2 + 0.06**2 + scale**2))
    assert moment == pytest.approx(np.hypot(0.2, WELL_KNOWN.sensors.yaw.usual_scale_std))
    assert load == 0.12

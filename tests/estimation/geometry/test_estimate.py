"""Published geometry: intervals cover, contact jumps are recognised, what cannot be seen is not published."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from paper_class import BINS, WINDOWS
from smooth_wheelset import SmoothTable, alignment, ideal, mems_windows, run, track

from estimation.contact.conicity import equivalent_conicity
from estimation.geometry.conicity import CurveParameters
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.settings import EstimationSettings
from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.tables import bin_table
from estimation.tables.bin_table import cells_of_window
from estimation.values.geometry import COMBINATIONS, BinStatus, FilledCells, WheelsetGeometry
from estimation.values.quantities import Status
from estimation.values.reasons import Reason

SETTINGS = EstimationSettings()
CERTAIN = GeometryParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0)))


@cache
def from_mems(seed: int, cone: float, seconds: int = 300, density: float = 1e-3) -> WheelsetGeometry:
    m = run(seconds, seed=seed, cone=cone, swing=4.0)
    tables = [cells_of_window(w, alignment(track(seed)), WINDOWS) for w in mems_windows(m, seed, density)]
    merged = bin_table.merge_all([t for t in tables if isinstance(t, FilledCells)], BINS)
    return estimate_geometry(merged, BINS, SETTINGS.geometry)


def _true_conicity(cone: float) -> np.ndarray:
    table = SmoothTable(cone)
    x = table.lateral_displacement
    return equivalent_conicity(
        table.standard_displacement, table.left(x) - table.right(x), CurveParameters().amplitudes
    )


def test_conicity_from_real_sensors_is_near_and_its_intervals_cover() -> None:
    covered, errors = [], []
    for cone in (0.05, 0.12):
        truth = _true_conicity(cone)
        for seed in range(5):
            found = from_mems(seed, cone)
            for estimate, true in zip(found.conicity, truth, strict=True):
                if estimate.value is not None:
                    assert estimate.low is not None
                    assert estimate.high is not None
                    covered.append(estimate.low <= true <= estimate.high)
                    errors.append(abs(estimate.value - true))
    assert len(covered) > 80
    assert np.mean(errors) < 0.005
    assert np.mean(covered) > 0.88


def test_intervals_widen_with_the_noise_of_the_sensors() -> None:
    quiet, loud = from_mems(1, 0.12, density=1e-4), from_mems(1, 0.12, density=4e-3)
    assert quiet.equivalent_conicity.std is not None
    assert loud.equivalent_conicity.std is not None
    assert loud.equivalent_conicity.std > 2 * quiet.equivalent_conicity.std


def test_real_sensors_see_the_radius_difference_and_say_so_of_the_rest() -> None:
    found = from_mems(0, 0.12)
    good = found.samples > 2000
    statuses = {name: [s for s, g in zip(getattr(found, name).status, good, strict=True) if g] for name in COMBINATIONS}
    assert all(s is BinStatus.ESTIMATED for s in statuses["rolling_radius_difference"])
    assert all(s is BinStatus.UNOBSERVABLE for s in statuses["rolling_radius_sum"])
    assert all(s is BinStatus.UNOBSERVABLE for s in statuses["contact_angle_sum"])
    assert np.isnan(found.rolling_radius_sum.value).all()
    assert found.zero_crossing.status is Status.UNESTIMATED
    assert "offset" in str(found.zero_crossing.reason)


def test_ideal_sensors_see_the_zero_crossing() -> None:
    parameters = bin_table.BinParameters()
    found = estimate_geometry(bin_table.tabulate(ideal(run(200)), parameters), parameters, CERTAIN)
    table = SmoothTable()
    x = np.linspace(-1e-3, 1e-3, 20_001)
    true = x[np.argmin(np.abs(table.left(x) - table.right(x)))]
    assert found.zero_crossing.value == pytest.approx(true, abs=2e-6)
    assert found.reported_amplitude == pytest.approx(3e-3, abs=0.3e-3)


def test_uncertain_parameters_hide_what_rests_on_them_even_with_ideal_sensors() -> None:
    parameters = bin_table.BinParameters()
    table = bin_table.tabulate(ideal(run(200)), parameters)
    known = estimate_geometry(table, parameters, CERTAIN)
    estimate = estimate_geometry(table, parameters, GeometryParameters())
    middle = len(known.samples) // 2
    assert known.rolling_radius_sum.status[middle] is BinStatus.ESTIMATED
    assert estimate.rolling_radius_sum.status[middle] is BinStatus.UNOBSERVABLE
    assert estimate.rolling_radius_difference.status[middle] is BinStatus.ESTIMATED


def test_a_contact_jump_is_recognised_and_nothing_of_its_bin_is_published() -> None:
    """A step of 0.3 mm in the left radius at +1.1 mm, laid into the measured yaw acceleration."""
    m = run(200)
    motion = ideal(m)
    p = BINS.vehicle
    step = 0.3e-3 * (motion.displacement > 1.1e-3)
    moment = -(p.half_contact_distance * p.longitudinal_creep_coefficient / p.nominal_radius) * step
    stepped = replace(motion, yaw_acceleration=motion.yaw_acceleration + moment / p.yaw_inertia)
    parameters = bin_table.BinParameters()
    found = estimate_geometry(bin_table.tabulate(stepped, parameters), parameters, CERTAIN)
    crossed = int(np.searchsorted(found.bin_edges, 1.1e-3)) - 1
    jumped = [b for b, s in enumerate(found.rolling_radius_difference.status) if s is BinStatus.CONTACT_JUMP]
    assert jumped == [crossed]
    for name in COMBINATIONS:
        assert getattr(found, name).status[crossed] is BinStatus.CONTACT_JUMP
        assert np.isnan(getattr(found, name).value[crossed])


def test_too_little_data_is_unestimated_with_its_reason() -> None:
    parameters = bin_table.BinParameters()
    nothing = estimate_geometry(bin_table.init(parameters), parameters, CERTAIN)
    assert nothing.status is Status.UNESTIMATED
    assert nothing.reason
    short = estimate_geometry(bin_table.tabulate(ideal(run(20)), parameters), parameters, CERTAIN)
    assert short.equivalent_conicity.status is Status.UNESTIMATED
    assert "blocks" in str(short.reason)


def test_a_table_of_other_parameters_is_refused() -> None:
    with pytest.raises(ValueError, match="expected"):
        estimate_geometry(bin_table.init(bin_table.BinParameters()), BINS, CERTAIN)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"sensor_fault": True}, "fault"),
        ({"coverage": 0.1}, "10%"),
        ({"clipped": 0.15}, "15.0% of the samples are clipped, at most 10% may be"),
        ({"position_quality": 0.0}, "position"),
    ],
)
def test_gates_refuse_a_window_with_their_reason(change: dict[str, float], reason: str) -> None:
    window = mems_windows(run(60), seed=0)[0]
    bad = replace(window, quality=replace(window.quality, **change))
    outcome = cells_of_window(bad, alignment(track(1)), WINDOWS)
    assert isinstance(outcome, Reason)
    assert reason in outcome.text


def test_a_section_without_alignment_refuses_for_now() -> None:
    outcome = cells_of_window(mems_windows(run(60), seed=0)[0], None, WINDOWS)
    assert outcome == NO_ALIGNMENT

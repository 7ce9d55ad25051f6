"""What is not known of the vehicle and of the track, as standard deviations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper_class import PAPER_CLASS
from plain_windows import plain_track

from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.track import AlignmentSource, GaugeShift, TrackAlignment, TrackFindings
from estimation.vehicle.regressors import LATERAL_TARGETS, YAW_TARGETS
from estimation.vehicle.vehicle_class import SensorChannel

UNCERTAIN = ParameterUncertainty()
S = np.arange(1001.0)
GAUGE = 2e-3 * np.sin(2 * np.pi * S / 40.0)
GAUGE_STD = 2e-3 / np.sqrt(2.0)
SHIFT = GaugeShift(np.array([-1e-3, 1e-3]), np.array([-1e-3, 1e-3]), np.zeros((2, 2)))


def findings(*wheelsets: str, std: float = 0.01) -> TrackFindings:
    return TrackFindings({}, std, dict.fromkeys(wheelsets, SHIFT))


def track(found: TrackFindings | None = None, **changes: object) -> TrackAlignment:
    return plain_track(gauge_deviation=GAUGE, findings=found, **changes)


def test_the_defaults_are_half_of_the_95_percent_limits() -> None:
    """Creep coefficients +-20 %, springs and dampers +-10 %, masses +-5 %."""
    limits = {
        "lateral_creep": 0.2,
        "longitudinal_creep": 0.2,
        "spin_creep": 0.2,
        "mass": 0.05,
        "load": 0.05,
        "yaw_inertia": 0.05,
        "lateral_stiffness": 0.1,
        "lateral_damping": 0.1,
        "yaw_stiffness": 0.1,
        "saturation": 2.0 * math.hypot(3.3, 1.2),  # of 1/mu, where it is taken as zero
        "noise": 0.0,
        "displacement_noise": 0.0,
    }
    np.testing.assert_allclose(2.0 * UNCERTAIN.lateral(), [limits[name] for name in LATERAL_TARGETS[1:]])
    np.testing.assert_allclose(2.0 * UNCERTAIN.yaw(), [limits[name] for name in YAW_TARGETS[1:]])
    assert (UNCERTAIN.ratio, UNCERTAIN.displacement, UNCERTAIN.jump_position_std) == (None, 0.0, 0.0)


def test_an_estimated_ratio_stands_for_creep_and_stiffness_of_the_yaw_equation_alone() -> None:
    known = replace(UNCERTAIN, ratio=0.03)
    np.testing.assert_allclose(known.yaw(), [0.0, 0.03, 0.025, 0.1, math.hypot(3.3, 1.2), 0.0, 0.0])
    assert UNCERTAIN.inverse_friction == (3.3, 1.2)
    np.testing.assert_allclose(known.yaw(linear=False), [0.0, 0.03, 0.025, 0.1, 1.2, 0.0, 0.0])
    np.testing.assert_array_equal(known.lateral(), UNCERTAIN.lateral())


@pytest.mark.parametrize(
    ("found", "gauge_known", "share"),
    [
        (None, True, 0.5),  # contact jumps move by half the gauge deviation
        (findings(), True, 0.5),
        (findings("W2"), True, 0.5),
        (findings("W1"), True, 0.22),
        (findings("W1"), False, 0.32),
        (findings("W2"), False, 0.5),
    ],
)
def test_where_contact_jumps_are_is_known_to_a_share_of_the_gauge(
    found: TrackFindings | None, share: float, *, gauge_known: bool
) -> None:
    left = UNCERTAIN.on([track(found, gauge_known=gauge_known)], "W1").jump_position_std
    assert left == pytest.approx(share * GAUGE_STD, rel=0.005)


def test_without_a_serial_the_findings_of_any_wheelset_count() -> None:
    assert UNCERTAIN.on([track(findings("W2"))]).jump_position_std == pytest.approx(0.22 * GAUGE_STD, rel=0.005)
    assert UNCERTAIN.on([track(findings())]).jump_position_std == pytest.approx(0.5 * GAUGE_STD, rel=0.005)


def test_of_several_tracks_the_worst_counts() -> None:
    quiet = replace(track(), gauge_deviation=np.zeros(1001))
    left = UNCERTAIN.on([replace(quiet, scale_std=0.04), replace(track(), scale_std=0.002)])
    assert left.displacement == 0.04
    assert left.jump_position_std == pytest.approx(0.5 * GAUGE_STD, rel=0.005)
    unchanged = replace(UNCERTAIN, ratio=0.02, displacement=0.03, jump_position_std=1e-4)
    assert unchanged.on([]) == unchanged


def test_a_ratio_is_known_where_every_track_found_it() -> None:
    one, other = track(findings("W1", std=0.01)), track(findings("W1", std=0.02))
    assert UNCERTAIN.on([one, other], "W1").ratio == 0.02
    assert UNCERTAIN.on([one, track()], "W1").ratio is None
    assert replace(UNCERTAIN, ratio=0.05).on([one, track()], "W1").ratio == 0.05


def test_a_recording_has_found_nothing_of_a_wheelset_that_it_does_not_name() -> None:
    of_another = findings("W2")
    assert UNCERTAIN.on([track(of_another)], "W1").ratio is None
    assert UNCERTAIN.on([track(of_another)], "W2").ratio == 0.01
    assert UNCERTAIN.on([track(of_another)]).ratio == 0.01
    assert UNCERTAIN.on([track(of_another, source=AlignmentSource.FLEET)], "W1").ratio == 0.01


def test_a_gauge_that_is_not_known_moves_jumps_by_its_std_where_nothing_was_found_of_it() -> None:
    wide = np.full(len(track(findings()).s), 2.0 * GAUGE_STD)
    unknown = track(findings(), gauge_known=False)
    assert UNCERTAIN.on([replace(unknown, gauge_deviation_std=wide)]).jump_position_std == pytest.approx(GAUGE_STD)
    surveyed = replace(track(findings()), gauge_deviation_std=wide)
    assert UNCERTAIN.on([surveyed]).jump_position_std == pytest.approx(0.5 * GAUGE_STD, rel=0.005)


@pytest.mark.parametrize(("scale", "share"), [(0.049, 0.0), (0.065, 0.5), (0.081, 1.0), (0.2, 1.0)])
def test_a_gauge_that_is_not_on_file_moves_jumps_together_where_the_scale_is_open_too(
    scale: float, share: float
) -> None:
    """Of several tracks the worst counts."""
    n = len(track().s)
    tracks = [
        replace(track(gauge_known=False), gauge_deviation_std=np.full(n, std), scale_std=scale)
        for std in (0.4e-3, 0.6e-3)
    ]
    assert UNCERTAIN.on(tracks).jump_mean_std == pytest.approx(share * 0.27e-3)
    assert replace(UNCERTAIN, jump_mean_std=1e-4).on([]).jump_mean_std == 1e-4


@pytest.mark.parametrize(("waves", "share"), [(2, 0.75 / 4.0), (160, 0.0)])
def test_long_waves_of_a_known_gauge_move_jumps_on_average(waves: int, share: float) -> None:
    """A gauge of 1 mm in blocks of one sign: an eighth of the section each, or less than a tenth of a part."""
    n = len(track().s)
    gauge = 1e-3 * np.sign(np.sin(2.0 * np.pi * waves * (np.arange(n) + 0.5) / n))
    moved = UNCERTAIN.on([replace(track(), gauge_deviation=gauge)]).jump_mean_std
    assert moved == pytest.approx(share * 1e-3, abs=1e-5)


@pytest.mark.parametrize("std", [0.0, 1e-3, 3e-3])
def test_the_scale_is_known_less_by_the_square_of_the_gauge(std: float) -> None:
    n = len(track().s)
    gauge = std * np.where(np.arange(n) % 2, 1.0, -1.0)
    found = UNCERTAIN.on([replace(track(), gauge_deviation=gauge, scale_std=0.02)]).displacement
    assert found == pytest.approx(np.hypot(0.02, 0.015 * (1e3 * std) ** 2), rel=0.01)


def test_a_gauge_that_is_wide_as_a_whole_leaves_the_scale_open_as_far_as_it_does_not_vary() -> None:
    n = len(track().s)
    gauge = 2e-3 + 0.5e-3 * np.where(np.arange(n) % 2, 1.0, -1.0)
    for found, beyond in ((None, 2.0), (findings("W1"), 1.5)):
        wide = replace(track(found), gauge_deviation=gauge, scale_std=0.0)
        assert UNCERTAIN.on([wide], "W1").displacement == pytest.approx(np.hypot(0.15 * beyond, 0.0025), rel=0.01)


def test_what_is_not_known_of_the_vehicle_is_the_class_s() -> None:
    usual = ParameterUncertainty.of(PAPER_CLASS)
    assert (usual.creep, usual.stiffness, usual.mass) == (0.10, 0.05, 0.025)
    assert usual.scale == pytest.approx(np.hypot(0.002, 0.002))
    stds = {
        "longitudinal_creep_coefficient": 0.2,
        "yaw_stiffness": 0.3,
        "yaw_inertia": 0.04,
        "nominal_radius": 0.03,
        "half_contact_distance": 0.04,
    }
    own = ParameterUncertainty.of(replace(PAPER_CLASS, relative_std=stds))
    assert (own.creep, own.stiffness, own.mass) == (0.2, 0.3, 0.04)
    assert own.scale == pytest.approx(0.05)


@pytest.mark.parametrize(("gravity", "of_roll"), [(True, 0.008), (False, 0.006)])
def test_the_displacement_of_the_standard_is_known_to_some_thousandths(*, gravity: bool, of_roll: float) -> None:
    sensors = replace(PAPER_CLASS.sensors, measures_gravity=gravity, lateral=SensorChannel(scale_std=0.004))
    found = ParameterUncertainty.of(replace(PAPER_CLASS, sensors=sensors))
    assert found.displacement == pytest.approx(np.hypot(0.004, of_roll))


@pytest.mark.parametrize(
    ("source", "cutoff", "share"),
    [
        (AlignmentSource.RECORDED, np.inf, 1.0),
        (AlignmentSource.FLEET, 30.0, 1.0),
        (AlignmentSource.FLEET, 120.0, 3.0**-1.5),
    ],
)
def test_of_the_error_of_an_alignment_counts_what_the_motion_keeps(
    source: AlignmentSource, cutoff: float, share: float
) -> None:
    """Of a survey all of it; of a fleet's, whose longest waves are known worst, a fifth."""
    known = track(alignment_std=np.full(len(S), 0.5e-3), cutoff_wavelength=cutoff, source=source)
    assert UNCERTAIN.on([known]).alignment_noise == pytest.approx(0.5e-3 * share, rel=1e-9)

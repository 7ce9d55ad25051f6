"""Curves, stops and gaps: what is left out, that nothing of it leaks into the rest, and the reason that is given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_wheelset import SmoothTable, alignment, mems_windows, run, track

from estimation.filters import high_pass, local_cubic_kernel
from estimation.motion.checks import straight, straight_part
from estimation.motion.integration import SignalParameters
from estimation.motion.window_motion import deconvolved, motion
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import AlignmentSource, TrackAlignment, TrackLayout
from estimation.values.windows import Motion, Window
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import Curve, TrackRecipe, make_track

PARAMETERS = SignalParameters()
LIMITS = SignalParameters(sharpest_curvature=1e-4, highest_cant=0.02, curve_margin=30.0)


def moved(window: Window, layout: TrackLayout | None = None) -> Motion:
    found = motion(window, alignment(track(1)), PARAMETERS, layout)
    assert isinstance(found, Motion)
    return found


def layout(*points: tuple[float, float, float]) -> TrackLayout:
    return TrackLayout("S1", 1, *np.array(points).T)


@settings(max_examples=50)
@given(
    corners=st.lists(st.floats(0.0, 2000.0), min_size=4, max_size=8, unique=True),
    radius=st.sampled_from([500.0, -900.0, 3000.0, 9000.0, 30_000.0]),
    cant=st.sampled_from([0.0, 0.01, -0.08]),
)
def test_straight_is_where_nothing_bends_within_the_margin(corners: list[float], radius: float, cant: float) -> None:
    ordered = sorted(corners)
    if min(np.diff(ordered)) < 2.0:
        ordered = [10.0 * i + 100.0 for i in range(len(ordered))]
    values = np.arange(len(ordered)) % 2
    laid = TrackLayout("S1", 1, np.array(ordered), values / radius, values * cant)
    at = np.linspace(-50.0, 2050.0, 701)
    fine = np.arange(ordered[0], ordered[-1], 0.05)
    bent = fine[
        (np.abs(np.interp(fine, laid.s, laid.curvature)) > LIMITS.sharpest_curvature)
        | (np.abs(np.interp(fine, laid.s, laid.cant)) > LIMITS.highest_cant)
    ]
    nearest = np.array([np.abs(bent - x).min() if len(bent) else np.inf for x in at])
    inside = (at >= laid.s[0]) & (at <= laid.s[-1])
    found = straight(at, laid, LIMITS)
    decided = np.abs(nearest - LIMITS.curve_margin) > 1.5  # the layout is looked at every metre
    np.testing.assert_array_equal(found[decided], (inside & (nearest > LIMITS.curve_margin))[decided])


def test_curves_are_left_out_and_do_not_leak_into_the_straight() -> None:
    window = mems_windows(run(60), seed=0)[0]
    start = float(window.distance[0])
    laid = layout(
        (0.0, 0.0, 0.0),
        (start + 500, 0.0, 0.0),
        (start + 560, 1e-3, 0.05),
        (start + 640, 1e-3, 0.05),
        (start + 700, 0.0, 0.0),
        (13_000.0, 0.0, 0.0),
    )
    found = moved(window, laid)
    at = window.distance - start
    inside = (at > 500 - 30 + 5) & (at < 700 + 30 - 5)
    assert not found.valid[inside].any()
    assert found.valid[(at > 30) & (at < 440)].all()
    spoilt = replace(
        window, lateral_acceleration=window.lateral_acceleration + np.where(inside, 50.0 * np.sin(at / 7), 0.0)
    )
    again = moved(spoilt, laid)
    np.testing.assert_array_equal(again.displacement[found.valid], found.displacement[found.valid])


def test_a_simulated_curve_spoils_the_motion_unless_it_is_on_file() -> None:
    curve = Curve(700.0, 400.0, 3000.0, 0.005, 80.0)
    bent = make_track(TrackRecipe(length=2000.0, curves=(curve,)), np.random.SeedSequence(4))
    m = simulate_gear(RunningGear(), [SmoothTable()], bent, np.full(60_000, 20.0), 300.0)[0]
    window = mems_windows(m, seed=0, density=0.0)[0]
    path = m.path_accelerations
    assert path is not None
    window = replace(
        window,
        lateral_acceleration=window.lateral_acceleration + path[0, ::4],
        yaw_acceleration=window.yaw_acceleration + path[1, ::4],
        mass_lateral_acceleration=window.mass_lateral_acceleration + path[3, ::4],
    )
    assert bent.curves is not None
    laid = TrackLayout("S1", 1, bent.s, bent.curves.curvature, bent.curves.cant)
    refused = motion(window, alignment(bent), PARAMETERS)
    assert isinstance(refused, Reason)
    assert "a curve is detected and no layout is stored" in refused.text
    errors = []
    for known in (None, laid):
        found = motion(window, alignment(bent), replace(PARAMETERS, max_cant_deficiency_change=1.0), known)
        assert isinstance(found, Motion)
        true = m.relative_displacement[::4]
        parts = np.flatnonzero(np.diff(np.concatenate([[0], found.valid.astype(int), [0]]))).reshape(-1, 2)
        rest = [(found.displacement - true)[a:b] for a, b in parts]
        errors.append(
            np.concatenate([x - np.polyval(np.polyfit(np.arange(len(x)), x, 1), np.arange(len(x))) for x in rest]).std()
        )
    assert errors[1] < 0.4e-3 < errors[0]


def test_passes_keep_to_the_straight_too() -> None:
    window = mems_windows(run(60), seed=0)[0]
    middle = float(window.distance[7500])
    laid = layout((0.0, 0.0, 0.0), (middle, 0.0, 0.0), (middle + 50.0, 1e-3, 0.0), (13_000.0, 1e-3, 0.0))
    kept = straight_part(window, laid, PARAMETERS)
    assert isinstance(kept, Window)
    assert kept.valid.mean() == pytest.approx(0.5, abs=0.04)
    assert straight_part(window, None, PARAMETERS) is window
    assert straight_part(window, layout((0.0, 1e-3, 0.0), (13_000.0, 1e-3, 0.0)), PARAMETERS) == Reason(
        ReasonCode.IN_CURVES, "all of the window is in curves"
    )
    leaning = replace(
        window,
        lateral_acceleration=window.lateral_acceleration + np.where(window.distance > middle, 0.2, 0.0),
        mass_lateral_acceleration=window.mass_lateral_acceleration + np.where(window.distance > middle, 0.2, 0.0),
    )
    refused = straight_part(leaning, None, PARAMETERS)
    assert isinstance(refused, Reason)
    assert "changes by 0.2" in refused.text


def test_stops_are_left_out_and_do_not_leak_into_the_running() -> None:
    t = np.arange(60_000) * 1e-3
    speed = np.interp(t, [0, 12, 24, 32, 36, 48, 60], [20, 20, 0, 0, 4, 20, 20])
    m = simulate_gear(RunningGear(), [SmoothTable()], track(1), speed, 10.0)[0]
    window = mems_windows(m, seed=0)[0]
    found = moved(window)
    assert not found.valid[window.speed < PARAMETERS.least_speed_m_s].any()
    assert found.valid.any()
    slow = window.speed < 1.0
    kicked = replace(window, lateral_acceleration=window.lateral_acceleration + np.where(slow, 3.0, 0.0))
    again = moved(kicked)
    np.testing.assert_array_equal(again.valid, found.valid)
    np.testing.assert_array_equal(again.displacement[found.valid], found.displacement[found.valid])


def test_a_gap_of_a_tenth_of_a_second_costs_a_second_and_not_the_stretch() -> None:
    window = mems_windows(run(60), seed=0)[0]
    valid = window.valid.copy()
    valid[6000:6025] = False
    acceleration = np.where(valid, window.lateral_acceleration, np.nan)
    found, whole = moved(replace(window, valid=valid, lateral_acceleration=acceleration)), moved(window)
    expected = whole.valid.copy()
    expected[6000 - 125 : 6025 + 125] = False
    np.testing.assert_array_equal(found.valid, expected)
    near = slice(5000, 7000)
    kept = found.valid[near]
    assert (found.displacement - whole.displacement)[near][kept].std() < 0.25e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"valid": np.arange(15_000) % 2000 < 1500}, ["uninterrupted run of 10 s", "23% missing, clipped or invalid"]),
        (
            {"speed": np.where(np.arange(15_000) < 3000, 20.0, 3.0)},
            ["17% of the samples can be used, 20% are needed", "80% slower than 8 m/s"],
        ),
    ],
)
def test_a_window_that_loses_too_much_says_what_it_lost(change: dict[str, np.ndarray], words: list[str]) -> None:
    window = replace(mems_windows(run(60), seed=0)[0], **change)
    found = motion(window, alignment(track(1)), replace(PARAMETERS, least_used=0.2))
    assert isinstance(found, Reason)
    for word in words:
        assert word in found.text


def test_a_window_in_a_curve_says_so() -> None:
    window = mems_windows(run(60), seed=0)[0]
    found = motion(window, alignment(track(1)), PARAMETERS, layout((0.0, 1e-3, 0.0), (13_000.0, 1e-3, 0.0)))
    assert found == Reason(ReasonCode.NO_USABLE_SAMPLE, "no sample can be used: 100% in curves")


def fleet_alignment(cutoff_wavelength: float) -> TrackAlignment:
    """Return the alignment of track 1 as a fleet would find it: high-passed, unknown at its ends."""
    known = alignment(track(1))
    weights = local_cubic_kernel(cutoff_wavelength, float(known.s[1] - known.s[0]))
    high = high_pass(known.alignment, weights)
    reach = len(weights) // 2
    high[:reach] = high[-reach:] = np.nan
    return replace(known, alignment=high, source=AlignmentSource.FLEET, cutoff_wavelength=cutoff_wavelength)


def test_an_alignment_without_long_waves_serves_as_well_as_a_whole_one() -> None:
    window = mems_windows(run(60), seed=0, density=0.0)[0]
    short = motion(window, fleet_alignment(40.0), PARAMETERS)
    assert isinstance(short, Motion)
    whole = moved(window)
    both = short.valid & whole.valid
    assert both.mean() > 0.85
    inner = both.copy()
    inner[: np.flatnonzero(short.valid)[0] + 500] = False
    assert (short.displacement - whole.displacement)[inner].std() < 0.02e-3


def test_where_the_alignment_is_not_known_nothing_is_restored_or_used() -> None:
    known = fleet_alignment(40.0)
    holed = known.alignment.copy()
    holed[(known.s > 600) & (known.s < 640)] = np.nan
    track_ = replace(known, alignment=holed)
    assert not np.isfinite(deconvolved(track_)[(known.s > 565) & (known.s < 675)]).any()
    found = motion(mems_windows(run(60), seed=0)[0], track_, PARAMETERS)
    assert isinstance(found, Motion)
    at = mems_windows(run(60), seed=0)[0].distance
    assert not found.valid[(at > 565) & (at < 675)].any()

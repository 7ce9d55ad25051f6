"""Where the gauge puts a wheelset along a window, and what the estimate makes of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from smooth_wheelset import alignment, mems_windows, run, track

from estimation.filters import remove_wander
from estimation.motion.integration import SignalParameters
from estimation.motion.window_motion import gauge_shift, motion
from estimation.values.arrays import FloatArray
from estimation.values.track import GaugeShift, TrackAlignment, TrackFindings
from estimation.values.windows import Motion, Window
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.motion import WheelsetMotion

SIGNALS = SignalParameters()
VEHICLE = VehicleParameters()
CONE = 0.12
PER_DIFFERENCE, PER_GAUGE = 0.3, 0.25  # the table of the wheelset is straight in both


def wheelset_motion() -> WheelsetMotion:
    return run(60, cone=CONE)


@cache
def window() -> Window:
    return mems_windows(wheelset_motion(), seed=0, density=0.0)[0]


def known(*, per_difference: float = PER_DIFFERENCE, ratio: float = 1.0, serial: str = "W1") -> TrackAlignment:
    """Return the section with a gauge of 2 mm amplitude and 40 m of length, as its passes determined it."""
    place = alignment(track(1))
    difference, gauge = np.linspace(-8e-3, 8e-3, 33), np.linspace(-4e-3, 4e-3, 17)
    table = GaugeShift(difference, gauge, per_difference * difference[:, None] + PER_GAUGE * gauge[None, :])
    return replace(
        place,
        gauge_deviation=2e-3 * np.sin(2 * np.pi * place.s / 40.0),
        findings=TrackFindings({"V1": ratio}, 0.01, {serial: table}),
    )


def shift_of(place: TrackAlignment, seen: Window | None = None) -> FloatArray:
    found = gauge_shift(seen or window(), place, VEHICLE, SIGNALS)
    assert found is not None
    return found


def test_the_shift_is_that_of_the_table_at_the_radius_difference_of_the_wheelset() -> None:
    m, found = wheelset_motion(), shift_of(known())
    true = (m.rolling_radius_left - m.rolling_radius_right)[::4]
    e = 2e-3 * np.sin(2 * np.pi * window().distance / 40.0)
    inner = slice(len(true) // 6, -len(true) // 6)
    expected = PER_GAUGE * e + PER_DIFFERENCE * (true - true[inner].mean())
    wrong = (found - expected)[inner]
    assert (wrong - wrong.mean()).std() < 0.1 * PER_DIFFERENCE * true[inner].std()
    assert np.isfinite(found[inner]).all()


def test_nothing_is_said_of_a_wheelset_that_the_section_has_not_met() -> None:
    assert gauge_shift(window(), known(serial="W2"), VEHICLE, SIGNALS) is None
    assert gauge_shift(window(), alignment(track(1)), VEHICLE, SIGNALS) is None


def test_samples_off_the_section_or_not_valid_have_no_shift() -> None:
    valid = window().valid.copy()
    valid[7000:7200] = False
    found = shift_of(known(), replace(window(), valid=valid))
    assert np.isnan(found[7000:7200]).all()
    short = known()
    end = float(window().distance[10_000])
    part = short.s <= end
    cut = replace(
        short,
        **{
            name: getattr(short, name)[part]
            for name in ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes")
        },
    )
    found = shift_of(cut)
    assert np.isnan(found[10_050:]).all()
    assert np.isfinite(found[2000:9000]).all()


def moved(shift: FloatArray | None) -> Motion:
    found = motion(window(), alignment(track(1)), SIGNALS, None, shift)
    assert isinstance(found, Motion)
    return found


def test_the_displacement_is_that_at_nominal_gauge_behind_the_same_filter() -> None:
    shift = shift_of(known(per_difference=0.0))
    plain, taken_off = moved(None), moved(np.where(np.isfinite(shift), shift, 0.0))
    (expected,) = remove_wander(
        np.nan_to_num(shift)[None, :],
        window().distance - window().distance[0],
        window().valid,
        SIGNALS.cutoff_wavelength,
    )
    both = plain.valid & taken_off.valid
    assert both.mean() > 0.8
    difference = (plain.displacement - taken_off.displacement)[both]
    np.testing.assert_allclose(difference, expected[both], atol=0.01e-3)
    assert expected[both].std() > 0.1e-3
    np.testing.assert_array_equal(plain.yaw[both], taken_off.yaw[both])


@pytest.mark.parametrize("ratio", [0.8, 1.25])
def test_the_stiffness_ratio_of_the_vehicle_scales_the_elastic_part(ratio: float) -> None:
    """Twice the ratio above one is twice the change."""
    one, two = (shift_of(known(ratio=value)) for value in (1.0, ratio))
    further = shift_of(known(ratio=1.0 + 2 * (ratio - 1.0)))
    inner = slice(2000, -2000)
    assert (two - one)[inner].std() > 0.01 * one[inner].std()
    np.testing.assert_allclose((further - one)[inner], 2 * (two - one)[inner], atol=1e-9)

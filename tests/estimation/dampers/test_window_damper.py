"""What a window says of a damper, on motion whose answer is known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sinusoids import DENSITY, SENSORS, SINGLE, SOFT, judged, windows_of

from estimation.adhesion.creep_forces import gear_segments
from estimation.dampers import damper
from estimation.dampers.damper import DamperParameters, looked_at, not_judged, posterior
from estimation.dampers.damper_filters import add_products, damper_filters, gain_std, of_signals
from estimation.dampers.parameters import DAMPING
from estimation.motion.integration import SignalParameters
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.sums import SHARES
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import SensorChannel, VehicleClass


@pytest.mark.parametrize("vehicle_class", [SOFT, SINGLE])
@pytest.mark.parametrize("particle", [4, 7, 10])
def test_the_filter_of_the_true_share_predicts_all_that_is_measured(vehicle_class: VehicleClass, particle: int) -> None:
    windows = windows_of(vehicle_class, SHARES[particle], noise=0.0)
    found = judged(windows, vehicle_class)
    assert found.sums is not None
    squares = found.sums.products[:, 0, 0]
    others = np.delete(squares, particle)
    assert squares[particle] < 0.05 * others.min()


@pytest.mark.parametrize(("vehicle_class", "share"), [(SOFT, 0.9), (SOFT, 0.25), (SOFT, 0.0), (SINGLE, 0.6)])
def test_the_share_is_within_a_few_of_its_stds(vehicle_class: VehicleClass, share: float) -> None:
    found = judged(windows_of(vehicle_class, share), vehicle_class)
    assert found.sums is not None
    said = posterior(found.sums.products, found.sums.curved, DamperParameters())
    assert said is not None
    assert abs(said.share - share) < 3.0 * said.std
    assert said.std < 0.05
    assert found.innovation is not None
    assert found.innovation < 0.2


def test_sensors_of_another_scale_at_one_axle_are_not_taken_for_damping() -> None:
    front, rear = windows_of(SOFT, 0.3)
    scaled = [replace(front, mass_lateral_acceleration=1.02 * front.mass_lateral_acceleration), rear]
    sums = judged(scaled, SOFT).sums
    assert sums is not None
    said = posterior(sums.products, sums.curved, DamperParameters())
    assert said is not None
    assert abs(said.share - 0.3) < 0.03


def spoilt(window: Window, factor: float, noise: float = 0.0) -> Window:
    values = factor * window.mass_lateral_acceleration
    values = values + noise * np.random.default_rng(3).standard_normal(len(values))
    return replace(window, mass_lateral_acceleration=values)


@pytest.mark.parametrize(("factor", "noise"), [(-1.0, 0.0), (0.0, 0.0), (3.0, 0.0), (1.0, 1.0)])
def test_a_sensor_above_that_is_wrong_makes_the_window_diverge(factor: float, noise: float) -> None:
    front, rear = windows_of(SOFT, 1.0)
    found = judged([spoilt(front, factor, noise), rear], SOFT)
    assert found.sums is None
    assert found.reason is not None
    assert found.reason.code is ReasonCode.DIVERGED


def test_the_limit_of_innovations_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    front, rear = windows_of(SOFT, 1.0)
    windows = [spoilt(front, 1.0, 0.2), rear]
    found = judged(windows, SOFT)
    assert found.innovation is not None
    assert 0.1 < found.innovation < 1.0
    assert DAMPING.most_unexplained_share == 0.05
    less = replace(damper.DAMPING, most_unexplained_share=0.05 * 0.5 * found.innovation)
    monkeypatch.setattr(damper, "DAMPING", less)
    assert judged(windows, SOFT).sums is None


def test_what_stiff_bodies_do_not_explain_bounds_the_weight_of_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    assert DAMPING.model_error == 0.02
    windows = windows_of(SOFT, 1.0)
    stds = []
    for error in (0.02, 0.04):
        monkeypatch.setattr(damper, "DAMPING", replace(damper.DAMPING, model_error=error))
        sums = judged(windows, SOFT).sums
        assert sums is not None
        said = posterior(sums.products, sums.curved, DamperParameters())
        assert said is not None
        stds.append(said.std)
    assert stds[1] > 1.2 * stds[0]


@pytest.mark.parametrize(("size", "excited"), [(0.0, False), (3e-4, False), (1e-3, False), (5e-3, True)])
def test_motion_that_shows_no_more_than_noise_does_is_not_judged(size: float, excited: bool) -> None:  # noqa: FBT001 - a case
    found = judged(windows_of(SOFT, 0.3, size=size), SOFT)
    assert (found.sums is not None) == excited
    assert excited or (found.reason is not None and found.reason.code is ReasonCode.DAMPER_NOT_EXCITED)
    assert DAMPING.least_excitation == 3.0


def test_short_windows_say_nothing() -> None:
    assert DAMPING.fewest_samples == 600.0
    cut = [replace(one, valid=np.arange(len(one.valid)) < 60.0 * 250 / 60 * 16) for one in windows_of(SOFT, 1.0)]
    found = judged(cut, SOFT)
    assert found.reason is not None
    assert found.reason.code is ReasonCode.TOO_FEW_USABLE
    longer = [replace(one, valid=np.arange(len(one.valid)) < 250 * 22) for one in windows_of(SOFT, 1.0)]
    assert judged(longer, SOFT).sums is not None


def test_a_few_lost_samples_hardly_change_what_is_said() -> None:
    windows = windows_of(SOFT, 0.5)
    lost = np.random.default_rng(0).uniform(size=len(windows[0].valid)) < 2e-3
    whole, gapped = (judged(w, SOFT) for w in (windows, [replace(one, valid=~lost) for one in windows]))
    assert whole.sums is not None
    assert gapped.sums is not None
    one, other = (posterior(sums.products, sums.curved, DamperParameters()) for sums in (whole.sums, gapped.sums))
    assert one is not None
    assert other is not None
    assert abs(one.share - other.share) < 0.01


def test_classes_without_a_damper_or_with_loose_springs_are_not_judged() -> None:
    bogie = SOFT.bogie
    assert bogie is not None
    without = not_judged(replace(SOFT, bogie=replace(bogie, secondary_lateral_damping=0.0)))
    assert without is not None
    assert without.code is ReasonCode.DAMPER_NOT_ON_FILE
    for std, refused in ((0.29, False), (0.31, True)):
        reason = not_judged(replace(SOFT, relative_std={"secondary_lateral_stiffness": std}))
        assert (reason is not None) == refused
        assert reason is None or reason.code is ReasonCode.SUSPENSION_UNCERTAIN


def test_scales_of_sensors_count_by_what_is_on_file_and_at_least_a_hundredth() -> None:
    loose = replace(SENSORS, lateral=SensorChannel(DENSITY, 0.03), mass_lateral=SensorChannel(DENSITY, 0.04))
    assert gain_std(SOFT) == pytest.approx(0.01)
    assert gain_std(replace(SOFT, sensors=loose)) == pytest.approx(0.05 / np.sqrt(2.0))
    assert damper_filters(SOFT, 0.004).apart == pytest.approx((0.01 / np.sqrt(2.0), 0.01 / np.sqrt(2.0)))
    assert DAMPING.clock_std_s == 1e-3


def test_what_noise_adds_to_the_products_is_known() -> None:
    """Accelerations that are noise alone, through the filters: the products of their samples are those on file."""
    filters, count = damper_filters(SOFT, 0.004), 20
    variants = len(filters.source) + 1
    products = np.zeros((len(SHARES) - 1, variants, variants))
    samples = 0
    for number in range(count):
        gear = gear_segments(windows_of(SOFT, 1.0, number, size=0.0), SOFT, SignalParameters())
        assert not isinstance(gear, Reason)
        for segment in gear.segments:
            taken = damper._accelerations_and_count(segment, gear, filters.apart)
            assert taken is not None
            add_products(filters, taken[0], taken[1], taken[2], products)
            samples += int(taken[2].sum())
    found = of_signals(filters, products) / samples
    scale = np.sqrt(np.einsum("paa->pa", filters.noise))
    apart = (found - filters.noise) / (scale[:, :, None] * scale[:, None, :])
    assert np.abs(apart).max() < 0.4
    assert np.abs(apart).mean() < 0.03


@pytest.mark.parametrize("stride", [1, 3, 15, 60])
def test_one_of_three_windows_is_looked_at_however_a_recorder_runs(stride: int) -> None:
    (first, *_) = windows_of(SOFT, 1.0)
    starts = [stride * number * first.length_ns + 7 for number in range(600)]
    share = np.mean([looked_at(replace(first, start_ns=start_ns)) for start_ns in starts])
    assert 0.27 < share < 0.40
    assert DAMPING.window_stride == 3

"""Windows pooled to the damper of a running gear: the same in any order, refused where it cannot be known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sinusoids import SINGLE, SOFT, judged, several, stiffer, windows_of

from estimation.dampers.damper import DamperParameters, gear_damper
from estimation.values.opinions import GearDamper, WindowDamper
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window

USUAL = DamperParameters()


@cache
def of_soft(share: float, count: int = 6, first: int = 0) -> tuple[WindowDamper, ...]:
    return tuple(several(SOFT, share, count, first))


def code_of(found: GearDamper) -> ReasonCode | None:
    return None if found.share.reason is None else found.share.reason.code


@pytest.mark.parametrize("share", [1.0, 0.5, 0.2])
def test_the_interval_covers_the_true_share(share: float) -> None:
    found = gear_damper(of_soft(share), USUAL)
    assert found.share.value is not None
    assert found.share.low is not None
    assert found.share.high is not None
    assert found.share.low < share < found.share.high
    assert found.share.high - found.share.low < 0.26
    assert (found.windows, found.diverged, found.refused) == (6, 0, 0)
    assert found.share.count == 6.0


def test_a_single_wheelset_has_the_damper_above_it() -> None:
    found = gear_damper(several(SINGLE, 0.3, 4), USUAL)
    assert found.share.low is not None
    assert found.share.high is not None
    assert found.share.low < 0.3 < found.share.high
    assert found.weak


def test_the_order_of_windows_does_not_matter() -> None:
    windows = list(of_soft(0.5))
    forward = gear_damper(windows, USUAL)
    np.random.default_rng(1).shuffle(windows)  # type: ignore[arg-type]
    assert gear_damper(windows, USUAL) == forward


def test_half_of_the_damping_and_nine_tenths_of_probability_decide() -> None:
    weak, half, whole = (gear_damper(of_soft(share), USUAL) for share in (0.2, 0.5, 1.0))
    assert (weak.weak, half.weak, whole.weak) == (True, False, False)
    assert half.weak_probability is not None
    assert 0.1 < half.weak_probability < 0.9
    probability = half.weak_probability
    assert gear_damper(of_soft(0.5), replace(USUAL, likely=probability - 1e-6)).weak
    assert not gear_damper(of_soft(0.5), replace(USUAL, likely=probability + 1e-6)).weak
    assert gear_damper(of_soft(1.0), replace(USUAL, weak_share=1.5)).weak
    assert (USUAL.weak_share, USUAL.likely) == (0.5, 0.9)


def test_the_interval_holds_what_is_not_known_of_the_mass() -> None:
    known, loose = (
        gear_damper([replace(one, mass_std=std) for one in of_soft(1.0)], USUAL).share for std in (0.0, 0.1)
    )
    assert known.std is not None
    assert loose.std is not None
    assert known.value is not None
    assert loose.std == pytest.approx(np.hypot(known.std, 0.1 * known.value), rel=1e-6)
    assert known.std > np.hypot(0.05 * known.value, 0.01)
    assert (DamperParameters().model_share_std, DamperParameters().least_share_std) == (0.05, 0.01)


def test_few_windows_say_nothing() -> None:
    assert code_of(gear_damper(of_soft(1.0)[:3], USUAL)) is ReasonCode.TOO_FEW_WINDOWS
    assert gear_damper(of_soft(1.0)[:4], USUAL).share.value is not None
    assert gear_damper(of_soft(1.0)[:3], USUAL).weak is None


def test_the_reason_of_windows_is_that_of_the_gear_where_none_says_anything() -> None:
    reason = Reason(ReasonCode.SUSPENSION_UNCERTAIN, "springs")
    windows = [replace(one, sums=None, reason=reason) for one in of_soft(1.0)]
    found = gear_damper(windows, USUAL)
    assert code_of(found) is ReasonCode.SUSPENSION_UNCERTAIN
    assert (found.windows, found.refused) == (0, 6)


def test_more_than_a_fifth_of_diverged_windows_is_a_mismatch() -> None:
    reason = Reason(ReasonCode.DIVERGED, "diverged")
    windows = of_soft(1.0, 8)
    one, two = (
        [replace(w, sums=None, reason=reason) if 0 < i <= k else w for i, w in enumerate(windows)] for k in (1, 2)
    )
    assert gear_damper(one, USUAL).share.status is Status.ESTIMATED
    assert gear_damper(one, USUAL).diverged == 1
    found = gear_damper(two, USUAL)
    assert (found.share.status, code_of(found)) == (Status.MODEL_MISMATCH, ReasonCode.DIVERGED)
    assert USUAL.most_diverged == 0.2


def late(window: Window) -> Window:
    return replace(window, mass_lateral_acceleration=np.roll(window.mass_lateral_acceleration, 2))


def test_a_vehicle_of_no_class_is_a_mismatch() -> None:
    """Windows that a filter follows with parameters that no vehicle of the class has."""
    heavier = several(SOFT, 1.0, 4, on_file=stiffer(SOFT, body_mass=0.5, frame_mass=1.4))
    delayed = [judged([late(one) for one in windows_of(SOFT, 1.0, k)], SOFT) for k in range(4)]
    for windows in (heavier, delayed):
        found = gear_damper(windows, USUAL)
        assert (found.share.status, code_of(found)) == (Status.MODEL_MISMATCH, ReasonCode.DIVERGED)
    kept = gear_damper(heavier, replace(USUAL, parameter_error_quantile=1.0 - 1e-300))
    assert code_of(kept) is not ReasonCode.DIVERGED
    assert USUAL.parameter_error_quantile == 0.99


def test_a_share_beyond_the_particles_is_a_mismatch() -> None:
    found = gear_damper(several(SOFT, 1.0, 4, on_file=stiffer(SOFT, secondary_lateral_damping=0.45)), USUAL)
    assert code_of(found) is ReasonCode.DIVERGED
    assert DamperParameters().largest_share == 1.9


def test_a_damper_that_hardly_moves_is_not_judged() -> None:
    windows = [judged(windows_of(SOFT, 0.3, k, size=3e-4), SOFT) for k in range(6)]
    found = gear_damper(windows, USUAL)
    assert code_of(found) is ReasonCode.DAMPER_NOT_EXCITED
    assert (found.weak, found.refused) == (None, 6)
    found = gear_damper(of_soft(1.0), USUAL)
    assert found.share.std is not None
    narrow = gear_damper(of_soft(1.0), replace(USUAL, widest_std=0.99 * found.share.std))
    assert code_of(narrow) is ReasonCode.DAMPER_NOT_EXCITED
    assert USUAL.widest_std == 0.2


def test_a_damper_that_changed_is_judged_by_the_newer_windows() -> None:
    changed = gear_damper([*of_soft(1.0, 8), *of_soft(0.2, 8, 8)], USUAL)
    assert changed.share.high is not None
    assert changed.share.high < 0.3
    assert changed.from_ns == 8 * 60_000_000_000
    same = gear_damper([*of_soft(1.0, 8), *several(SOFT, 1.0, 8, 8)], USUAL)
    assert same.windows == 16


def test_windows_of_another_class_and_from_long_ago_do_not_count() -> None:
    other = [replace(one, class_digest="other") for one in of_soft(0.2)]
    newest = of_soft(1.0, 6, 6)
    assert gear_damper([*other, *newest], USUAL) == gear_damper(newest, USUAL)
    long_ago = [replace(one, odometer_km=newest[-1].odometer_km - 5000.1) for one in of_soft(1.0)]
    assert gear_damper([*long_ago, *newest], USUAL).windows == 6
    within = [replace(one, odometer_km=newest[-1].odometer_km - 4999.9) for one in of_soft(1.0)]
    assert gear_damper([*within, *newest], USUAL).windows == 12

"""When a new alignment becomes a version, and what it takes over from the version before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.track.settings import (
    AlignmentSettings,
    carry_over_findings,
    changed_vehicles,
    gauge_shift_changed,
    requires_reestimation,
)
from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource, GaugeShift, TrackAlignment, TrackFindings


def test_only_what_matters_is_another_alignment() -> None:
    settings = AlignmentSettings()
    n = 2000
    rng = np.random.default_rng(1)
    d, zero = 1e-3 * rng.standard_normal(n), np.zeros(n)
    std = np.full(n, 0.1e-3)
    old = TrackAlignment(
        "S1",
        1,
        np.arange(n) * 1.0,
        d,
        std,
        zero,
        zero,
        np.full(n, 5),
        Status.ESTIMATED,
        AlignmentSource.FLEET,
        60.0,
        0.0,
        False,  # noqa: FBT003 - the gauge is not known
    )
    hole = np.where(np.arange(n) < 100, np.nan, d)
    assert not requires_reestimation(old, replace(old, version=2), settings)
    assert not requires_reestimation(old, replace(old, alignment=d + 0.08e-3), settings)
    assert requires_reestimation(old, replace(old, alignment=d + 0.12e-3), settings)
    assert not requires_reestimation(old, replace(old, alignment=1.004 * d), settings)
    assert requires_reestimation(old, replace(old, alignment=1.006 * d), settings)  # does not average out
    assert requires_reestimation(old, replace(old, alignment_std=0.4 * std), settings)
    assert requires_reestimation(replace(old, alignment=hole), old, settings)
    assert requires_reestimation(old, replace(old, cutoff_wavelength=np.inf), settings)
    assert requires_reestimation(replace(old, scale_std=0.03), replace(old, scale_std=0.01), settings)
    sure = replace(old, alignment_std=0.1 * std)
    assert not requires_reestimation(sure, replace(sure, alignment=d + 0.04e-3, alignment_std=0.01 * std), settings)
    assert requires_reestimation(sure, replace(sure, alignment=d + 0.06e-3), settings)
    wide = 1e-3 * rng.standard_normal(n)
    assert requires_reestimation(old, replace(old, gauge_deviation=wide), settings)
    assert not requires_reestimation(old, replace(old, gauge_deviation=0.1 * wide), settings)


def test_what_is_found_of_one_vehicle_matters_for_that_one() -> None:
    settings, zero = AlignmentSettings(), np.zeros(3)
    old = TrackAlignment("S1", 1, np.arange(3.0), zero, zero, zero, zero, zero.astype(np.int64), Status.ESTIMATED)
    of_wheelsets = {"A1": "A", "A2": "A", "B1": "B"}

    def changed(before: TrackFindings | None, after: TrackFindings | None, **known: object) -> dict[str, float]:
        was, now = (replace(old, findings=one) for one in (before, after))
        assert not requires_reestimation(was, now, settings)
        return changed_vehicles(was, now, settings, of_wheelsets, **known)  # type: ignore[arg-type]

    one = TrackFindings({"A": 0.96}, 0.01, {})
    assert changed(one, TrackFindings({"A": 0.975}, 0.01, {})) == {}
    assert changed(one, TrackFindings({"A": 0.99}, 0.01, {})) == {"A": 0.99}
    assert changed(one, TrackFindings({"A": 0.99}, 0.01, {}), since={"A": 0.98}) == {}
    assert changed(one, TrackFindings({"A": 0.96, "B": 1.0}, 0.01, {})) == {"B": 1.0}  # of B nothing was known
    assert changed(replace(one, stiffness_ratio_std=0.04), TrackFindings({"A": 0.99}, 0.01, {})) == {}
    assert changed(None, None) == changed(one, None) == {}
    wheel = GaugeShift(np.linspace(-5e-3, 5e-3, 3), np.linspace(-4e-3, 4e-3, 2), np.zeros((3, 2)))
    first, both = TrackFindings({}, 0.01, {"A1": wheel}), TrackFindings({}, 0.01, {"A1": wheel, "B1": wheel})
    assert changed(None, first) == {"A": 1.0}
    assert changed(first, both) == {"B": 1.0}
    assert changed(both, both) == {}
    assert changed(None, both, last=replace(old, findings=first)) == {"B": 1.0}  # A has been met since
    assert changed(first, TrackFindings({}, 0.01, {"A1": wheel, "Z1": wheel})) == {}  # Z1 has not passed


def test_another_gauge_shift_is_one_that_noise_does_not_make() -> None:
    settings, n = AlignmentSettings(), 2000
    gauge = 1e-3 * np.random.default_rng(1).standard_normal(n)
    R, e = np.linspace(-6e-3, 6e-3, 25), np.linspace(-4e-3, 4e-3, 17)

    def with_shift(per_gauge: float | None) -> TrackAlignment:
        table = {} if per_gauge is None else {"A": GaugeShift(R, e, per_gauge * np.sign(R)[:, None] * e[None, :])}
        zero = np.zeros(n)
        return TrackAlignment(
            "S1", 1, np.arange(n) * 1.0, zero, zero, gauge, zero, zero.astype(np.int64), Status.ESTIMATED,
            findings=TrackFindings({}, 0.01, table),
        )  # fmt: skip

    assert not gauge_shift_changed(with_shift(0.1), with_shift(0.2), settings)
    assert gauge_shift_changed(with_shift(0.1), with_shift(0.3), settings)
    assert not gauge_shift_changed(with_shift(None), with_shift(0.3), settings)
    assert not gauge_shift_changed(replace(with_shift(0.1), findings=None), with_shift(0.3), settings)


def test_what_was_found_of_those_who_stayed_away_is_kept() -> None:
    n, rng = 500, np.random.default_rng(1)
    zero, gauge = np.zeros(n), 1e-3 * rng.standard_normal(n)
    wheel = GaugeShift(np.linspace(-5e-3, 5e-3, 3), np.linspace(-4e-3, 4e-3, 2), np.zeros((3, 2)))
    base = TrackAlignment(
        "S1", 1, np.arange(n) * 1.0, zero, zero, gauge, zero, np.full(n, 5), Status.ESTIMATED, AlignmentSource.FLEET
    )  # fmt: skip
    before = replace(base, findings=TrackFindings({"A": 0.9, "B": 1.1}, 0.02, {"A1": wheel, "B1": wheel}))
    again = replace(base, gauge_deviation=gauge + 0.3e-3 * rng.standard_normal(n))
    epoch = TrackFindings({"A": 0.95}, 0.01, {"A1": wheel})
    kept = carry_over_findings(replace(again, findings=epoch), before).findings
    assert kept is not None
    assert (kept.stiffness_ratio, kept.stiffness_ratio_std) == ({"A": 0.95, "B": 1.1}, 0.02)
    assert set(kept.gauge_shifts) == {"A1", "B1"}
    other = carry_over_findings(replace(base, gauge_deviation=-gauge, findings=epoch), before).findings
    assert other is not None
    assert set(other.gauge_shifts) == {"A1"}  # the gauge under the others was another one
    every = replace(epoch, stiffness_ratio={"A": 1.0, "B": 1.0})
    found = replace(again, findings=every)
    assert carry_over_findings(found, before).findings == replace(every, gauge_shifts=kept.gauge_shifts)
    assert carry_over_findings(found, None) is found

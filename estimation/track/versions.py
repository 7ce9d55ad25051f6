"""What an epoch's alignment changes: differences that matter, and what is carried over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimation.track.settings import AlignmentSettings
from estimation.values.arrays import FloatArray
from estimation.values.track import GaugeShift, TrackAlignment, TrackFindings

SAME_GAUGE = 0.8  # correlation of two estimates of one gauge
SMALLEST = float(np.finfo(np.float64).tiny)  # in place of a power of zero
OFTEN = 1e-3  # m of rL - rR, both ways: further out few passes are


def requires_reestimation(old: TrackAlignment, new: TrackAlignment, settings: AlignmentSettings) -> bool:
    """Whether what was estimated with ``old`` should be estimated again with ``new``.

    It should where ``new`` differs by more than ``old`` left unknown, is much more certain, reaches further, knows
    more of the section, or holds another gauge. What it holds of one vehicle matters for that one's windows alone:
    ``changed_vehicles``.
    """
    if old.source != new.source or old.cutoff_wavelength != new.cutoff_wavelength or old.gauge_known != new.gauge_known:
        return True
    if len(old.s) != len(new.s) or not np.array_equal(old.s, new.s):
        return True
    before, after = np.isfinite(old.alignment), np.isfinite(new.alignment)
    if (before != after).mean() > settings.same_coverage:
        return True
    both = before & after
    if not both.any():
        return False
    gauge = np.sqrt(np.mean((new.gauge_deviation - old.gauge_deviation)[both] ** 2))
    std, std_now = (np.sqrt(np.mean(one.alignment_std[both] ** 2)) for one in (old, new))
    more_certain = std > settings.same_least and std_now < settings.same_std * std
    scale_known = old.scale_std > settings.same_scale and new.scale_std < settings.same_std * old.scale_std
    return bool(
        _moved(old.alignment[both], new.alignment[both], float(std), settings)
        or gauge > settings.same_gauge
        or more_certain
        or scale_known
    )


def _moved(old: FloatArray, new: FloatArray, std: float, settings: AlignmentSettings) -> bool:
    """Whether two alignments differ by more than averages out."""
    difference = new - old
    stretch = abs(float(difference @ old)) / max(float(old @ old), SMALLEST)
    far = float(np.sqrt(np.mean(difference**2))) > max(settings.same_share * std, settings.same_least)
    return far or stretch > settings.same_stretch


def changed_vehicles(
    old: TrackAlignment,
    new: TrackAlignment,
    settings: AlignmentSettings,
    vehicles: Mapping[str, str],
    since: Mapping[str, float] | None = None,
    last: TrackAlignment | None = None,
) -> dict[str, float]:
    """Return the stiffness ratio of every vehicle whose windows should be estimated again with ``new``, if none else.

    Its ratio is another, or was not known; or the gauge moves a wheelset of it by what was not known.

    Args:
        vehicles: Vehicle of every wheelset that has passed, by serial.
        since: Ratios of vehicles whose windows have been estimated with a later version than ``old``.
        last: The version before ``new``; by default ``old``.
    """
    if new.findings is None:
        return {}
    was = old.findings or TrackFindings({}, 0.0, {})
    before, after = {**was.stiffness_ratio, **(since or {})}, new.findings.stiffness_ratio
    same = max(settings.same_ratio, 2.0 * was.stiffness_ratio_std)
    found = {
        vehicle
        for vehicle in before.keys() | after.keys()
        if vehicle not in before or abs(after.get(vehicle, 1.0) - before[vehicle]) > same
    }
    known = was if last is None or last.findings is None else last.findings
    met = new.findings.gauge_shifts.keys() - known.gauge_shifts.keys()
    found |= {vehicles[wheelset] for wheelset in met & vehicles.keys()}
    return {vehicle: after.get(vehicle, 1.0) for vehicle in sorted(found)}


def gauge_shift_changed(old: TrackAlignment, new: TrackAlignment, settings: AlignmentSettings) -> bool:
    """Whether ``new`` holds another gauge shift of a wheelset, as after wear or the lathe; both on one gauge."""
    if old.findings is None or new.findings is None:
        return False
    size = float(np.std(new.gauge_deviation))
    before, after = old.findings.gauge_shifts, new.findings.gauge_shifts
    return any(_apart(before[one], after[one], size) > settings.same_shift * size for one in before.keys() & after)


def _apart(first: GaugeShift, second: GaugeShift, size: float) -> float:
    """Return the rms, m, by which two shifts differ at gauge deviations of -size and size, m, where passes are."""
    R, e = OFTEN * np.linspace(-1.0, 1.0, 41), np.array([-size, size])
    return float(np.sqrt(np.mean((first.over(R, e) - second.over(R, e)) ** 2)))


def carry_over_findings(found: TrackAlignment, before: TrackAlignment | None) -> TrackAlignment:
    """Return an alignment that also holds what was found of vehicles and wheelsets that this epoch has not met.

    Their windows are estimated again with it as those of the others. Shifts belong to the gauge that
    makes them: it stays where the epoch has found that gauge again.
    """
    if before is None or before.findings is None or found.findings is None:
        return found
    old, new = before.findings, found.findings
    shifts = dict(new.gauge_shifts)
    if shifts and _alike(before.gauge_deviation, found.gauge_deviation):
        shifts = {**old.gauge_shifts, **shifts}
    missed = old.stiffness_ratio.keys() - new.stiffness_ratio.keys()
    std = max(new.stiffness_ratio_std, old.stiffness_ratio_std) if missed else new.stiffness_ratio_std
    ratios = {**old.stiffness_ratio, **new.stiffness_ratio}
    return replace(found, findings=TrackFindings(ratios, std, shifts))


def _alike(first: FloatArray, second: FloatArray) -> bool:
    """Whether two gauges are one, sign and all."""
    powers = float(first @ first) * float(second @ second)
    return powers > 0.0 and float(first @ second) > SAME_GAUGE * np.sqrt(powers)

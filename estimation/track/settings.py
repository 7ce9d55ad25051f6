"""Settings of the job that keeps alignments current; by them, which differences matter, and what is carried over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.track.iteration import IterationParameters
from estimation.track.panel.basis import PanelParameters
from estimation.track.parameters import TRACK
from estimation.track.passes import PartitionParameters, PositionParameters
from estimation.track.screening.agreement import ScreeningParameters
from estimation.values.arrays import FloatArray
from estimation.values.track import GaugeShift, TrackAlignment, TrackFindings


@dataclass(frozen=True, slots=True)
class SectionParameters:
    """How an epoch of passes becomes an alignment."""

    panel: PanelParameters = field(default_factory=PanelParameters)
    positions: PositionParameters = field(default_factory=PositionParameters)
    iteration: IterationParameters = field(default_factory=IterationParameters)
    scale_error: float = 0.009  # relative std of y - d as a whole that passes leave open, blocks of data cannot show it
    gauge_scale_error: float = 0.035  # the same where the gauge had to be found too
    systematic: float = 0.02e-3  # m, std of the alignment that blocks of data cannot show
    systematic_per_gauge: tuple[float, float] = (0.025, 0.055)  # the same per gauge deviation: recorded, found
    systematic_per_open_gauge: float = 0.13  # the same per gauge that hides in the alignment
    cutoff_wavelength: float = 120.0  # m, longest wavelength that the alignment holds
    outlier_factor: float = 2.0  # times the median residual of the other journeys
    least_outlier_m: float = 0.4e-3  # m
    most_difference_error: float = 0.08  # of rL - rR, by the stiffness ratio: beyond, its stiffness term is as assumed
    most_slope_std: float = 0.4  # of the curves of all wheelsets together: beyond, nothing is known of them
    sensor_residual_rms: float = 0.07e-3  # m, rms of y - d - h(R) that sensors and small terms of the equations make
    gauge_effect: float = 0.1  # m by which a metre of gauge moves wheelsets of widely different wear apart
    open_slope_std: float = 10.0  # relative std of the curves: nothing is known of them, and numbers stay finite
    wide_std_ratio: float = 0.5  # std of R between the passes of a place over the std of R
    shortest_wavelength: float = 2.5  # m, of the last one
    filed_samples: float = 6.0  # independent ones that the std on file counts as, against those of the passes
    local_length: float = 100.0  # m over which both are compared for local differences
    local_stds: float = 4.0  # of a local mean square, beyond which it is more than chance
    curve_share_factor: float = 2.0  # of the rms of h(R) times the share that curves leave of y, by which they are flat
    survey_error_length: float = 5.0  # m along the track, of errors of a survey


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of the job that keeps alignments current."""

    section: SectionParameters = field(default_factory=SectionParameters)
    screening: ScreeningParameters = field(default_factory=ScreeningParameters)
    partition: PartitionParameters = field(default_factory=PartitionParameters)
    most_windows: int = 480  # of an epoch
    most_wheelsets: int = 48  # of an epoch, each life of a profile and mileage interval one
    pass_step: float = 0.2  # m, grid on which passes are kept
    measured_km: float = 1000.0  # mileage within which measured profiles are still those of a wheelset
    same_share: float = 1.0  # of its std by which an alignment may differ and still be the same
    same_least: float = 0.05e-3  # m, of a difference or a std that matters: the geometry does not change
    same_stretch: float = 0.005  # by which an alignment may be a stretched one: that does not average out
    same_std: float = 0.5  # times the std before: more certain than that is another alignment
    same_scale: float = 0.01  # of a scale that is left open and that matters
    same_coverage: float = 0.02  # of the section that is known now and was not
    same_ratio: float = 0.02  # of a vehicle's stiffness ratio, or twice its std where that is more
    same_gauge: float = 0.3e-3  # m, rms: much less than moves a wheel to another part of its profile
    same_shift: float = 0.15  # of the gauge's std, rms: by which the shift of a wheelset may differ
    same_survey_std: float = 1.5  # factor by which the std of a survey may be off without the passes being solved again
    usual_radius_difference: float = 1e-3  # m of rL - rR, both ways: further out few passes are


SMALLEST = float(np.finfo(np.float64).tiny)  # in place of a power of zero


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
    most = settings.same_shift * size
    return any(_apart(before[one], after[one], size, settings) > most for one in before.keys() & after)


def _apart(first: GaugeShift, second: GaugeShift, size: float, settings: AlignmentSettings) -> float:
    R, e = settings.usual_radius_difference * np.linspace(-1.0, 1.0, 41), np.array([-size, size])
    return float(np.sqrt(np.mean((first.over(R, e) - second.over(R, e)) ** 2)))


def carry_over_findings(found: TrackAlignment, before: TrackAlignment | None) -> TrackAlignment:
    """Return an alignment that also holds what was found of vehicles and wheelsets that this epoch has not met."""
    # Their windows are estimated again with it as those of the others. Shifts belong to the gauge that makes them: it
    # stays where the epoch has found that gauge again.
    if before is None or before.findings is None or found.findings is None:
        return found
    old, new = before.findings, found.findings
    shifts, was, now = dict(new.gauge_shifts), before.gauge_deviation, found.gauge_deviation
    powers = float(was @ was) * float(now @ now)
    if (
        shifts and powers > 0.0 and float(was @ now) > TRACK.same_gauge_correlation * np.sqrt(powers)
    ):  # one gauge, sign and all
        shifts = {**old.gauge_shifts, **shifts}
    missed = old.stiffness_ratio.keys() - new.stiffness_ratio.keys()
    std = max(new.stiffness_ratio_std, old.stiffness_ratio_std) if missed else new.stiffness_ratio_std
    ratios = {**old.stiffness_ratio, **new.stiffness_ratio}
    return replace(found, findings=TrackFindings(ratios, std, shifts))

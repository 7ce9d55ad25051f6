"""What goes into an epoch, and what an epoch's alignment changes: keys, digests, and differences that matter."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.arrays import FloatArray
from estimation.ports import WheelsetRecord, WindowRecord
from estimation.track.measured import MeasuredCurve
from estimation.track.passes import Pass, gridded
from estimation.track.screening import ScreeningParameters
from estimation.track.section import SectionParameters
from estimation.types import RECORDED, Findings, GaugeShift, TrackAlignment

SAME_GAUGE = 0.8  # correlation of two estimates of one gauge
OFTEN = 1e-3  # m of rL - rR, both ways: further out few passes are


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of the job that keeps alignments current."""

    section: SectionParameters = field(default_factory=SectionParameters)
    screening: ScreeningParameters = field(default_factory=ScreeningParameters)
    most_windows: int = 480  # of an epoch, the newest
    most_wheelsets: int = 48  # of an epoch, each life of a profile and mileage interval one
    pass_step: float = 0.2  # m, grid on which passes are kept
    trusted_offset: float = 5.0  # m: positions on a recorded section are believed as far as this
    measured_km: float = 1000.0  # mileage within which measured profiles are still those of a wheelset
    same_share: float = 1.0  # of its std by which an alignment may differ and still be the same
    same_least: float = 0.05e-3  # m, of a difference or a std that matters: the geometry cannot tell
    same_stretch: float = 0.005  # by which an alignment may be a stretched one: that does not average out
    same_std: float = 0.7  # times the std before: more certain than that is another alignment
    same_scale: float = 0.01  # of a scale that is left open and that matters
    same_coverage: float = 0.02  # of the section that is known now and was not
    same_ratio: float = 0.02  # of a vehicle's stiffness ratio, or twice its std where that is more
    same_gauge: float = 0.3e-3  # m, rms: much less than moves a wheel to another part of its profile
    same_shift: float = 0.15  # of the gauge's std, rms: by which an epoch may tell another shift of a wheelset


def material(old: TrackAlignment, new: TrackAlignment, settings: AlignmentSettings) -> bool:
    """Whether what was estimated with ``old`` should be estimated again with ``new``.

    It should where ``new`` differs by more than ``old`` left unknown, is much more certain, reaches further, or knows
    more of the section; and where it tells another stiffness ratio of a vehicle, another gauge, or on a recording what
    the gauge does to a wheelset of which that was not known.
    """
    if old.source != new.source or old.cut_off != new.cut_off or old.gauge_known != new.gauge_known:
        return True
    if len(old.s) != len(new.s) or not np.array_equal(old.s, new.s):
        return True
    before, after = np.isfinite(old.alignment), np.isfinite(new.alignment)
    if (before != after).mean() > settings.same_coverage:
        return True
    both = before & after
    if not both.any():
        return False
    if _differs(old.findings, new.findings, settings) or _met(old, new):
        return True
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
    stretch = abs(float(difference @ old)) / max(float(old @ old), 1e-300)
    far = float(np.sqrt(np.mean(difference**2))) > max(settings.same_share * std, settings.same_least)
    return far or stretch > settings.same_stretch


def _differs(old: Findings | None, new: Findings | None, settings: AlignmentSettings) -> bool:
    """Whether two versions tell another stiffness ratio of any vehicle; one that is not told of is as assumed."""
    if new is None:
        return False
    was = old or Findings({}, 0.0, {})
    same = max(settings.same_ratio, 2.0 * was.stiffness_ratio_std)
    vehicles = was.stiffness_ratio.keys() | new.stiffness_ratio.keys()
    return any(abs(new.stiffness_ratio.get(one, 1.0) - was.stiffness_ratio.get(one, 1.0)) > same for one in vehicles)


def _met(old: TrackAlignment, new: TrackAlignment) -> bool:
    """Whether a recording tells the gauge shift of a wheelset whose windows were estimated without.

    Where the alignment is the fleet's own, windows wait until their wheelset has been met.
    """
    if new.source != RECORDED or new.findings is None:
        return False
    return bool(new.findings.gauge_shifts.keys() - (old.findings.gauge_shifts.keys() if old.findings else set()))


def shifted_otherwise(old: TrackAlignment, new: TrackAlignment, settings: AlignmentSettings) -> bool:
    """Whether ``new`` tells another gauge shift of a wheelset, as after wear or the lathe; both on one gauge."""
    if old.findings is None or new.findings is None:
        return False
    size = float(np.std(new.gauge_deviation))
    before, after = old.findings.gauge_shifts, new.findings.gauge_shifts
    return any(_apart(before[one], after[one], size) > settings.same_shift * size for one in before.keys() & after)


def _apart(first: GaugeShift, second: GaugeShift, size: float) -> float:
    """Return the rms, m, by which two shifts differ at gauge deviations of -size and size, m, where passes are."""
    R, e = OFTEN * np.linspace(-1.0, 1.0, 41), np.array([-size, size])
    return float(np.sqrt(np.mean((first.over(R, e) - second.over(R, e)) ** 2)))


def with_findings_before(found: TrackAlignment, before: TrackAlignment | None) -> TrackAlignment:
    """Return an alignment that also tells what was found of vehicles and wheelsets that this epoch has not met.

    Their windows are estimated again with it as those of the others. What was told of shifts goes with the gauge that
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
    return replace(found, findings=Findings(ratios, std, shifts))


def _alike(first: FloatArray, second: FloatArray) -> bool:
    """Whether two gauges are one, sign and all."""
    powers = float(first @ first) * float(second @ second)
    return powers > 0.0 and float(first @ second) > SAME_GAUGE * np.sqrt(powers)


def life(wheelset: WheelsetRecord, record: WindowRecord, interval_km: float) -> str:
    """Return the name under which a window's passes enter the panel: same wheelset, same profile, hardly more wear."""
    turned = [item for item in wheelset.reprofilings if item.at_ns <= record.start_ns]
    begin_km = max((item.mileage_km for item in turned), default=0.0)
    return f"{record.wheelset}#{len(turned)}#{int((record.mileage_km - begin_km) // interval_km)}"


def bounded(
    records: Sequence[WindowRecord], lives: Sequence[str], most_wheelsets: int
) -> list[tuple[WindowRecord, str]]:
    """Return the first records with their lives, as many as do not exceed the number of lives, by place in time."""
    chosen: list[tuple[WindowRecord, str]] = []
    seen: set[str] = set()
    for record, name in zip(records, lives, strict=True):
        if name not in seen and len(seen) == most_wheelsets:
            break
        seen.add(name)
        chosen.append((record, name))
    return chosen


def epoch_digest(
    records: Sequence[WindowRecord],
    version: int | None,
    code_version: str,
    measured: Mapping[str, MeasuredCurve] | None = None,
) -> str:
    """Return what tells an epoch from another: its windows, the version before, the code, what has been measured."""
    text = hashlib.sha256(f"{version} {code_version}\n".encode())
    for record in sorted(records, key=lambda item: (item.wheelset, item.start_ns)):
        text.update(f"{record.wheelset} {record.start_ns} {record.content_digest} {record.mileage_km!r}\n".encode())
    for name, curve in sorted((measured or {}).items()):
        text.update(f"{name} {curve.name} {curve.std!r}\n".encode())
        text.update(curve.difference.tobytes() + curve.displacement.tobytes())
    return text.hexdigest()


def reduced(item: Pass, name: str, step: float) -> Pass:
    """Return a pass on a grid, under the name of its wheelset's life."""
    first, displacement, difference = gridded(item, step)
    at = (first + np.arange(len(displacement))) * step
    return replace(
        item,
        wheelset=name,
        at=np.asarray(at, dtype=np.float64),
        displacement=displacement,
        difference=difference,
        elastic=None if item.elastic is None else np.interp(at, item.at, item.elastic),
    )

"""Has the suspension of a vehicle changed? Its ratio of yaw stiffness to creep coefficient, now against before.

A ratio moves with the yaw spring and with the creep coefficient. Friction and running surface change the creep of all
vehicles of a section at once, so what the others on the same section have in common is taken out; what is left of
friction is a standard deviation, large where a vehicle was alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval

from estimation.values.arrays import FloatArray
from estimation.values.suspension import SuspensionChange, SuspensionFinding

Findings = Annotated[int, Interval(ge=1, le=1000)]
RelativeStd = Annotated[float, Interval(ge=0.001, le=1.0)]


@dataclass(frozen=True, slots=True)
class SuspensionParameters:
    """What counts as now, and what friction may do."""

    recent: Findings = 3  # newest findings of a vehicle
    least_past: Findings = 3  # findings before them
    common_creep_std: RelativeStd = 0.15  # relative, of a section and time, where no other vehicle shows it
    own_creep_std: RelativeStd = (
        0.04  # relative, of a vehicle against the others on one section: other wheels, other hours
    )


@dataclass(frozen=True, slots=True)
class _Series:
    """Findings of one vehicle in order of time, as logarithms of the ratio."""

    findings: Sequence[SuspensionFinding]
    level: FloatArray  # (k,) log of the absolute ratio
    variance: FloatArray  # (k,)
    past: int  # how many of them are the past

    @property
    def reference(self) -> float:
        """Level of the past."""
        weight = 1.0 / self.variance[: self.past]
        return float(weight @ self.level[: self.past] / weight.sum())


def suspension_changes(
    findings: Sequence[SuspensionFinding], parameters: SuspensionParameters | None = None
) -> dict[str, SuspensionChange]:
    """Return by vehicle how its ratio has changed; of those with enough findings.

    Parameters
    ----------
    findings
        Of all vehicles that share sections, in any order.
    parameters
        What counts as now, and what friction may do.
    """
    p = parameters or SuspensionParameters()
    by_vehicle = {
        code: _series([item for item in findings if item.vehicle == code], p)
        for code in sorted({item.vehicle for item in findings})
    }
    moved = {
        (item.vehicle, item.section, item.to_ns): series.level[k] - series.reference
        for series in by_vehicle.values()
        if series.past > 0
        for k, item in enumerate(series.findings)
    }
    enough = {code: s for code, s in by_vehicle.items() if s.past >= p.least_past and len(s.level) > s.past}
    return {code: _change(code, series, by_vehicle, moved, p) for code, series in enough.items()}


def _series(own: Sequence[SuspensionFinding], p: SuspensionParameters) -> _Series:
    ordered = sorted(own, key=lambda item: (item.to_ns, item.section))
    level = np.array([np.log(item.ratio * item.assumed) for item in ordered])
    variance = np.array([(item.ratio_std / item.ratio) ** 2 for item in ordered])
    return _Series(ordered, level, variance + p.own_creep_std**2, max(0, len(ordered) - p.recent))


def _change(
    code: str,
    series: _Series,
    by_vehicle: Mapping[str, _Series],
    moved: Mapping[tuple[str, str, int], float],
    p: SuspensionParameters,
) -> SuspensionChange:
    level, friction = series.level.copy(), np.zeros(len(series.level))
    seen: set[str] = set()
    for k, item in enumerate(series.findings):
        shifts = _shifts_of_others(code, item, by_vehicle, moved)
        seen |= shifts.keys()
        common, common_variance = _common(list(shifts.values()), p)
        level[k] -= common
        friction[k] = common_variance
    weight = 1.0 / series.variance
    sides = (slice(0, series.past), slice(series.past, None))
    before, now = (float(weight[side] @ level[side] / weight[side].sum()) for side in sides)
    # what is left of friction lasts as weather does: more findings of a side do not lessen it
    spread = float(np.sqrt(sum(1.0 / weight[side].sum() + friction[side].mean() for side in sides)))
    change = float(np.expm1(now - before))
    return SuspensionChange(
        vehicle=code,
        change=change,
        std=(1.0 + change) * spread,
        past=series.past,
        recent=len(level) - series.past,
        others=len(seen),
        recent_ns=max(item.to_ns for item in series.findings),
    )


def _shifts_of_others(
    code: str, item: SuspensionFinding, by_vehicle: Mapping[str, _Series], moved: Mapping[tuple[str, str, int], float]
) -> dict[str, float]:
    """Return by vehicle by how much others differ from their own past on that section over that time."""
    shifts: dict[str, list[float]] = {}
    for other, series in by_vehicle.items():
        if other == code or series.past == 0:
            continue
        for theirs in series.findings:
            together = theirs.section == item.section and theirs.from_ns < item.to_ns and item.from_ns < theirs.to_ns
            if together:
                shifts.setdefault(other, []).append(moved[other, theirs.section, theirs.to_ns])
    return {other: float(np.mean(values)) for other, values in shifts.items()}


def _common(shifts: Sequence[float], p: SuspensionParameters) -> tuple[float, float]:
    """Return what a section does to all ratios, as far as the others show it, and the variance that is left of it.

    The median, so that another vehicle whose spring has changed does not pass for friction; it is taken as far as its
    own variance is less than that of friction.
    """
    prior = p.common_creep_std**2
    if not shifts:
        return 0.0, prior
    own = 2.0 * p.own_creep_std**2 * 1.57 / len(shifts)  # of a median
    worth = prior / (prior + own)
    return worth * float(np.median(shifts)), worth * own

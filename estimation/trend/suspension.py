"""Has the suspension of a vehicle changed? Its ratio of yaw stiffness to creep coefficient, now against before.

Now is what comes behind the newest step, however long ago that was, or else the newest findings.

A ratio moves with the yaw spring and with the creep coefficient. Friction and running surface change the creep of all
vehicles of a section at once, so what the others on the same section have in common is taken out; what is left of
friction is a standard deviation, large where a vehicle was alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval

from estimation.trend.change_point import Series, StepModel, newest_change
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.trend import SuspensionChange, SuspensionFinding
from estimation.values.units import DAY_NS, MEDIAN_VARIANCE, STD_PER_MAD

RATIO = StepModel(
    slope=0.0,
    slope_std=0.0,
    bend_std=0.0,
    wander_days=2.0,  # of friction, which rain changes at once
    step_std=0.3,
    outlier_std=0.3,
    noise_floor=0.005,
    least_size=0.05,
    sure=0.9,
    least_good=3,
    widest=1,
)  # of the logarithm of a ratio; how far it wanders is what is left of friction
Findings = Annotated[int, Interval(ge=1, le=1000)]
RelativeStd = Annotated[float, Interval(ge=0.001, le=1.0)]


@dataclass(frozen=True, slots=True)
class SuspensionParameters:
    """What counts as now, and what friction may do."""

    recent: Findings = 3  # newest findings of a vehicle
    least_past: Findings = 3  # findings before them
    most_past: Findings = 60  # of them that are looked at, the newest
    together_days: Annotated[float, Interval(ge=0.01, le=365.0)] = 1.0  # between passes that have friction in common
    common_creep_std: RelativeStd = 0.15  # relative, of a section and time, where no other vehicle shows it
    own_creep_std: RelativeStd = 0.04  # of a vehicle against the others on one section: other wheels, other hours


@dataclass(frozen=True, slots=True)
class _Series:
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
    """Return by vehicle how its ratio has changed; of those with enough findings."""
    newest = ((code, next(changes, None)) for code, changes in suspension_histories(findings, parameters).items())
    return {code: change for code, change in newest if change is not None}


def suspension_histories(
    findings: Sequence[SuspensionFinding], parameters: SuspensionParameters | None = None
) -> dict[str, Iterator[SuspensionChange]]:
    """Return by vehicle how its ratio had changed after each of its findings, newest first."""
    # Computed as far as read. The other vehicles are as they are known now: late data of theirs count, too.
    p = parameters or SuspensionParameters()
    of_vehicle: dict[str, list[SuspensionFinding]] = {}
    for item in findings:
        of_vehicle.setdefault(item.vehicle, []).append(item)
    by_vehicle = {code: _series(of_vehicle[code], p) for code in sorted(of_vehicle)}
    sections = _by_section(by_vehicle)
    return {code: _history(code, series, sections, p) for code, series in by_vehicle.items()}


def _history(
    code: str, series: _Series, sections: Mapping[str, _Section], p: SuspensionParameters
) -> Iterator[SuspensionChange]:
    for count in range(len(series.findings), p.least_past + p.recent - 1, -1):
        until_then = _Series(series.findings[:count], series.level[:count], series.variance[:count], count - p.recent)
        yield _change(code, until_then, sections, p)


def _series(findings: Sequence[SuspensionFinding], p: SuspensionParameters) -> _Series:
    ordered = sorted(findings, key=lambda item: (item.to_ns, item.section))[-(p.recent + p.most_past) :]
    level = np.array([np.log(item.ratio * item.assumed) for item in ordered])
    variance = np.array([(item.ratio_std / item.ratio) ** 2 for item in ordered])
    return _Series(ordered, level, variance + p.own_creep_std**2, max(0, len(ordered) - p.recent))


@dataclass(frozen=True, slots=True)
class _Section:
    from_ns: IntArray  # (k,)
    to_ns: IntArray  # (k,)
    longest_ns: int
    vehicle: tuple[str, ...]  # (k,)
    shift: FloatArray  # (k,)

    def of_others(self, code: str, item: SuspensionFinding, within_ns: int) -> dict[str, float]:
        """Return by vehicle how the others differ: of each the passes nearest in time, within some of it."""
        first = int(np.searchsorted(self.from_ns, item.from_ns - within_ns - self.longest_ns, side="left"))
        last = int(np.searchsorted(self.from_ns, item.to_ns + within_ns, side="right"))
        nearest: dict[str, tuple[int, float]] = {}
        for k in range(first, last):
            if self.vehicle[k] == code or self.to_ns[k] < item.from_ns - within_ns:
                continue
            apart = abs(int(self.from_ns[k]) + int(self.to_ns[k]) - item.from_ns - item.to_ns)
            candidate = (apart, float(self.shift[k]))
            nearest[self.vehicle[k]] = min(candidate, nearest.get(self.vehicle[k], candidate))
        return {other: shift for other, (_, shift) in nearest.items()}


def _by_section(by_vehicle: Mapping[str, _Series]) -> dict[str, _Section]:
    rows: dict[str, list[tuple[int, int, str, float]]] = {}
    for code, series in by_vehicle.items():
        if series.past == 0:
            continue
        for item, level in zip(series.findings, series.level, strict=True):
            row = (item.from_ns, item.to_ns, code, float(level) - series.reference)
            rows.setdefault(item.section, []).append(row)
    sections = {}
    for section, listed in rows.items():
        begins, ends, codes, shifts = zip(*sorted(listed), strict=True)
        from_ns, to_ns = np.array(begins, dtype=np.int64), np.array(ends, dtype=np.int64)
        sections[section] = _Section(from_ns, to_ns, int((to_ns - from_ns).max()), codes, np.array(shifts))
    return sections


def _change(code: str, series: _Series, sections: Mapping[str, _Section], p: SuspensionParameters) -> SuspensionChange:
    level, friction = series.level.copy(), np.zeros(len(series.level))
    within_ns = round(p.together_days * DAY_NS)
    seen: set[str] = set()
    for k, item in enumerate(series.findings):
        shifts = sections[item.section].of_others(code, item, within_ns)
        seen |= shifts.keys()
        common, common_variance = _common(list(shifts.values()), p)
        level[k] -= common
        friction[k] = common_variance
    weight = 1.0 / series.variance
    # friction that is left makes the levels wander
    at_ns = np.array([0.5 * (item.from_ns + item.to_ns) for item in series.findings])
    points = Series(np.zeros(len(level)), at_ns, level, np.sqrt(series.variance))
    step = newest_change(points, replace(RATIO, wander_std=float(np.sqrt(friction.mean()))))
    past, first = (series.past, series.past) if step is None else (step.last + 1, step.first)
    sides = (slice(0, past), slice(first, None))
    before, now = (float(weight[side] @ level[side] / weight[side].sum()) for side in sides)
    # what is left of friction lasts as weather does: more findings of a side do not lessen it
    spread = float(np.sqrt(sum(1.0 / weight[side].sum() + friction[side].mean() for side in sides)))
    change = float(np.expm1(now - before))
    return SuspensionChange(
        vehicle=code,
        change=change,
        std=(1.0 + change) * spread,
        past=past,
        recent=len(level) - first,
        others=len(seen),
        recent_ns=max(item.to_ns for item in series.findings),
        step_probability=None if step is None else step.probability,
        since_ns=None if step is None else series.findings[step.first].from_ns,
    )


def _common(shifts: Sequence[float], p: SuspensionParameters) -> tuple[float, float]:
    """Return what a section does to all ratios, as far as the others show it, and the variance that is left of it."""
    # the median, so that another vehicle whose spring has changed does not pass for friction; it is taken as far as its
    # own variance is less than that of friction
    prior = p.common_creep_std**2
    if not shifts:
        return 0.0, prior
    middle = float(np.median(shifts))
    sampled = max(2.0 * p.own_creep_std**2, _scatter(shifts, middle, p) ** 2) * MEDIAN_VARIANCE / len(shifts)
    worth = prior / (prior + sampled)
    return worth * middle, worth * sampled


def _scatter(shifts: Sequence[float], middle: float, p: SuspensionParameters) -> float:
    """Return the standard deviation between vehicles; with one or two nobody knows which of them has changed."""
    if len(shifts) == 1:
        return p.common_creep_std
    if len(shifts) == 2:  # noqa: PLR2004 - two have no majority
        return float(np.std(shifts, ddof=1))
    return STD_PER_MAD * float(np.median(np.abs(np.asarray(shifts) - middle)))

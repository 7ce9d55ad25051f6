"""Which wheelsets of a vehicle to turn together, and when: those that are due, and those that must follow.

A wheelset is due where its limit may be reached within the horizon (p10). Wheelsets of one vehicle that become due
close together are turned in one visit. A turned wheelset is smaller; where its diameter then differs from another by
more than the operator's limits, the larger one is turned as well, down to the limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import groupby
from typing import Annotated

from estimation.values.fields import Served
from estimation.values.reasons import Reason
from estimation.values.units import IN_MM


@dataclass(frozen=True, slots=True)
class DiameterLimits:
    """Limits of the operator's maintenance plan; None is not checked, for no standard gives numbers for every vehicle.

    EN 15313 leaves them to the maintenance plan.
    """

    cut: Annotated[float | None, Served("Radius that a turning takes off at least.", "cut_mm", IN_MM)] = None
    minimum_radius: Annotated[float | None, Served("Least radius of a wheel.", "minimum_radius_mm", IN_MM)] = None
    axle_difference: Annotated[
        float | None,
        Served("Greatest difference of the diameters of the two wheels of an axle.", "axle_difference_mm", IN_MM),
    ] = None
    bogie_difference: Annotated[
        float | None,
        Served("Greatest difference of the diameters of any two wheels of a bogie.", "bogie_difference_mm", IN_MM),
    ] = None
    vehicle_difference: Annotated[
        float | None,
        Served("Greatest difference of the diameters of any two wheels of a vehicle.", "vehicle_difference_mm", IN_MM),
    ] = None  # all in m


@dataclass(frozen=True, slots=True)
class Radii:
    """Radii of a wheelset's wheels, m; one number where the two are not distinguished."""

    left: float
    right: float | None = None

    @property
    def wheels(self) -> tuple[float, ...]:
        """Those that are known."""
        return (self.left,) if self.right is None else (self.left, self.right)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A wheelset that runs under a vehicle, as the plan needs it.

    ``due_ns`` is when its limit may be reached (p10), None where that is beyond the horizon; ``unknown`` is why nothing
    can be said of it.
    """

    serial: str
    vehicle: str
    axle: int
    bogie: int | None
    over_limit: bool
    due_ns: int | None
    reason: str  # of its own, in words
    unknown: Reason | None
    radii: Radii | None


class Cause(StrEnum):
    """Why a wheelset is in the plan."""

    DUE = "due"
    TOGETHER = "together"  # with another, for the diameters
    REPLACE = "replace"  # turning it would leave too small a wheel
    NOT_ASSESSED = "not_assessed"  # nothing is known of it


@dataclass(frozen=True, slots=True)
class PlanLine:
    """One wheelset of the plan.

    ``visit`` numbers the visits of a vehicle to the lathe from 1, and ``turn_by_ns`` is when; both None where it is not
    assessed. ``not_checked`` says which limits could not be held against it.
    """

    candidate: Candidate
    cause: Cause
    visit: int | None
    turn_by_ns: int | None
    reason: str
    radius_after: float | None
    not_checked: tuple[str, ...]


TOLERANCE = 1e-9  # m, of the rounding of sums of radii: no allowance of a limit


def turning_plan(
    candidates: Sequence[Candidate], limits: DiameterLimits, now_ns: int, horizon_ns: int, together_ns: int
) -> list[PlanLine]:
    """Return the plan, the earliest visit first; what cannot be assessed comes last."""
    lines: list[PlanLine] = []
    ordered = sorted(candidates, key=lambda candidate: (candidate.vehicle, candidate.axle))
    for _, of_vehicle in groupby(ordered, key=lambda candidate: candidate.vehicle):
        wheelsets = list(of_vehicle)
        radii = {wheelset.serial: wheelset.radii.wheels for wheelset in wheelsets if wheelset.radii is not None}
        turned: set[str] = set()
        number = 0
        for turn_by_ns, due in _visits(wheelsets, now_ns, horizon_ns, together_ns):
            still_due = [item for item in due if item.serial not in turned]  # the others have a new profile by then
            if not still_due:
                continue
            number += 1
            visit = _Visit(number, turn_by_ns, still_due, limits, radii)
            lines += visit.lines(wheelsets)
            turned |= visit.chosen.keys()
            radii = dict(visit.radii)
    planned = {line.candidate.serial for line in lines}
    lines += [
        PlanLine(one, Cause.NOT_ASSESSED, None, None, one.unknown.text, None, ())
        for one in ordered
        if one.unknown is not None and one.serial not in planned
    ]
    by_place = sorted(lines, key=lambda line: (line.candidate.vehicle, line.candidate.axle))
    return sorted(by_place, key=lambda line: (line.turn_by_ns is None, line.turn_by_ns or 0))


def _visits(
    wheelsets: Sequence[Candidate], now_ns: int, horizon_ns: int, together_ns: int
) -> list[tuple[int, list[Candidate]]]:
    due = [
        (now_ns if wheelset.over_limit else max(wheelset.due_ns or now_ns, now_ns), wheelset)
        for wheelset in wheelsets
        if wheelset.over_limit or wheelset.due_ns is not None
    ]
    visits: list[tuple[int, list[Candidate]]] = []
    for turn_by_ns, candidate in sorted(due, key=lambda pair: (pair[0], pair[1].axle)):
        if turn_by_ns > now_ns + horizon_ns:
            continue
        if visits and turn_by_ns <= visits[-1][0] + together_ns:
            visits[-1][1].append(candidate)
        else:
            visits.append((turn_by_ns, [candidate]))
    return visits


@dataclass(slots=True)
class _Visit:
    """One visit of a vehicle to the lathe, worked out step by step."""

    number: int
    turn_by_ns: int
    due: Sequence[Candidate]
    limits: DiameterLimits
    radii: Mapping[str, tuple[float, ...]]  # of all its wheelsets where known, m; after the visit in the end
    chosen: dict[str, tuple[Cause, str]] = field(default_factory=dict)

    def lines(self, wheelsets: Sequence[Candidate]) -> list[PlanLine]:
        """Return the wheelsets that are turned."""
        for candidate in self.due:
            self.chosen[candidate.serial] = (Cause.DUE, candidate.reason)
            self._turn(candidate, None)
        while (too_different := next(self._too_different(wheelsets), None)) is not None:
            larger, target, why = too_different
            self.chosen.setdefault(larger.serial, (Cause.TOGETHER, why))
            self._turn(larger, target)
        return [self._line(wheelset) for wheelset in wheelsets if wheelset.serial in self.chosen]

    def _turn(self, candidate: Candidate, target: float | None) -> None:
        """Take off what a turning takes off, and down to a target; a wheelset that becomes too small is replaced."""
        wheels = self.radii.get(candidate.serial)
        cut = self.limits.cut
        if wheels is None or (cut is None and target is None):
            return
        first = cut is not None and wheels == (candidate.radii.wheels if candidate.radii is not None else None)
        after = min(wheels) - (cut if first and cut is not None else 0.0)
        after = after if target is None else min(after, target)
        least = self.limits.minimum_radius
        radii = dict(self.radii)
        if least is not None and after < least - TOLERANCE:
            why = f"cannot be turned: {after * IN_MM:.1f} mm of radius would be left, {least * IN_MM:.1f} mm needed"
            self.chosen[candidate.serial] = (Cause.REPLACE, f"{self.chosen[candidate.serial][1]}; {why}")
            del radii[candidate.serial]  # that of its successor is not known
        else:
            radii[candidate.serial] = (after,) * len(wheels)
        self.radii = radii

    def _too_different(self, wheelsets: Sequence[Candidate]) -> Iterator[tuple[Candidate, float, str]]:
        """Yield wheelsets that are too large beside another, or on one side: down to which radius, and why."""
        with_radii = [wheelset for wheelset in wheelsets if wheelset.serial in self.radii]
        for larger in with_radii:
            yield from self._pair(larger, larger, self.limits.axle_difference, "left and right differ")
            for smaller in with_radii:
                if smaller.serial == larger.serial:
                    continue
                why = f"turned together with axle {smaller.axle}, because the diameters would differ"
                if larger.bogie is not None and larger.bogie == smaller.bogie:
                    yield from self._pair(larger, smaller, self.limits.bogie_difference, why)
                yield from self._pair(larger, smaller, self.limits.vehicle_difference, why)

    def _pair(
        self, larger: Candidate, smaller: Candidate, limit: float | None, why: str
    ) -> Iterator[tuple[Candidate, float, str]]:
        if limit is None:
            return
        least = min(self.radii[smaller.serial])
        difference = 2.0 * (max(self.radii[larger.serial]) - least)
        if difference > limit + TOLERANCE:
            text = f"{why} by {difference * IN_MM:.1f} mm > {limit * IN_MM:g} mm"
            yield larger, least + 0.5 * limit, text

    def _line(self, candidate: Candidate) -> PlanLine:
        cause, reason = self.chosen[candidate.serial]
        after = self.radii.get(candidate.serial)
        return PlanLine(
            candidate=candidate,
            cause=cause,
            visit=self.number,
            turn_by_ns=self.turn_by_ns,
            reason=reason,
            radius_after=None if after is None or after == (candidate.radii and candidate.radii.wheels) else after[0],
            not_checked=not_checked(candidate, self.limits),
        )


def not_checked(candidate: Candidate, limits: DiameterLimits) -> tuple[str, ...]:
    """Return what could not be held against a wheelset, and why."""
    if candidate.radii is None:
        return ("no measured radius on file: diameters were not checked",)
    missing = []
    if limits.cut is None:
        missing.append("what a turning takes off is not given")
    for limit, name in (
        (limits.minimum_radius, "least radius"),
        (limits.axle_difference, "difference of left and right"),
        (limits.bogie_difference, "difference in the bogie"),
        (limits.vehicle_difference, "difference in the vehicle"),
    ):
        if limit is None:
            missing.append(f"no limit given: {name}")
    if limits.axle_difference is not None and candidate.radii.right is None:
        missing.append("left and right radius are not distinguished")
    if limits.bogie_difference is not None and candidate.bogie is None:
        missing.append("its bogie is not known")
    return tuple(missing)

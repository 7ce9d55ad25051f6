"""Sections that are named as known, and measured wheelsets, compared with each other: some may be wrong.

Each section is taken as unknown in turn, its level held by the others. Where its rails then add to the conicity of the
wheel as designed, or of the fleet's mean wheel, beyond doubt, or where a measured wheelset is beyond doubt what the
others do not say it is, one of them is not what it is named. Of three or more that are connected that is the one
without which the others agree best; of two nobody knows which, so that neither holds the level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimation.rails.amplitude import at_amplitude, wheel_checks
from estimation.rails.cell_table import CellTable
from estimation.rails.connections import Runs, islands
from estimation.rails.parameters import Anchors, RailsParameters
from estimation.values.quantities import Estimate
from estimation.values.rails import RailsReference
from estimation.values.reasons import Reason, ReasonCode

TWO = 2
TRIED = 3  # wheelsets, furthest from the others, besides all sections: without which the rest agree best
HELD = (RailsReference.KNOWN_RAILS, RailsReference.MEASURED_WHEELS)


class _Witness(NamedTuple):
    """A section that is named as known, or a measured wheelset."""

    is_wheelset: bool
    name: str  # code, or serial


@dataclass(frozen=True, slots=True)
class _Apart:
    """By how much a witness differs from what the others say."""

    value: float = 0.0
    ratio: float = 0.0  # half intervals


def confirmed(table: CellTable, anchors: Anchors, parameters: RailsParameters) -> Anchors:
    """Return the anchors without those that contradict the others, and why."""
    held, found = anchors, _all_apart(table, anchors, parameters)
    while True:
        beyond = {one: by for one, by in found.items() if by.ratio > parameters.known_apart}
        if not beyond:
            return held
        order = sorted(beyond, key=lambda one: (-beyond[one].ratio, one))
        together = _connected(order[0], sorted(found), table, held)
        may_be = [one for place, one in enumerate(order) if place < TRIED or not one.is_wheelset]
        tried = [together] if len(together) == TWO else [[one] for one in may_be]
        without = [held.without(*_reasons(some, together, beyond)) for some in tried]
        left = [_all_apart(table, one, parameters) for one in without]
        best = min(range(len(tried)), key=lambda at: max((one.ratio for one in left[at].values()), default=0.0))
        held, found = without[best], left[best]


def _all_apart(table: CellTable, anchors: Anchors, parameters: RailsParameters) -> dict[_Witness, _Apart]:
    return _sections_apart(table, anchors, parameters) | _wheels_apart(table, anchors, parameters)


def _sections_apart(table: CellTable, anchors: Anchors, parameters: RailsParameters) -> dict[_Witness, _Apart]:
    known = sorted({key.section for key in table.rails if key in anchors.known_rails})
    return {_Witness(is_wheelset=False, name=code): _section_apart(code, table, anchors, parameters) for code in known}


def _section_apart(section: str, table: CellTable, anchors: Anchors, parameters: RailsParameters) -> _Apart:
    """Return the excess of a section over what the others say.

    For the fleet's mean wheel where nothing follows for that as designed. Of several periods the one that is furthest;
    at the amplitude of the limit, or the largest below that is known.
    """
    others = replace(anchors, known_rails=frozenset(key for key in anchors.known_rails if key.section != section))
    if not others.known_rails and not others.known_wheels:
        return _Apart()
    for k in np.flatnonzero(table.amplitude <= parameters.limit_amplitude + 1e-9)[::-1]:
        rails = at_amplitude(table, int(k), others, parameters).rails
        own = [one for key, one in rails.items() if key.section == section and key in anchors.known_rails]
        either = [one.excess if one.excess.value is not None else one.part for one in own if one.reference in HELD]
        found = [one for one in either if one.value is not None]
        if found:
            return max(map(_of_excess, found), key=lambda one: one.ratio)
    return _Apart()


def _of_excess(excess: Estimate) -> _Apart:
    assert excess.value is not None
    assert excess.low is not None
    return _Apart(excess.value, abs(excess.value) / (excess.value - excess.low))


def _wheels_apart(table: CellTable, anchors: Anchors, parameters: RailsParameters) -> dict[_Witness, _Apart]:
    """Return how far measured wheelsets are from what the others say, at the amplitude at which that is furthest."""
    found: dict[_Witness, _Apart] = {}
    for k in range(len(table.amplitude)) if anchors.known_wheels else ():
        for serial, check in wheel_checks(table, k, anchors, parameters).items():
            one = _Witness(is_wheelset=True, name=serial)
            if one not in found or check.ratio > found[one].ratio:
                found[one] = _Apart(check.apart, check.ratio)
    return found


def _connected(worst: _Witness, witnesses: Sequence[_Witness], table: CellTable, anchors: Anchors) -> list[_Witness]:
    """Return the witnesses that wheelsets connect with one of them, itself included."""
    nothing = np.zeros(len(table.rails), np.bool_)
    labels = islands(Runs(table.wheel, table.rail, table.serial, nothing, np.zeros(len(table.wheels), np.bool_)))
    measured = {one.wheel for one in anchors.known_wheels}

    def of(one: _Witness) -> set[int]:
        if not one.is_wheelset:
            return {int(labels[at]) for at, key in enumerate(table.rails) if key.section == one.name}
        own = [at for at, key in enumerate(table.wheels) if key.wheelset == one.name and key in measured]
        return set(labels[table.rail[np.isin(table.wheel, own)]].tolist())

    return [one for one in witnesses if of(one) & of(worst)]


def _reasons(
    some: Sequence[_Witness], together: Sequence[_Witness], beyond: Mapping[_Witness, _Apart]
) -> tuple[dict[str, Reason], dict[str, Reason]]:
    """Return why some sections, and some measured wheelsets, hold no level."""
    most = max(beyond.values(), key=lambda one: one.ratio)
    sections, wheelsets = dict[str, Reason](), dict[str, Reason]()
    for of in some:
        others = ", ".join(one.name for one in together if one != of)
        differs = f"as {others}, but the conicity differs by {abs(beyond.get(of, most).value):.3f} between them"
        if of.is_wheelset:
            wheelsets[of.name] = Reason(ReasonCode.MEASURED_WHEELS_DIFFER, f"measured, {differs}")
        else:
            sections[of.name] = Reason(ReasonCode.KNOWN_RAILS_DIFFER, f"named as known, {differs}")
    return sections, wheelsets

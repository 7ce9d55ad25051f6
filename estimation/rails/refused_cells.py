"""Wheels and rails of which no cell can be used: they are said to be unknown, with the reason of their cells."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from estimation.values.quantities import Estimate
from estimation.values.rails import RailKey, RailPart, RailsApart, StoredCell, WheelKey, WheelPart
from estimation.values.reasons import Reason

Key = TypeVar("Key", bound=Hashable)


def with_refused(found: RailsApart, cells: Sequence[StoredCell]) -> RailsApart:
    """Return what was found, with the wheels and rails whose cells are all refused, in the order of their keys."""
    known = {one.rail for one in found.rails}, {one.wheel for one in found.wheels}
    of_rails = _of((one.rail, one) for one in cells if one.rail not in known[0])
    of_wheels = _of((one.wheel, one) for one in cells if one.wheel not in known[1])
    amplitudes = len(found.amplitude)
    rails = [*found.rails, *(_rail_part(key, own, amplitudes) for key, own in of_rails.items())]
    wheels = [*found.wheels, *(_wheel_part(key, own, amplitudes) for key, own in of_wheels.items())]
    said = found.trends.keys() | found.no_trends.keys()
    no_trends = {key.section: _reason(own) for key, own in of_rails.items() if key.section not in said}
    return replace(
        found,
        rails=tuple(sorted(rails, key=lambda one: one.rail)),
        wheels=tuple(sorted(wheels, key=lambda one: one.wheel)),
        no_trends={**found.no_trends, **no_trends},
    )


def _of(cells: Iterable[tuple[Key, StoredCell]]) -> Mapping[Key, list[StoredCell]]:
    found = defaultdict[Key, list[StoredCell]](list)
    for key, one in cells:
        found[key].append(one)
    return found


def _rail_part(key: RailKey, own: Sequence[StoredCell], amplitudes: int) -> RailPart:
    nothing = _nothing(own, amplitudes)
    wheelsets = len({one.wheel.wheelset for one in own})
    return RailPart(key, None, nothing, nothing, nothing, wheelsets, *_extent(own))


def _wheel_part(key: WheelKey, own: Sequence[StoredCell], amplitudes: int) -> WheelPart:
    sections = tuple(sorted({one.rail.section for one in own}))
    return WheelPart(key, None, _nothing(own, amplitudes), sections, *_extent(own))


def _extent(own: Sequence[StoredCell]) -> tuple[int, int, int]:
    """Return how many windows there are, and from when to when."""
    return sum(one.windows for one in own), min(one.from_ns for one in own), max(one.to_ns for one in own)


def _nothing(own: Sequence[StoredCell], amplitudes: int) -> tuple[Estimate, ...]:
    return (Estimate.unknown(_reason(own), float(sum(one.windows for one in own))),) * amplitudes


def _reason(own: Sequence[StoredCell]) -> Reason:
    """Return the reason of most cells."""
    reasons = [one.reason for one in own if one.reason is not None]
    count = Counter(one.code for one in reasons)
    return max(reasons, key=lambda one: count[one.code])

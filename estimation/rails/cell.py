"""Cells: the conicity of a wheelset on one section, from the merged bin tables of its windows there."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.geometry import BinTable
from estimation.values.opinions import RailKey, RailPart, RailsApart, SectionConicity, StoredCell, WheelKey, WheelPart
from estimation.values.quantities import Estimate, Status, normal_equivalent, parts_of
from estimation.values.reasons import Reason


def section_conicity(
    wheel: WheelKey,
    rail: RailKey,
    table: BinTable,
    bins: BinParameters,
    parameters: GeometryParameters,
    *,
    scale_std: float,
    span_ns: tuple[int, int],
) -> SectionConicity | Reason:
    """Return the conicity that windows of a wheelset on one section give, by the estimator of geometries; or why none.

    Args:
        scale_std: Relative, of a scale of y - d that the alignment of the section leaves open.
        span_ns: Begin of the first and end of the last window, ns UTC.
    """
    found = estimate_geometry(table, bins, parameters)
    if found.status is not Status.ESTIMATED:
        reason = found.reason or found.equivalent_conicity.reason
        assert reason is not None  # whatever is not estimated says why
        return reason
    groups = int((table.weight.sum(axis=1) > 0).sum())
    sampled, systematic = np.array([parts_of(one, groups) for one in found.conicity]).T
    return SectionConicity(
        wheel=wheel,
        rail=rail,
        amplitude=found.amplitude,
        conicity=np.array([_number(one) for one in found.conicity]),
        sampled=normal_equivalent(sampled, groups),
        systematic=systematic,
        scale_std=scale_std,
        windows=table.windows,
        from_ns=span_ns[0],
        to_ns=span_ns[1],
    )


def _number(estimate: Estimate) -> float:
    return float("nan") if estimate.value is None else estimate.value


Key = TypeVar("Key", bound=Hashable)
Cell = TypeVar("Cell")


def with_refused(found: RailsApart, cells: Sequence[StoredCell]) -> RailsApart:
    """Return what was found, with the wheels and rails whose cells are all refused, in the order of their keys."""
    known = {one.rail for one in found.rails}, {one.wheel for one in found.wheels}
    of_rails = grouped((one.rail, one) for one in cells if one.rail not in known[0])
    of_wheels = grouped((one.wheel, one) for one in cells if one.wheel not in known[1])
    rails, wheels = [*found.rails], [*found.wheels]
    for rail, own in of_rails.items():
        nothing = _nothing(own, len(found.amplitude))
        rails.append(RailPart(rail, None, nothing, nothing, nothing, wheelsets_of(own), **extent(own)))
    for wheel, own in of_wheels.items():
        nothing = _nothing(own, len(found.amplitude))
        wheels.append(WheelPart(wheel, None, nothing, sections_of(own), **extent(own)))
    said = found.trends.keys() | found.no_trends.keys()
    no_trends = {key.section: _reason(own) for key, own in of_rails.items() if key.section not in said}
    return replace(
        found,
        rails=tuple(sorted(rails, key=lambda one: one.rail)),
        wheels=tuple(sorted(wheels, key=lambda one: one.wheel)),
        no_trends={**found.no_trends, **no_trends},
    )


def grouped(cells: Iterable[tuple[Key, Cell]]) -> Mapping[Key, list[Cell]]:
    """Return cells by what they are of."""
    found = defaultdict[Key, list[Cell]](list)
    for key, one in cells:
        found[key].append(one)
    return found


def extent(own: Sequence[StoredCell] | Sequence[SectionConicity]) -> dict[str, int]:
    """Return how many windows cells are made from, and from when to when."""
    first, last = min(one.from_ns for one in own), max(one.to_ns for one in own)
    return {"windows": sum(one.windows for one in own), "from_ns": first, "to_ns": last}


def wheelsets_of(own: Sequence[StoredCell] | Sequence[SectionConicity]) -> int:
    """Return of how many wheelsets cells are."""
    return len({one.wheel.wheelset for one in own})


def sections_of(own: Sequence[StoredCell] | Sequence[SectionConicity]) -> tuple[str, ...]:
    """Return of which sections cells are, by code."""
    return tuple(sorted({one.rail.section for one in own}))


def _nothing(own: Sequence[StoredCell], amplitudes: int) -> tuple[Estimate, ...]:
    return (Estimate.unknown(_reason(own), float(sum(one.windows for one in own))),) * amplitudes


def _reason(own: Sequence[StoredCell]) -> Reason:
    reasons = [one.reason for one in own if one.reason is not None]
    count = Counter(one.code for one in reasons)
    return max(reasons, key=lambda one: count[one.code])


NS_PER_YEAR = 365.25 * 86_400e9


@dataclass(frozen=True, slots=True, eq=False)
class CellTable:
    """Cells, and what they are of."""

    amplitude: FloatArray  # (k,) m
    wheels: tuple[WheelKey, ...]  # w, in order
    rails: tuple[RailKey, ...]  # s, in order
    serials: tuple[str, ...]  # of wheelsets, in order
    wheel: IntArray  # (n,) number of the wheel
    rail: IntArray  # (n,) number of the rails
    serial: IntArray  # (w,) number of the wheelset of each wheel
    conicity: FloatArray  # (n, k)
    sampled: FloatArray  # (n, k)
    systematic: FloatArray  # (n, k)
    scale: FloatArray  # (n,) relative, of a scale of y - d
    windows: IntArray  # (n,)
    years: FloatArray  # (n,) middle of what was seen, since 1970

    def given(self, k: int) -> BoolArray:
        """Return which cells (n,) are known at an amplitude."""
        found = np.isfinite(self.conicity[:, k]) & np.isfinite(self.sampled[:, k])
        return np.asarray(found & np.isfinite(self.systematic[:, k]))


def cell_table(cells: Sequence[SectionConicity], amplitude: FloatArray) -> CellTable:
    """Return cells as arrays."""
    wheels, rails = sorted({cell.wheel for cell in cells}), sorted({cell.rail for cell in cells})
    serials = sorted({key.wheelset for key in wheels})
    of_wheel = {key: place for place, key in enumerate(wheels)}
    of_rail = {key: place for place, key in enumerate(rails)}
    of_serial = {key: place for place, key in enumerate(serials)}
    shape = (len(cells), len(amplitude))
    columns = {
        name: np.array([getattr(cell, name) for cell in cells]).reshape(shape)
        for name in ("conicity", "sampled", "systematic")
    }
    return CellTable(
        amplitude=amplitude,
        wheels=tuple(wheels),
        rails=tuple(rails),
        serials=tuple(serials),
        wheel=np.array([of_wheel[cell.wheel] for cell in cells], np.int64),
        rail=np.array([of_rail[cell.rail] for cell in cells], np.int64),
        serial=np.array([of_serial[key.wheelset] for key in wheels], np.int64),
        scale=np.array([cell.scale_std for cell in cells]),
        windows=np.array([cell.windows for cell in cells], np.int64),
        years=np.array([0.5 * (cell.from_ns + cell.to_ns) for cell in cells]) / NS_PER_YEAR,
        **columns,
    )

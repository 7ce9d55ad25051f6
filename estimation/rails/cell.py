"""Cells: the conicity of a wheelset on one section, from the merged bin tables of its windows there."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Annotated, TypeVar

import numpy as np

from estimation.accuracy.parameters import ACCURACY
from estimation.accuracy.wheel_contact import RailShare, WheelPair, conicity_of
from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.profiles import is_design, rail_profile, wheel_profile
from estimation.errors import ContactError, ParameterError, ProfileError
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray
from estimation.values.geometry import BinTable
from estimation.values.opinions import (
    KnownWheel,
    RailKey,
    RailPart,
    RailsApart,
    SectionConicity,
    StoredCell,
    WheelKey,
    WheelPart,
)
from estimation.values.quantities import Estimate, Status, normal_equivalent, parts_of
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import YEAR_NS


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

    ``scale_std`` is the relative scale of y - d that the alignment leaves open; ``span_ns`` are begin and end, ns UTC.
    """
    geometry = estimate_geometry(table, bins, parameters)
    if geometry.status is not Status.ESTIMATED:
        reason = geometry.reason or geometry.equivalent_conicity.reason
        assert reason is not None  # whatever is not estimated says why
        return reason
    groups = int((table.weight.sum(axis=1) > 0).sum())
    sampled, systematic = np.array([parts_of(estimate, groups) for estimate in geometry.conicity]).T
    return SectionConicity(
        wheel=wheel,
        rail=rail,
        amplitude=geometry.amplitude,
        conicity=_or_nan(estimate.value for estimate in geometry.conicity),
        sampled=normal_equivalent(sampled, groups),
        systematic=systematic,
        scale_std=scale_std,
        windows=table.windows,
        from_ns=span_ns[0],
        to_ns=span_ns[1],
    )


Key = TypeVar("Key", bound=Hashable)
Cell = TypeVar("Cell")


def with_refused(apart: RailsApart, cells: Sequence[StoredCell]) -> RailsApart:
    """Return what was found, with the wheels and rails whose cells are all refused, in the order of their keys."""
    known_rails, known_wheels = {rail.rail for rail in apart.rails}, {wheel.wheel for wheel in apart.wheels}
    of_rails = grouped((cell.rail, cell) for cell in cells if cell.rail not in known_rails)
    of_wheels = grouped((cell.wheel, cell) for cell in cells if cell.wheel not in known_wheels)
    rails, wheels = [*apart.rails], [*apart.wheels]
    for rail, refused in of_rails.items():
        nothing = _nothing(refused, len(apart.amplitude))
        rails.append(RailPart(rail, None, nothing, nothing, nothing, wheelsets_of(refused), **extent(refused)))
    for wheel, refused in of_wheels.items():
        nothing = _nothing(refused, len(apart.amplitude))
        wheels.append(WheelPart(wheel, None, nothing, sections_of(refused), **extent(refused)))
    said = apart.trends.keys() | apart.no_trends.keys()
    no_trends = {key.section: _most_frequent_reason(of) for key, of in of_rails.items() if key.section not in said}
    return replace(
        apart,
        rails=tuple(sorted(rails, key=attrgetter("rail"))),
        wheels=tuple(sorted(wheels, key=attrgetter("wheel"))),
        no_trends={**apart.no_trends, **no_trends},
    )


def grouped(cells: Iterable[tuple[Key, Cell]]) -> Mapping[Key, list[Cell]]:
    """Return cells by what they are of."""
    groups = defaultdict[Key, list[Cell]](list)
    for key, cell in cells:
        groups[key].append(cell)
    return groups


def extent(cells: Sequence[StoredCell] | Sequence[SectionConicity]) -> dict[str, int]:
    """Return how many windows cells are made from, and from when to when."""
    first, last = min(cell.from_ns for cell in cells), max(cell.to_ns for cell in cells)
    return {"windows": sum(cell.windows for cell in cells), "from_ns": first, "to_ns": last}


def wheelsets_of(cells: Sequence[StoredCell] | Sequence[SectionConicity]) -> int:
    """Return the number of wheelsets in the cells."""
    return len({cell.wheel.wheelset for cell in cells})


def sections_of(cells: Sequence[StoredCell] | Sequence[SectionConicity]) -> tuple[str, ...]:
    """Return the codes of the cells' sections, in order."""
    return tuple(sorted({cell.rail.section for cell in cells}))


def _nothing(cells: Sequence[StoredCell], amplitudes: int) -> tuple[Estimate, ...]:
    windows = float(sum(cell.windows for cell in cells))
    return (Estimate.unknown(_most_frequent_reason(cells), windows),) * amplitudes


def _most_frequent_reason(cells: Sequence[StoredCell]) -> Reason:
    reasons = [cell.reason for cell in cells if cell.reason is not None]
    count = Counter(reason.code for reason in reasons)
    return max(reasons, key=lambda reason: count[reason.code])


@dataclass(frozen=True, slots=True, eq=False)
class CellTable:
    """Cells as arrays, with their wheels and rails."""

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
    scale: FloatArray  # (n,) relative std of the scale of y - d
    windows: IntArray  # (n,)
    years: FloatArray  # (n,) middle of what was seen, since 1970

    def given(self, k: int) -> BoolArray:
        """Return which cells (n,) are known at an amplitude."""
        parts = (self.conicity, self.sampled, self.systematic)
        return np.asarray(np.isfinite([values[:, k] for values in parts]).all(axis=0))


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
        years=np.array([0.5 * (cell.from_ns + cell.to_ns) for cell in cells]) / YEAR_NS,
        **columns,
    )


DIFFER = (ReasonCode.KNOWN_RAILS_DIFFER, ReasonCode.MEASURED_WHEELS_DIFFER)


@dataclass(frozen=True, slots=True)
class ReferenceWheel(FrozenArrays):
    """The wheel as designed: what its conicity is, from its drawing and those of rails."""

    profile: str  # name
    on_reference: Annotated[FloatArray, "k"]  # on the rails that all are compared with
    on_file: Mapping[str, FloatArray] = field(default_factory=dict)  # (k,) by section, on its rails as on file

    def of(self, section: str) -> FloatArray:
        """Return its conicity (k,) on the rails of a section as on file; NaN where it has none."""
        return self.on_file.get(section, np.full(len(self.on_reference), np.nan))


@dataclass(frozen=True, slots=True)
class Anchors:
    """What holds the level, and what the wheel as designed is."""

    wheel: ReferenceWheel
    known_rails: frozenset[RailKey] = frozenset()  # rails that are as on file, and alike
    known_wheels: tuple[KnownWheel, ...] = ()
    tonnage: Mapping[str, float] = field(default_factory=dict)  # by section, million gross tonnes a year
    refused: Mapping[str, Reason] = field(default_factory=dict)  # why sections named as known hold no level
    refused_wheels: Mapping[str, Reason] = field(default_factory=dict)  # why measured wheelsets hold none, by serial
    missing: tuple[str, ...] = ()  # sections named as known that are not on file

    @property
    def level_open(self) -> Reason:
        """The reason to give where nothing holds the level."""
        nothing = "no section with known rails and no measured wheelset holds the level"
        refused = [*sorted(self.refused.items()), *sorted(self.refused_wheels.items())]
        why = "".join(f"; {name}: {reason.text}" for name, reason in refused)
        why += "".join(f"; {code} is named as known, but not on file" for code in self.missing)
        code = next((reason.code for _, reason in refused if reason.code in DIFFER), ReasonCode.RAILS_LEVEL_OPEN)
        return Reason(code, f"{nothing}: only differences of sections are known{why}")

    def without(self, sections: Mapping[str, Reason], wheelsets: Mapping[str, Reason]) -> Anchors:
        """Return the anchors without some sections and measured wheelsets, and why."""
        return replace(
            self,
            known_rails=frozenset(key for key in self.known_rails if key.section not in sections),
            known_wheels=tuple(item for item in self.known_wheels if item.wheel.wheelset not in wheelsets),
            refused={**self.refused, **sections},
            refused_wheels={**self.refused_wheels, **wheelsets},
        )


def conicity_on_rails(wheels: WheelPair, rails: RailShare, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the conicity (k,) of wheels on rails and its standard deviation; NaN where they have none."""
    nothing = np.full(len(amplitude), np.nan)
    try:
        rail = rail_profile(rails.rail)
        radius = wheels.nominal_radius
        wheelset = WheelsetOnTrack(
            wheels.left, wheels.right, rail, rail, rails.inclination, rails.gauge, radius, radius
        )
        x = ACCURACY.displacement()
        curve = radius_difference_curve(wheelset, x)
    except (ContactError, ProfileError, ParameterError):
        return nothing, nothing
    conicity = conicity_of(curve.displacement, curve.difference, amplitude, wheels.std)
    return _or_nan(estimate.value for estimate in conicity), _or_nan(estimate.std for estimate in conicity)


def _or_nan(values: Iterable[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values])


def designed_wheel(profile: str, nominal_radius: float) -> WheelPair | None:
    """Return the wheels of a profile as designed; None where no such profile is built in."""
    if not is_design(profile):
        return None
    try:
        wheel = wheel_profile(profile)
    except ProfileError:  # it is a rail
        return None
    return WheelPair(wheel, wheel, nominal_radius)

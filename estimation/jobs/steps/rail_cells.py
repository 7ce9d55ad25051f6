"""The cells of a wheelset: its windows by mileage interval, section and period, each as a conicity."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.geometry.estimate import GeometryParameters
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.job import JobContext
from estimation.jobs.steps.assumptions import Assumed, ClassLookup, Membership, membership
from estimation.jobs.steps.rolling import Part, by_interval, members, rolled
from estimation.rails.cell import section_conicity
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import BinParameters, bin_parameters, merge_all
from estimation.values.geometry import BinTable
from estimation.values.opinions import RailKey, StoredCell, WheelKey
from estimation.values.reasons import Reason
from estimation.values.roll_up import Member
from estimation.values.units import DAY_NS

CellKey = tuple[WheelKey, RailKey]
CELL_VERSION = 2
LOST = "damaged, and its windows are purged"  # in the place of a digest


@dataclass(frozen=True, slots=True)
class CellWindows:
    """What the windows of a cell together say, and how uncertain what they were found with is."""

    table: BinTable
    bins: BinParameters
    geometry: GeometryParameters
    scale_std: float


@dataclass(frozen=True, slots=True)
class CellToMake:
    """A cell that is another by now."""

    before: StoredCell  # with key, digest and extent; and the reason, where the whole interval is refused
    # None where it is refused; ``before.digest`` stands for it
    windows: CellWindows | None = field(metadata={"made_from": False})

    def made(self) -> StoredCell:
        """Return the cell, or why its windows give none."""
        if self.windows is None:
            return self.before
        conicity = section_conicity(
            self.before.wheel,
            self.before.rail,
            self.windows.table,
            self.windows.bins,
            self.windows.geometry,
            scale_std=self.windows.scale_std,
            span_ns=(self.before.from_ns, self.before.to_ns),
        )
        if isinstance(conicity, Reason):
            return replace(self.before, reason=conicity)
        return replace(self.before, cell=conicity)


@dataclass(frozen=True, slots=True)
class WheelsetCells:
    """What is other by now of the cells of a wheelset."""

    to_make: tuple[CellToMake, ...] = ()  # cells with other windows
    # cells of purged windows that are of another mileage interval, or refused or not, by now
    moved: tuple[StoredCell, ...] = ()
    kept: tuple[StoredCell, ...] = ()  # cells that are as they were, in an interval with other windows
    gone: tuple[CellKey, ...] = ()  # cells that there are no more


def wheelset_cells(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, WheelsetCells]:
    """Return what is other by now of the cells of some wheelsets.

    Windows are read of the mileage intervals that have changed. Of one whose windows have been purged the cells stay
    as they are; where its geometry is refused by now they are not used, until it is not any more.
    """
    stored: dict[str, list[StoredCell]] = {serial: [] for serial in serials}
    for cell in unit.rails.cells(serials):
        stored[cell.wheel.wheelset].append(cell)
    classes = ClassLookup(unit, context.settings.estimation)
    classes.look_up(serials)
    return {
        serial: _of_wheelset(unit, membership(unit, serial, classes), cells, context)
        for serial, cells in stored.items()
    }


def _of_wheelset(
    unit: UnitOfWork, rules: Membership, cells: Sequence[StoredCell], context: JobContext
) -> WheelsetCells:
    stored = {(cell.wheel, cell.rail): cell for cell in cells}
    intervals = unit.geometries.interval_digests(rules.wheelset)
    reader = _CellReader(unit, rules, context)
    other = WheelsetCells()
    seen: set[CellKey] = set()
    filled = [part for part in rolled(unit, rules).parts if part.roll_up.windows]
    for place, part in by_interval(part for part in filled if rules.assumed(part.roll_up) is not None).items():
        wheel = WheelKey(rules.wheelset, *place)
        refused = intervals[place].reason if place in intervals else None
        sealed = _within(part, wheel, cells) if part.roll_up.sealed else []
        if sealed:
            moved = [_sealed(replace(cell, wheel=wheel), refused) for cell in sealed]
            seen |= {(cell.wheel, cell.rail) for cell in moved}
            changed = (cell for cell in moved if cell != stored.get((cell.wheel, cell.rail)))
            other = replace(other, moved=(*other.moved, *changed))
            continue
        digest = reader.interval_digest(part, refused)
        there = [cell for cell in cells if cell.wheel == wheel]
        if there and all(cell.interval_digest == digest and not cell.damaged for cell in there):
            seen |= {(cell.wheel, cell.rail) for cell in there}
            continue
        to_make, kept, keys = reader.interval(part, wheel, refused, digest, stored)
        seen |= keys
        other = replace(other, to_make=(*other.to_make, *to_make), kept=(*other.kept, *kept))
    return replace(other, gone=tuple(sorted(set(stored) - seen)))


def _within(part: Part, wheel: WheelKey, stored: Iterable[StoredCell]) -> list[StoredCell]:
    """Return the cells of a mileage interval by time: its number is another where a lathe was registered later."""
    first_ns, end_ns = part.roll_up.first_ns, part.roll_up.end_ns
    return [
        cell
        for cell in stored
        if (cell.wheel == wheel if not cell.to_ns else first_ns <= cell.from_ns and cell.to_ns <= end_ns)
    ]


def _sealed(before: StoredCell, refused: Reason | None) -> StoredCell:
    """Return a cell whose windows have been purged as it is by now, under the key that it has."""
    if before.damaged:
        return replace(before, digest=LOST)
    if before.cell is None:
        return before
    # cells with equal arrays are equal only where they are the same object
    same = before.cell.wheel == before.wheel
    return replace(before, cell=before.cell if same else replace(before.cell, wheel=before.wheel), reason=refused)


@dataclass(frozen=True, slots=True)
class _CellReader:
    unit: UnitOfWork
    rules: Membership
    context: JobContext

    def interval_digest(self, part: Part, refused: Reason | None) -> str:
        """Return the digest of all that the cells of a mileage interval are made from."""
        text = self._common(self._assumed(part), refused)
        text.update(f"{self.context.settings.rails.model.period_days!r} {part.roll_up.content}".encode())
        return text.hexdigest()

    def interval(
        self,
        part: Part,
        wheel: WheelKey,
        refused: Reason | None,
        interval_digest: str,
        stored: Mapping[CellKey, StoredCell],
    ) -> tuple[list[CellToMake], list[StoredCell], set[CellKey]]:
        """Return the cells of an interval that are to be made, those that are as they were, and the keys of all."""
        assumed, to_make, kept, keys = self._assumed(part), [], [], set()
        windows = members(self.unit, self.rules, part)
        for rail, there in _by_rail(windows, self.context.settings.rails.model.period_days).items():
            text, last = self._common(assumed, refused), there[-1].window.record
            for member in there:
                text.update(f"{member.line}\n".encode())
            digest = text.hexdigest()
            before = stored.get((wheel, rail))
            keys.add((wheel, rail))
            if before is not None and before.digest == digest:
                kept.append(replace(before, interval_digest=interval_digest))
                continue
            extent = len(there), there[0].start_ns, last.start_ns + last.length_ns
            empty = StoredCell(wheel, rail, digest, None, refused, *extent, interval_digest)
            to_make.append(CellToMake(empty, None if refused else self._windows(empty, there, assumed)))
        return to_make, kept, keys

    def _assumed(self, part: Part) -> Assumed:
        assumed = self.rules.assumed(part.roll_up)
        assert assumed is not None  # parts of another class are not chosen
        return assumed

    def _common(self, assumed: Assumed, refused: Reason | None) -> hashlib._Hash:
        code = "" if refused is None else refused.code
        settings = self.context.settings.estimation.as_json()
        return hashlib.sha256(
            f"{CELL_VERSION} {self.context.code_version} {assumed.digest} {code} {settings!r}\n".encode()
        )

    def _windows(self, cell: StoredCell, windows: Sequence[Member], assumed: Assumed) -> CellWindows:
        bins, settings = bin_parameters(assumed.window_parameters), self.context.settings.estimation
        starts = [window.start_ns for window in windows]
        table = merge_all((cells for _, cells in self.unit.tables.cells_of(cell.wheel.wheelset, starts)), bins)
        versions = sorted({v for v in (member.window.track_version for member in windows) if v is not None})
        used = [self.unit.tracks.alignment(cell.rail.section, version) for version in versions]
        # without the mean of the gauge deviation: what a section's gauge does belongs to its rails
        tracks = [
            replace(track, gauge_deviation=track.gauge_deviation - np.mean(track.gauge_deviation))
            for track in used
            if track is not None
        ]
        uncertainty = ParameterUncertainty.of(assumed.on_file.vehicle_class).on(tracks, cell.wheel.wheelset)
        geometry = replace(settings.geometry, uncertainty=uncertainty)
        return CellWindows(table, bins, geometry, max((track.scale_std for track in tracks), default=0.0))


def _by_rail(members: Sequence[Member], period_days: float) -> dict[RailKey, list[Member]]:
    """Return the windows, oldest first, by section and period."""
    by_rail: defaultdict[RailKey, list[Member]] = defaultdict(list)
    for member in members:
        record = member.window.record
        if record.track_section is not None:
            period = int(record.start_ns // (period_days * DAY_NS))
            by_rail[RailKey(record.track_section, period)].append(member)
    return by_rail

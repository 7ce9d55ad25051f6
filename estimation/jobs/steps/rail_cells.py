"""The cells of a wheelset: its windows by mileage interval, section and period, each as a conicity."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.job import JobContext
from estimation.jobs.steps.membership import Membership, membership
from estimation.jobs.steps.rolling import Part, members, rolled
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.rails.cell import section_conicity
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import bin_parameters, merge_all
from estimation.values.rails import RailKey, SectionConicity, StoredCell, WheelKey
from estimation.values.reasons import Reason
from estimation.values.roll_up import Member, Side
from estimation.values.track import TrackAlignment

DAY_NS = 86_400_000_000_000
CellKey = tuple[WheelKey, RailKey]
CELL_VERSION = 2
LOST = "damaged, and its windows are purged"  # in the place of a digest


@dataclass(frozen=True, slots=True)
class CellsFound:
    """The cells of a wheelset as they should be stored: those that are new or others, and those that are gone."""

    changed: tuple[StoredCell, ...]
    gone: tuple[CellKey, ...]


def cells_of(unit: UnitOfWork, serial: str, context: JobContext) -> CellsFound:
    """Return what has changed of the cells of a wheelset.

    Of a mileage interval whose windows have been purged the cells stay as they are; where its geometry is refused by
    now they are not used, until it is not any more.

    Args:
        unit: Roll-ups, tables, geometries, alignments and the registry are read.
    """
    stored = {(one.wheel, one.rail): one for one in unit.rails.cells(serial)}
    rules = membership(unit, serial, ClassLookup(unit, context.settings.estimation))
    reader = _CellReader(unit, rules, context)
    changed: list[StoredCell] = []
    seen: set[CellKey] = set()
    for part in _chosen(rules, rolled(unit, rules).parts):
        wheel = WheelKey(serial, part.roll_up.key.baseline, part.roll_up.key.interval)
        refused = unit.geometries.reason(serial, wheel.baseline, wheel.interval)
        own = _within(part, wheel, stored.values()) if part.roll_up.sealed else []
        if own:
            kept = [_sealed(replace(one, wheel=wheel), refused) for one in own]
            seen |= {(one.wheel, one.rail) for one in kept}
            changed += [one for one in kept if one != stored.get((one.wheel, one.rail))]
            continue
        assumed = rules.assumed(part.roll_up)
        assert assumed is not None  # parts of another class are not chosen
        for rail, there in _by_rail(members(unit, rules, part), context.settings.rails.period_days).items():
            digest = reader.digest(there, assumed, refused)
            seen.add((wheel, rail))
            if (wheel, rail) not in stored or stored[wheel, rail].digest != digest:
                changed.append(reader.cell(wheel, rail, there, assumed, refused, digest))
    return CellsFound(tuple(changed), tuple(sorted(set(stored) - seen)))


def _within(part: Part, wheel: WheelKey, stored: Iterable[StoredCell]) -> list[StoredCell]:
    """Return the cells of a mileage interval by time: its number is another where a lathe was registered later."""
    first_ns, end_ns = part.roll_up.first_ns, part.roll_up.end_ns
    return [
        one
        for one in stored
        if (one.wheel == wheel if not one.to_ns else first_ns <= one.from_ns and one.to_ns <= end_ns)
    ]


def _sealed(before: StoredCell, refused: Reason | None) -> StoredCell:
    """Return a cell whose windows have been purged as it is by now, under the key that it has."""
    if before.damaged:
        return replace(before, digest=LOST)
    if before.cell is None:
        return before
    return replace(before, cell=_of_wheel(before.cell, before.wheel), reason=refused)


def _of_wheel(cell: SectionConicity, wheel: WheelKey) -> SectionConicity:
    return cell if cell.wheel == wheel else replace(cell, wheel=wheel)


@dataclass(frozen=True, slots=True)
class _CellReader:
    unit: UnitOfWork
    rules: Membership
    context: JobContext

    def digest(self, own: Sequence[Member], assumed: Assumed, refused: Reason | None) -> str:
        """Return the digest of all that a cell is made from."""
        code = "" if refused is None else refused.code
        settings = self.context.settings.estimation.as_json()
        text = hashlib.sha256(
            f"{CELL_VERSION} {self.context.code_version} {assumed.digest} {code} {settings!r}\n".encode()
        )
        for one in own:
            text.update(f"{one.line}\n".encode())
        return text.hexdigest()

    def cell(
        self,
        wheel: WheelKey,
        rail: RailKey,
        own: Sequence[Member],
        assumed: Assumed,
        refused: Reason | None,
        digest: str,
    ) -> StoredCell:
        """Return a cell, or why its windows give none: what contradicts the whole interval, or themselves."""
        last = own[-1].window.record
        extent = len(own), own[0].start_ns, last.start_ns + last.length_ns
        if refused is not None:
            return StoredCell(wheel, rail, digest, None, refused, *extent)
        bins, settings = bin_parameters(assumed.windows), self.context.settings.estimation
        starts = [one.start_ns for one in own]
        table = merge_all((cells for _, cells in self.unit.tables.cells_of(wheel.wheelset, starts)), bins)
        versions = sorted({one.window.track_version for one in own if one.window.track_version is not None})
        used = [self.unit.tracks.alignment(rail.section, version) for version in versions]
        tracks = [at_own_gauge(track) for track in used if track is not None]
        uncertainty = ParameterUncertainty.of(assumed.on_file.vehicle_class).on(tracks, wheel.wheelset)
        found = section_conicity(
            wheel,
            rail,
            table,
            bins,
            replace(settings.geometry, uncertainty=uncertainty),
            scale_std=max((track.scale_std for track in tracks), default=0.0),
            span_ns=extent[1:],
        )
        if isinstance(found, Reason):
            return StoredCell(wheel, rail, digest, None, found, *extent)
        return StoredCell(wheel, rail, digest, found, None, *extent)


def at_own_gauge(track: TrackAlignment) -> TrackAlignment:
    """Return an alignment whose gauge deviation has no mean: what a section's gauge does belongs to its rails."""
    return replace(track, gauge_deviation=track.gauge_deviation - np.mean(track.gauge_deviation))


def _chosen(rules: Membership, parts: Sequence[Part]) -> list[Part]:
    """Return one part for each mileage interval: after an identity change, of the class with most windows."""
    places: defaultdict[tuple[int, int], list[Part]] = defaultdict(list)
    for part in parts:
        if part.roll_up.windows and rules.assumed(part.roll_up) is not None:
            places[part.roll_up.key.baseline, part.roll_up.key.interval].append(part)
    found = []
    for place in sorted(places):
        after = [part for part in places[place] if part.roll_up.key.side is Side.AFTER]
        found.append(max(after or places[place], key=lambda part: (part.roll_up.windows, part.roll_up.last_ns)))
    return found


def _by_rail(found: Sequence[Member], period_days: float) -> dict[RailKey, list[Member]]:
    """Return the windows, oldest first, by section and period."""
    by_rail: defaultdict[RailKey, list[Member]] = defaultdict(list)
    for one in found:
        record = one.window.record
        if record.track_section is not None:
            period = int(record.start_ns // (period_days * DAY_NS))
            by_rail[RailKey(record.track_section, period)].append(one)
    return by_rail

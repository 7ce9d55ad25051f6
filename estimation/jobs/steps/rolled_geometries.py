"""The geometries of a wheelset from its roll-ups: one per mileage interval, and the current one with forgetting."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.job import JobContext
from estimation.jobs.steps.estimated_geometry import (
    CONTRADICTIONS,
    EstimatedWith,
    RadiusOnFile,
    contradiction,
    former,
    no_geometry,
    remembered,
    stated,
)
from estimation.jobs.steps.rolling import Part, Rolled, sums
from estimation.jobs.steps.vehicle_classes import CONTRADICTED, Assumed, Membership, PassedOverWindows
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import weighted_sum
from estimation.values.fields import JsonValue
from estimation.values.geometry import LEFT_OUT, PASSED_OVER, BinTable, Contradiction, GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.roll_up import MOST_CHOSEN, RollUp, RollUpKey, Side
from estimation.values.windows import WindowRecord

REMEMBERED_HALF_LIVES = 20.0  # a weight of one in a million
SUMS_IN_MEMORY = 4  # roll-ups of a wheelset, 1.5 MB each
Place = tuple[int, int]  # baseline and interval


@dataclass(slots=True)
class RolledGeometries:
    """Geometries of one wheelset, as one transaction sees its roll-ups.

    Attributes:
        radius: What was found of the radius on file on the way.
        earlier: Digest and sum of the intervals before the newest one, where it had to be made.
    """

    unit: UnitOfWork
    rules: Membership
    rolled: Rolled
    context: JobContext
    radius: RadiusOnFile = field(init=False)
    earlier: tuple[str, BinTable] | None = None
    _passed_over: PassedOverWindows = field(init=False)
    _refused: Sequence[WindowRecord] | None = None
    _sums: dict[RollUpKey, tuple[BinTable, BinTable]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.radius = RadiusOnFile(self.unit, self.rules.wheelset)
        self._passed_over = PassedOverWindows(self.unit, self.rules)

    def sums(self, part: Part) -> tuple[BinTable, BinTable]:
        """Return the sums of a roll-up; of those that have changed some are kept in memory."""
        found = self._sums.get(part.roll_up.key) or sums(self.unit, self.rules.wheelset, part)
        if part.added:
            if len(self._sums) >= SUMS_IN_MEMORY:
                self._sums.pop(next(iter(self._sums)))
            self._sums[part.roll_up.key] = found
        return found

    def forget_sums(self) -> None:
        """Forget the sums that were kept in memory."""
        self._sums.clear()

    def records(self) -> list[GeometryRecord]:
        """Return the geometries whose inputs differ from what is stored; the current one comes last.

        A geometry whose windows are all gone (refused since, or of another baseline now) is followed by an empty one.
        The current geometry is that of the newest baseline with windows. What was measured before and after an
        identity change of the wheelset is never merged. Nor is what was measured on vehicles of different classes: the
        current geometry is of the class that the wheelset ran in last, an interval of the one with most of its windows.
        What cannot be made again, because its class is another by now and its windows are gone, stays as it is; where
        what it rests on was corrected it holds no number any more.
        """
        filled = [part for part in self.rolled.parts if part.roll_up.windows]
        usable = self._usable(filled)
        places = {_place(part) for part in usable}
        others = [part for part in filled if _place(part) not in places]
        left = {_place(part) for part in others if self.rules.of_its_baseline(part.roll_up)}
        found = [*self._intervals(usable, {_place(part) for part in others}), *self._contradicted(others)]
        newest = max((part.roll_up.key.baseline for part in usable), default=None)
        if left and (newest is None or newest < max(left)[0]):
            return found
        found += self._ended(newest)
        return found if newest is None else [*found, self._current(self._remembered(newest, usable))]

    def current_parts(self) -> list[Part]:
        """Return the roll-ups that the current geometry is made of, by interval; none where there are no windows."""
        usable = self._usable([part for part in self.rolled.parts if part.roll_up.windows])
        newest = max((part.roll_up.key.baseline for part in usable), default=None)
        return [] if newest is None else self._remembered(newest, usable)

    def _usable(self, filled: Sequence[Part]) -> list[Part]:
        """Return the roll-ups whose class is still the same."""
        return [part for part in filled if self.rules.assumed(part.roll_up) is not None]

    def _intervals(self, usable: Sequence[Part], left: set[Place]) -> list[GeometryRecord]:
        """Return the geometries per mileage interval that are not stored like that."""
        stored = self.unit.geometries.interval_digests(self.rules.wheelset)
        parts: defaultdict[Place, list[Part]] = defaultdict(list)
        for part in usable:
            parts[_place(part)].append(part)
        records = []
        for place in sorted(parts):
            part = _most_windows(parts[place])
            digest = self._digest([part.roll_up], self._assumed(part), self._against([part.roll_up]))
            if place not in stored or stored[place].input_digest != digest:
                records.append(self._record([part], place, digest))
        gone = [p for p in stored if p not in parts and p not in left and stored[p].windows]
        return records + self._emptied_intervals(gone)

    def forgotten(self) -> list[int]:
        """Return the numbers of the roll-ups without tables that have no weight in the current geometry any more."""
        last_km = max((part.roll_up.last_km for part in self.rolled.parts), default=0.0)
        return [
            part.roll_up.number
            for part in self.rolled.parts
            if part.roll_up.number is not None
            and part.roll_up.sealed
            and self.rules.of_its_baseline(part.roll_up)
            and last_km - self.rules.end_km(part.roll_up.key) > REMEMBERED_HALF_LIVES * self.rules.half_life_km
        ]

    def _contradicted(self, parts: Sequence[Part]) -> list[GeometryRecord]:
        """Return geometries without numbers in place of those that cannot be made again and are wrong by now."""
        wrong = {_place(part): part for part in parts if self._passed_over.contradicted(part.roll_up)}
        if not wrong:
            return []
        found = []
        for stored in self.unit.geometries.intervals(self.rules.wheelset):
            part = None if stored.interval is None else wrong.get((stored.baseline, stored.interval))
            if part is not None and stored.geometry.reason != CONTRADICTED:
                record = replace(stored, geometry=stored.geometry.mismatched(CONTRADICTED))
                found.append(self._now(record, self._digest([part.roll_up], None, CONTRADICTED)))
        return found

    def _now(self, record: GeometryRecord, digest: str) -> GeometryRecord:
        clock, version = self.context.clock, self.context.code_version
        return replace(record, input_digest=digest, code_version=version, recorded_ns=clock.now_ns())

    def _emptied_intervals(self, gone: Sequence[Place]) -> list[GeometryRecord]:
        if not gone:
            return []
        intervals = self.unit.geometries.intervals(self.rules.wheelset)
        return [self._emptied(one) for one in intervals if (one.baseline, one.interval) in gone]

    def _ended(self, newest: int | None) -> list[GeometryRecord]:
        """Return empty geometries behind those of baselines that have no windows any more, or that there are not.

        A reprofiling that was voided leaves fewer baselines than have been estimated.
        """
        records = self.unit.geometries.baselines(self.rules.wheelset)
        gone = [one for one in records if one.geometry.windows and (newest is None or one.baseline > newest)]
        return [self._emptied(one) for one in gone]

    def _current(self, used: Sequence[Part]) -> GeometryRecord:
        roll_ups = [part.roll_up for part in used]
        baseline = roll_ups[0].key.baseline
        digest = self._digest(roll_ups, self._assumed(used[-1]), self._against(roll_ups))
        record = self._record(used, (baseline, None), digest)
        left_out = self.unit.plausibility.left_out(self.rules.wheelset, self.rules.baselines[baseline].from_ns)
        counted: dict[str, JsonValue] = {code.value: count for code, count in left_out.items()}
        return replace(record, parameters={**record.parameters, LEFT_OUT: counted})

    def _remembered(self, baseline: int, usable: Sequence[Part]) -> list[Part]:
        """Return what the current geometry is made of, by interval: of the newest side and class, with a weight."""
        of_baseline = [part for part in usable if part.roll_up.key.baseline == baseline]
        right = [part for part in of_baseline if not self._passed_over.contradicted(part.roll_up)] or of_baseline
        near = [part for part in right if part.roll_up.key.side is Side.AFTER] or right
        last = max(near, key=lambda part: part.roll_up.last_ns).roll_up
        longest = REMEMBERED_HALF_LIVES * self.rules.half_life_km
        same = (last.key.table_key, last.key.vehicle_class)
        return sorted(
            (
                part
                for part in near
                if (part.roll_up.key.table_key, part.roll_up.key.vehicle_class) == same
                and last.last_km - self.rules.end_km(part.roll_up.key) <= longest
            ),
            key=lambda part: part.roll_up.key,
        )

    def _assumed(self, part: Part) -> Assumed:
        found = self.rules.assumed(part.roll_up)
        assert found is not None  # ``records`` leaves the others out
        return found

    def _against(self, roll_ups: Sequence[RollUp]) -> Reason | None:
        """Return why most windows of the time of some roll-ups were refused; None where fewer were."""
        if self._refused is None:
            self._refused = self.unit.windows.refused(self.rules.wheelset, CONTRADICTIONS)
        return contradiction(
            self._refused,
            frozenset(vehicle for one in roll_ups for vehicle in one.vehicles),
            min(one.first_ns for one in roll_ups),
            max(one.last_ns for one in roll_ups),
            sum(one.windows for one in roll_ups),
        )

    def _digest(self, roll_ups: Sequence[RollUp], assumed: Assumed | None, against: Reason | None) -> str:
        of_class = "" if assumed is None else f" {assumed.digest}"
        of_class += "" if against is None else f" {against.code}"
        counts = self._passed_over.counts(roll_ups)
        of_class += f" {json.dumps(counts)}" if counts else ""
        text = hashlib.sha256(f"{self.context.code_version}{of_class}\n".encode())
        for one in roll_ups:
            text.update(f"{one.key.interval} {int(one.key.side)} {one.windows} {one.content}\n".encode())
        return text.hexdigest()

    def _record(self, parts: Sequence[Part], place: tuple[int, int | None], digest: str) -> GeometryRecord:
        roll_ups, used = [part.roll_up for part in parts], self.estimated_with(parts)
        current, last = place[1] is None, max(roll_ups, key=lambda one: one.last_ns)
        table = self.forgetting(parts) if current else self.sums(parts[0])[0]
        geometry, contradiction = used.estimated(table), None
        if geometry.status is not Status.MODEL_MISMATCH:
            contradiction = self.contradiction(parts, place)
        return GeometryRecord(
            wheelset=self.rules.wheelset,
            baseline=place[0],
            interval=place[1],
            mileage_km=self._mean_km(roll_ups) if current else roll_ups[0].mean_km,
            from_ns=min(one.first_ns for one in roll_ups),
            to_ns=last.end_ns,
            geometry=geometry.against(contradiction),
            input_digest=digest,
            track_versions=_versions(roll_ups),
            parameters={**used.as_json(), **self._stated(roll_ups), **stated(contradiction)},
            code_version=self.context.code_version,
            recorded_ns=self.context.clock.now_ns(),
        )

    def estimated_with(self, parts: Sequence[Part]) -> EstimatedWith:
        """Return what a geometry is estimated with.

        Args:
            parts: The roll-ups that it is made of; the class is that of the last one.
        """
        assumed, versions = self._assumed(parts[-1]), _versions([part.roll_up for part in parts])
        newest = [self.unit.tracks.alignment(code, used[-1]) for code, used in versions.items()]
        of_class = ParameterUncertainty.of(assumed.on_file.vehicle_class)
        tracks = [track for track in newest if track is not None]
        return EstimatedWith(self.context.settings.estimation, assumed, of_class.on(tracks, self.rules.wheelset))

    def contradiction(self, parts: Sequence[Part], place: tuple[int, int | None]) -> Contradiction | None:
        """Return what speaks against a geometry beside its own samples; None where nothing does.

        Args:
            place: Baseline and interval; None is the current geometry.
        """
        roll_ups = [part.roll_up for part in parts]
        corrected = any(self._passed_over.contradicted(one) for one in roll_ups)
        against = CONTRADICTED if corrected else self._against(roll_ups)
        if against is not None:
            return Contradiction(against, certain=True, relative=0.0)
        of_radius = partial(self._remembered_of_radius, place)
        return self.radius.contradicted(_chosen(roll_ups), self._assumed(parts[-1]), of_radius)

    def _stated(self, roll_ups: Sequence[RollUp]) -> Mapping[str, JsonValue]:
        """Return what is stated of windows that would be others today."""
        counts: dict[str, JsonValue] = dict(self._passed_over.counts(roll_ups))
        return {PASSED_OVER: counts} if counts else {}

    def _remembered_of_radius(self, place: tuple[int, int | None]) -> Contradiction | None:
        """Return what the geometry that is stored has against the radius on file; None where nothing."""
        return remembered(former(self.unit, self.rules.wheelset, *place))

    def forgetting(self, parts: Sequence[Part]) -> BinTable:
        """Return the sum of roll-ups with forgetting; the newest window has weight 1.

        Args:
            parts: In the order of their intervals.
        """
        newest_km = max((part.roll_up for part in parts), key=lambda one: one.last_ns).last_km
        *before, last = parts
        tables = [(self._weight(last.roll_up, newest_km), self.sums(last)[1])]
        if before:
            tables.insert(0, (self._weight(before[-1].roll_up, newest_km), self._earlier(before)))
        return weighted_sum(tables)

    def _earlier(self, parts: Sequence[Part]) -> BinTable:
        """Return the sum of the intervals that are over with forgetting, weighted as at the end of the last of them."""
        text = "".join(f"{one.roll_up.key} {one.roll_up.windows} {one.roll_up.content}\n" for one in parts)
        digest = hashlib.sha256(f"{self.rules.digest}\n{text}".encode()).hexdigest()
        stored = self.unit.roll_ups.earlier(self.rules.wheelset, digest)
        if stored is None:
            end_km = self.rules.end_km(parts[-1].roll_up.key)
            stored = weighted_sum((self._weight(part.roll_up, end_km), self.sums(part)[1]) for part in parts)
            self.earlier = digest, stored
        return stored

    def _weight(self, roll_up: RollUp, at_km: float) -> float:
        return float(0.5 ** ((at_km - self.rules.end_km(roll_up.key)) / self.rules.half_life_km))

    def _mean_km(self, roll_ups: Sequence[RollUp]) -> float:
        """Return the mean mileage with forgetting."""
        newest_km = max(one.last_km for one in roll_ups)
        weights = [self._weight(one, newest_km) for one in roll_ups]
        total = sum(weight * one.weighted_km for weight, one in zip(weights, roll_ups, strict=True))
        return total / sum(w * one.weight for w, one in zip(weights, roll_ups, strict=True))

    def _emptied(self, record: GeometryRecord) -> GeometryRecord:
        """Return what follows ``record`` when none of its windows is left."""
        settings = self.context.settings.estimation
        return replace(
            record,
            geometry=no_geometry(settings, record.geometry.parameter_key),
            input_digest=self._digest([], None, None),
            track_versions={},
            parameters=settings.as_json(),
            code_version=self.context.code_version,
            recorded_ns=self.context.clock.now_ns(),
        )


def _place(part: Part) -> Place:
    return part.roll_up.key.baseline, part.roll_up.key.interval


def _most_windows(parts: Sequence[Part]) -> Part:
    """Return the part that stands for an interval: after an identity change, of the class with most windows."""
    after = [part for part in parts if part.roll_up.key.side is Side.AFTER]
    return max(after or parts, key=lambda part: (part.roll_up.windows, part.roll_up.last_ns))


def _versions(roll_ups: Sequence[RollUp]) -> Mapping[str, tuple[int, ...]]:
    """Return by section the versions of its alignment that tables rest on, increasing."""
    found: defaultdict[str, set[int]] = defaultdict(set)
    for one in roll_ups:
        for section, versions in one.versions.items():
            found[section].update(versions)
    return {section: tuple(sorted(found[section])) for section in sorted(found)}


def _chosen(roll_ups: Sequence[RollUp]) -> list[tuple[str, int]]:
    """Return windows that stand for the newest of some roll-ups, as many as one has at most."""
    chosen: list[tuple[str, int]] = []
    for one in sorted(roll_ups, key=lambda one: one.last_ns, reverse=True):
        chosen += one.chosen
        if len(chosen) >= MOST_CHOSEN:
            break
    return sorted(chosen[:MOST_CHOSEN], key=lambda item: item[1])

"""Stage: the geometries of a wheelset from its bin tables: one per mileage interval, and the current with forgetting.

A table is added once to the roll-up of its interval, so that a new window costs itself, however much came before.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from estimation.jobs.job import Job, JobContext
from estimation.jobs.parameters import JOBS, WORK
from estimation.jobs.runner import run
from estimation.jobs.stage import Counted, Outcome, Stage, part_of_result
from estimation.jobs.steps.assumptions import (
    CONTRADICTED,
    Assumed,
    ClassLookup,
    Membership,
    PassedOverWindows,
    membership,
)
from estimation.jobs.steps.estimated_geometry import (
    CONTRADICTIONS,
    EstimatedWith,
    RadiusOnFile,
    contradiction,
    former,
    mean_km,
    no_geometry,
    remembered,
    stated,
    versions_of,
    windows_of_newest,
)
from estimation.jobs.steps.rolling import Part, Place, Rolled, by_interval, read_ahead, read_sums_ahead, rolled, sums
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import weighted_sum
from estimation.values.fields import JsonValue
from estimation.values.geometry import GEOMETRY as GEOMETRIES
from estimation.values.geometry import (
    LEFT_OUT,
    PASSED_OVER,
    BinTable,
    Contradiction,
    GeometryRecord,
    WheelsetGeometry,
    result_of_geometry,
)
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.roll_up import RolledPart, RollUp, RollUpKey, RollUpState, Side
from estimation.values.runs import Facet
from estimation.values.trend import TREND
from estimation.values.windows import DueStage, WindowRecord

_BEING_MADE = RollUpState("", {})  # of roll-ups that are made again, until all of them are


@dataclass(slots=True)
class RolledGeometries:
    """Geometries of one wheelset, as one transaction sees its roll-ups."""

    unit: UnitOfWork
    rules: Membership
    rolled: Rolled
    context: JobContext
    radius: RadiusOnFile = field(init=False)  # what was found of the radius on file on the way
    # digest and sum of the intervals before the newest one, where it had to be made
    earlier: tuple[str, BinTable] | None = None
    _passed_over: PassedOverWindows = field(init=False)
    _refused: Sequence[WindowRecord] | None = None
    kept_sums: dict[RollUpKey, tuple[BinTable, BinTable]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.radius = RadiusOnFile(self.unit, self.rules.wheelset)
        self._passed_over = PassedOverWindows(self.unit, self.rules)

    def sums(self, part: Part) -> tuple[BinTable, BinTable]:
        """Return the sums of a roll-up; of those that have changed some are kept in memory."""
        found = self.kept_sums.get(part.roll_up.key) or sums(self.unit, self.rules.wheelset, part)
        if part.added:
            if len(self.kept_sums) >= WORK.roll_ups_in_memory:
                self.kept_sums.pop(next(iter(self.kept_sums)))
            self.kept_sums[part.roll_up.key] = found
        return found

    def records(self) -> list[GeometryRecord]:
        """Return the geometries whose inputs differ from what is stored; the current one comes last.

        A geometry whose windows are all gone (refused since, or of another baseline now) is followed by an empty one.
        What was measured before and after an identity change, or on vehicles of different classes, is never merged: the
        current geometry is of the class that the wheelset ran in last, an interval of the one with most of its windows.
        What cannot be made again, because its class is another by now and its windows are gone, stays as it is; where
        what it rests on was corrected it holds no number any more.
        """
        usable = self._usable()
        places = {part.place for part in usable}
        others = [part for part in self.rolled.parts if part.roll_up.windows and part.place not in places]
        left = {part.place for part in others if self.rules.of_its_baseline(part.roll_up)}
        found = [*self._intervals(usable, {part.place for part in others}), *self._contradicted(others)]
        newest = max((baseline for baseline, _ in places), default=None)
        if left and (newest is None or newest < max(left)[0]):
            return found
        found += self._ended(newest)
        return found if newest is None else [*found, self._current(self._remembered(newest, usable))]

    def current_parts(self) -> list[Part]:
        """Return the roll-ups that the current geometry is made of, by interval; none where there are no windows."""
        usable = self._usable()
        return self._remembered(max(part.roll_up.key.baseline for part in usable), usable) if usable else []

    def _usable(self) -> list[Part]:
        """Return the roll-ups with windows whose class is still the same."""
        filled = (part for part in self.rolled.parts if part.roll_up.windows)
        return [part for part in filled if self.rules.assumed(part.roll_up) is not None]

    def _intervals(self, usable: Sequence[Part], left: set[Place]) -> list[GeometryRecord]:
        """Return the geometries per mileage interval that are not stored like that."""
        stored = self.unit.geometries.interval_digests(self.rules.wheelset)
        parts, records = by_interval(usable), []
        for place, part in parts.items():
            digest = self._digest([part.roll_up], self._assumed(part), self._against([part.roll_up]))
            if place not in stored or stored[place].input_digest != digest:
                records.append(self._record([part], place, digest))
        gone = [p for p in stored if p not in parts and p not in left and stored[p].windows]
        intervals = self.unit.geometries.intervals(self.rules.wheelset) if gone else ()
        return records + [self._emptied(one) for one in intervals if (one.baseline, one.interval) in gone]

    def forgotten(self) -> list[int]:
        """Return the numbers of the roll-ups without tables that have no weight in the current geometry any more."""
        last_km = max((part.roll_up.last_km for part in self.rolled.parts), default=0.0)
        return [
            part.roll_up.number
            for part in self.rolled.parts
            if part.roll_up.number is not None
            and part.roll_up.sealed
            and self.rules.of_its_baseline(part.roll_up)
            and last_km - self.rules.end_km(part.roll_up.key) > JOBS.remembered_half_lives * self.rules.half_life_km
        ]

    def _contradicted(self, parts: Sequence[Part]) -> list[GeometryRecord]:
        """Return geometries without numbers in place of those that cannot be made again and are wrong by now."""
        wrong = {part.place: part for part in parts if self._passed_over.contradicted(part.roll_up)}
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
        longest = JOBS.remembered_half_lives * self.rules.half_life_km
        same = (last.key.table_key, last.key.vehicle_class)
        of_class = (part for part in near if (part.roll_up.key.table_key, part.roll_up.key.vehicle_class) == same)
        weighty = [part for part in of_class if last.last_km - self.rules.end_km(part.roll_up.key) <= longest]
        return sorted(weighty, key=lambda part: part.roll_up.key)

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
            {vehicle for one in roll_ups for vehicle in one.vehicles},
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
        counts = self._passed_over.counts(roll_ups)  # of windows that would be others today
        passed_over: dict[str, JsonValue] = {PASSED_OVER: dict(counts)} if counts else {}
        return GeometryRecord(
            wheelset=self.rules.wheelset,
            baseline=place[0],
            interval=place[1],
            mileage_km=mean_km(self.rules, roll_ups) if current else roll_ups[0].mean_km,
            from_ns=min(one.first_ns for one in roll_ups),
            to_ns=last.end_ns,
            geometry=geometry.against(contradiction),
            input_digest=digest,
            track_versions=versions_of(roll_ups),
            parameters={**used.as_json(), **passed_over, **stated(contradiction)},
            code_version=self.context.code_version,
            recorded_ns=self.context.clock.now_ns(),
        )

    def estimated_with(self, parts: Sequence[Part]) -> EstimatedWith:
        """Return what a geometry of some roll-ups is estimated with; the class is that of the last one."""
        versions, settings = versions_of([part.roll_up for part in parts]), self.context.settings.estimation
        return EstimatedWith.of(self.unit, settings, self._assumed(parts[-1]), self.rules.wheelset, versions)

    def contradiction(self, parts: Sequence[Part], place: tuple[int, int | None]) -> Contradiction | None:
        """Return what speaks against a geometry beside its own samples; at an interval of None the current one."""
        roll_ups = [part.roll_up for part in parts]
        corrected = any(self._passed_over.contradicted(one) for one in roll_ups)
        against = CONTRADICTED if corrected else self._against(roll_ups)
        if against is not None:
            return Contradiction(against, certain=True, relative=0.0)
        return self.radius.contradicted(
            windows_of_newest(roll_ups),
            self._assumed(parts[-1]),
            lambda: remembered(former(self.unit, self.rules.wheelset, *place)),
        )

    def forgetting(self, parts: Sequence[Part]) -> BinTable:
        """Return the sum of roll-ups, by interval, with forgetting; the newest window has weight 1."""
        newest_km = max((part.roll_up for part in parts), key=lambda one: one.last_ns).last_km
        *before, last = parts
        tables = [(self.rules.weight(last.roll_up.key, newest_km), self.sums(last)[1])]
        if before:
            tables.insert(0, (self.rules.weight(before[-1].roll_up.key, newest_km), self._earlier(before)))
        return weighted_sum(tables)

    def _earlier(self, parts: Sequence[Part]) -> BinTable:
        """Return the sum of the intervals that are over with forgetting, weighted as at the end of the last of them."""
        text = "".join(f"{one.roll_up.key} {one.roll_up.windows} {one.roll_up.content}\n" for one in parts)
        digest = hashlib.sha256(f"{self.rules.digest}\n{text}".encode()).hexdigest()
        stored = self.unit.roll_ups.earlier(self.rules.wheelset, digest)
        if stored is None:
            end_km = self.rules.end_km(parts[-1].roll_up.key)
            stored = weighted_sum((self.rules.weight(part.roll_up.key, end_km), self.sums(part)[1]) for part in parts)
            self.earlier = digest, stored
        return stored

    def _emptied(self, record: GeometryRecord) -> GeometryRecord:
        """Return what follows ``record`` when none of its windows is left."""
        settings = self.context.settings.estimation
        geometry = no_geometry(settings, record.geometry.parameter_key)
        empty = replace(record, geometry=geometry, track_versions={}, parameters=settings.as_json())
        return self._now(empty, self._digest([], None, None))


@dataclass(frozen=True, slots=True)
class GeometryInputs:
    """What the geometries of a wheelset are made from, and what became of it while it was read.

    The sums of bin tables are megabytes: each is made a geometry where it is read, and only these are kept.
    """

    rules: str
    contents: tuple[tuple[str, str], ...]  # of the roll-ups, as they are to be
    looked_at: Mapping[int, int]  # windows that are due, with the versions that were read
    made_from: tuple[str, ...]  # digests of the geometries that are others by now
    # whether these are all roll-ups that are to be made again; else the rest, and the geometries, come next
    whole: bool
    records: tuple[GeometryRecord, ...] = field(metadata={"made_from": False})
    parts: tuple[RolledPart, ...] = field(metadata={"made_from": False})
    rolled: RolledGeometries = field(metadata={"made_from": False})


def load(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, GeometryInputs]:
    """Return the inputs of the wheelsets that have a bin table or a geometry: the others have nothing to estimate from.

    Where many roll-ups are to be made again, some of them at a time, before the geometries.
    """
    wheelsets = unit.geometries.estimable(serials)
    of_wheelsets = geometries_of(unit, [serial for serial in serials if serial in wheelsets], context)
    read_sums_ahead(unit, [(serial, geometries.rolled) for serial, geometries in of_wheelsets.items()])
    return {serial: _inputs(geometries) for serial, geometries in of_wheelsets.items()}


def _inputs(geometries: RolledGeometries) -> GeometryInputs:
    as_now = geometries.rolled
    changed = [part for part in as_now.parts if part.changed] if as_now.due else []
    whole = len(changed) <= WORK.roll_ups_in_memory
    records = geometries.records() if whole else []
    some = changed if whole else changed[: WORK.roll_ups_in_memory]
    parts = [RolledPart(part.roll_up, part.before, *geometries.sums(part), part.added) for part in some]
    geometries.kept_sums.clear()
    return GeometryInputs(
        rules=repr(as_now.state),
        contents=tuple((str(part.roll_up.key), part.roll_up.content) for part in as_now.parts),
        looked_at=as_now.looked_at,
        made_from=tuple(record.input_digest for record in records),
        whole=whole,
        records=tuple(records),
        parts=tuple(parts),
        rolled=geometries,
    )


def geometries_of(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, RolledGeometries]:
    """Return the geometries of wheelsets by serial, as they can be made from their roll-ups."""
    rules = [membership(unit, serial, ClassLookup(unit, context.settings.estimation)) for serial in serials]
    read_ahead(unit, rules)
    return {one.wheelset: RolledGeometries(unit, one, rolled(unit, one), context) for one in rules}


def compute(inputs: GeometryInputs) -> Outcome[WheelsetGeometry]:
    """Return the geometries that are others by now."""
    return Outcome([part_of_result(result_of_geometry(record)) for record in inputs.records], more=not inputs.whole)


def store(
    unit: UnitOfWork, context: JobContext, made: Mapping[str, tuple[GeometryInputs | None, Outcome[WheelsetGeometry]]]
) -> Mapping[str, int]:
    """Store the roll-ups, and the bins of the current geometry as plain rows."""
    inputs = {serial: one for serial, (one, _) in made.items() if one is not None}
    whole = {serial: one for serial, one in inputs.items() if one.whole}
    being_made = {serial: _BEING_MADE for serial in inputs if serial not in whole}
    due = {serial: one.rolled.rolled for serial, one in whole.items() if one.rolled.rolled.due}
    unit.geometries.show_bins([serial for serial, one in whole.items() if any(r.interval is None for r in one.records)])
    parts = {serial: one.parts for serial, one in inputs.items() if serial in due or serial in being_made}
    unit.roll_ups.put(parts, context.clock.now_ns())
    unit.tables.note_running({serial: one.mileages for serial, one in due.items()})
    looked_at = {(serial, at_ns): version for serial, one in due.items() for at_ns, version in one.looked_at.items()}
    unit.due.settle_all(DueStage.SUMS, looked_at)
    earlier = {serial: one.rolled.earlier for serial, one in whole.items() if one.rolled.earlier is not None}
    unit.roll_ups.put_states(being_made | {serial: one.state for serial, one in due.items()}, earlier)
    for serial, one in due.items():
        unit.roll_ups.drop(serial, one.dropped)
        unit.roll_ups.forget(serial, whole[serial].rolled.forgotten())
    unit.roll_ups.put_rolling([fresh for one in whole.values() for fresh in one.rolled.radius.fresh.values()])
    unit.roll_ups.keep_rolling(
        {serial: [at for part in one.parts for _, at in part.roll_up.chosen] for serial, one in due.items()}
    )
    return {}


GEOMETRY = Stage(
    name=GEOMETRIES.stage,
    job="refresh_geometry",
    kind=GEOMETRIES.subject,
    facets=(Facet.REGISTRY, Facet.TABLES, Facet.RESTARTS, TREND.head_facet),
    settings=lambda settings: settings.estimation,
    load=load,
    compute=compute,
    store=store,
    counted=Counted(looked="wheelsets", changed="geometries"),
    results=GEOMETRIES,
)
JOB = Job(GEOMETRY.job, "Merge bin tables into wheelset geometries", every_s=900.0, run=partial(run, GEOMETRY))

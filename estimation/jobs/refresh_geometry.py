"""Stage: geometries of a wheelset, one per mileage interval, and a current one in which older tables weigh less.

A bin table is added once to the roll-up of its interval, so that a new window costs itself, however much came before.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from estimation.bogie.parameters import BOGIE
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
from estimation.jobs.steps.bogie_geometry import bogie_of, stated_of
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
    radius: RadiusOnFile = field(init=False)  # what the geometries tell of the radius on file
    # digest and sum of the earlier intervals, set only if this run computed them
    earlier: tuple[str, BinTable] | None = None
    _passed_over: PassedOverWindows = field(init=False)
    _refused: Sequence[WindowRecord] | None = None
    kept_sums: dict[RollUpKey, tuple[BinTable, BinTable]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.radius = RadiusOnFile(self.unit, self.rules.wheelset)
        self._passed_over = PassedOverWindows(self.unit, self.rules)

    def sums(self, part: Part) -> tuple[BinTable, BinTable]:
        """Return the sums of a roll-up; those of some that have changed are kept in memory."""
        both_sums = self.kept_sums.get(part.roll_up.key) or sums(self.unit, self.rules.wheelset, part)
        if part.added:
            if len(self.kept_sums) >= WORK.roll_ups_in_memory:
                self.kept_sums.pop(next(iter(self.kept_sums)))
            self.kept_sums[part.roll_up.key] = both_sums
        return both_sums

    def records(self) -> list[GeometryRecord]:
        """Return the geometries whose inputs differ from the stored ones; the current one comes last.

        A geometry whose windows are all gone (refused since, or of another baseline now) is followed by an empty one.
        Data from before and after an identity change, or of different vehicle classes, are never merged. The current
        geometry uses the last vehicle class; an interval uses that of most of its windows. A geometry whose class has
        changed and whose windows are gone cannot be made again: it stays as it is, without numbers where its inputs
        were corrected.
        """
        usable = self._usable()
        places = {part.place for part in usable}
        unusable = [part for part in self.rolled.parts if part.roll_up.windows and part.place not in places]
        unusable_places = {part.place for part in unusable if self.rules.of_its_baseline(part.roll_up)}
        records = [*self._intervals(usable, {part.place for part in unusable}), *self._contradicted(unusable)]
        newest = max((baseline for baseline, _ in places), default=None)
        if unusable_places and (newest is None or newest < max(unusable_places)[0]):
            return records
        records += self._ended(newest)
        return records if newest is None else [*records, self._current(self._parts_of_current(newest, usable))]

    def current_parts(self) -> list[Part]:
        """Return the roll-ups of the current geometry, by interval; none where there are no windows."""
        usable = self._usable()
        return self._parts_of_current(max(part.roll_up.key.baseline for part in usable), usable) if usable else []

    def _usable(self) -> list[Part]:
        """Return the roll-ups that have windows and whose class is still the same."""
        filled = (part for part in self.rolled.parts if part.roll_up.windows)
        return [part for part in filled if self.rules.assumed(part.roll_up) is not None]

    def _intervals(self, usable: Sequence[Part], kept_places: set[Place]) -> list[GeometryRecord]:
        """Return the geometries per mileage interval that differ from the stored ones."""
        stored = self.unit.geometries.interval_digests(self.rules.wheelset)
        parts, changed = by_interval(usable), []
        for place, part in parts.items():
            digest = self._digest([part.roll_up], self._assumed(part), self._refused_mostly([part.roll_up]))
            if place not in stored or stored[place].input_digest != digest:
                changed.append(self._record([part], place, digest))
        without_windows = [p for p in stored if p not in parts and p not in kept_places and stored[p].windows]
        intervals = self.unit.geometries.intervals(self.rules.wheelset) if without_windows else ()
        return changed + [self._emptied(old) for old in intervals if (old.baseline, old.interval) in without_windows]

    def forgotten(self) -> list[int]:
        """Return the numbers of the sealed roll-ups that no longer weigh anything in the current geometry."""
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
        """Return geometries without numbers for those that are wrong by now and cannot be made again."""
        wrong = {part.place: part for part in parts if self._passed_over.contradicted(part.roll_up)}
        if not wrong:
            return []
        records = []
        for stored in self.unit.geometries.intervals(self.rules.wheelset):
            part = None if stored.interval is None else wrong.get((stored.baseline, stored.interval))
            if part is not None and stored.geometry.reason != CONTRADICTED:
                record = replace(stored, geometry=stored.geometry.mismatched(CONTRADICTED))
                records.append(self._stamped(record, self._digest([part.roll_up], None, CONTRADICTED)))
        return records

    def _stamped(self, record: GeometryRecord, digest: str) -> GeometryRecord:
        clock, version = self.context.clock, self.context.code_version
        return replace(record, input_digest=digest, code_version=version, recorded_ns=clock.now_ns())

    def _ended(self, newest: int | None) -> list[GeometryRecord]:
        """Return empty geometries that end those of baselines which have no window, or no longer exist.

        A voided reprofiling leaves fewer baselines than have been estimated.
        """
        records = self.unit.geometries.baselines(self.rules.wheelset)
        ended = [old for old in records if old.geometry.windows and (newest is None or old.baseline > newest)]
        return [self._emptied(record) for record in ended]

    def _current(self, used: Sequence[Part]) -> GeometryRecord:
        roll_ups = [part.roll_up for part in used]
        baseline = roll_ups[0].key.baseline
        digest = self._digest(roll_ups, self._assumed(used[-1]), self._refused_mostly(roll_ups))
        record = self._record(used, (baseline, None), digest)
        left_out = self.unit.plausibility.left_out(self.rules.wheelset, self.rules.baselines[baseline].from_ns)
        counted: dict[str, JsonValue] = {code.value: count for code, count in left_out.items()}
        return replace(record, parameters={**record.parameters, LEFT_OUT: counted})

    def _parts_of_current(self, baseline: int, usable: Sequence[Part]) -> list[Part]:
        """Return the parts of the current geometry, by interval: of the newest side and class, with a weight."""
        of_baseline = [part for part in usable if part.roll_up.key.baseline == baseline]
        consistent = [part for part in of_baseline if not self._passed_over.contradicted(part.roll_up)] or of_baseline
        newest_side = [part for part in consistent if part.roll_up.key.side is Side.AFTER] or consistent
        last = max(newest_side, key=lambda part: part.roll_up.last_ns).roll_up
        longest = JOBS.remembered_half_lives * self.rules.half_life_km
        with_weight = [part for part in newest_side if last.last_km - self.rules.end_km(part.roll_up.key) <= longest]
        class_key = (last.key.table_key, last.key.vehicle_class)
        of_class = (p for p in with_weight if (p.roll_up.key.table_key, p.roll_up.key.vehicle_class) == class_key)
        return sorted(of_class, key=lambda part: part.roll_up.key)

    def _assumed(self, part: Part) -> Assumed:
        assumed = self.rules.assumed(part.roll_up)
        assert assumed is not None  # ``_usable`` leaves the others out
        return assumed

    def _refused_mostly(self, roll_ups: Sequence[RollUp]) -> Reason | None:
        """Return why most windows of the time of some roll-ups were refused; None if fewer were."""
        if self._refused is None:
            self._refused = self.unit.windows.refused(self.rules.wheelset, CONTRADICTIONS)
        return contradiction(
            self._refused,
            {vehicle for roll_up in roll_ups for vehicle in roll_up.vehicles},
            min(roll_up.first_ns for roll_up in roll_ups),
            max(roll_up.last_ns for roll_up in roll_ups),
            sum(roll_up.windows for roll_up in roll_ups),
        )

    def _digest(self, roll_ups: Sequence[RollUp], assumed: Assumed | None, against: Reason | None) -> str:
        extra_inputs = "" if assumed is None else f" {assumed.digest}"
        extra_inputs += "" if against is None else f" {against.code}"
        counts = self._passed_over.counts(roll_ups)
        extra_inputs += f" {json.dumps(counts)}" if counts else ""
        digest = hashlib.sha256(f"{self.context.code_version}{extra_inputs}\n".encode())
        for roll_up in roll_ups:
            key = f"{roll_up.key.interval} {int(roll_up.key.side)}"
            digest.update(f"{key} {roll_up.windows} {roll_up.content}\n".encode())
        return digest.hexdigest()

    def _record(self, parts: Sequence[Part], place: tuple[int, int | None], digest: str) -> GeometryRecord:
        roll_ups, used = [part.roll_up for part in parts], self.estimated_with(parts)
        current, last = place[1] is None, max(roll_ups, key=lambda roll_up: roll_up.last_ns)
        table = self.forgetting_sum(parts) if current else self.sums(parts[0])[0]
        bogie = bogie_of(self.unit, self.rules, parts, used.assumed)
        geometry, contradiction = used.estimated(table, bogie), None
        if geometry.status is not Status.MODEL_MISMATCH:
            contradiction = self.contradiction(parts, place)
        counts = self._passed_over.counts(roll_ups)  # of windows that would be estimated differently today
        passed_over: dict[str, JsonValue] = {PASSED_OVER: dict(counts)} if counts else {}
        return GeometryRecord(
            wheelset=self.rules.wheelset,
            baseline=place[0],
            interval=place[1],
            mileage_km=mean_km(self.rules, roll_ups) if current else roll_ups[0].mean_km,
            from_ns=min(roll_up.first_ns for roll_up in roll_ups),
            to_ns=last.end_ns,
            geometry=geometry.against(contradiction),
            input_digest=digest,
            track_versions=versions_of(roll_ups),
            parameters={**used.as_json(), **stated_of(bogie), **passed_over, **stated(contradiction)},
            code_version=self.context.code_version,
            recorded_ns=self.context.clock.now_ns(),
        )

    def estimated_with(self, parts: Sequence[Part]) -> EstimatedWith:
        """Return the inputs of a geometry of some roll-ups; the class is that of the last one."""
        versions, settings = versions_of([part.roll_up for part in parts]), self.context.settings.estimation
        return EstimatedWith.of(self.unit, settings, self._assumed(parts[-1]), self.rules.wheelset, versions)

    def contradiction(self, parts: Sequence[Part], place: tuple[int, int | None]) -> Contradiction | None:
        """Return what contradicts a geometry besides its own samples; an interval of None is the current one."""
        roll_ups = [part.roll_up for part in parts]
        corrected = any(self._passed_over.contradicted(roll_up) for roll_up in roll_ups)
        against = CONTRADICTED if corrected else self._refused_mostly(roll_ups)
        if against is not None:
            return Contradiction(against, certain=True, relative=0.0)
        return self.radius.contradicted(
            windows_of_newest(roll_ups),
            self._assumed(parts[-1]),
            lambda: remembered(former(self.unit, self.rules.wheelset, *place)),
        )

    def forgetting_sum(self, parts: Sequence[Part]) -> BinTable:
        """Return the sum of roll-ups, by interval, with forgetting; the newest window has weight 1."""
        newest_km = max((part.roll_up for part in parts), key=lambda roll_up: roll_up.last_ns).last_km
        *before, last = parts
        tables = [(self.rules.weight(last.roll_up.key, newest_km), self.sums(last)[1])]
        if before:
            tables.insert(0, (self.rules.weight(before[-1].roll_up.key, newest_km), self._earlier(before)))
        return weighted_sum(tables)

    def _earlier(self, parts: Sequence[Part]) -> BinTable:
        """Return the sum of the earlier intervals with forgetting, weighted as at the end of the last of them."""
        text = "".join(f"{part.roll_up.key} {part.roll_up.windows} {part.roll_up.content}\n" for part in parts)
        digest = hashlib.sha256(f"{self.rules.digest}\n{text}".encode()).hexdigest()
        earlier_sum = self.unit.roll_ups.earlier(self.rules.wheelset, digest)
        if earlier_sum is None:
            end_km = self.rules.end_km(parts[-1].roll_up.key)
            tables = ((self.rules.weight(part.roll_up.key, end_km), self.sums(part)[1]) for part in parts)
            earlier_sum = weighted_sum(tables)
            self.earlier = digest, earlier_sum
        return earlier_sum

    def _emptied(self, record: GeometryRecord) -> GeometryRecord:
        """Return the empty geometry that follows ``record`` when none of its windows is left."""
        settings = self.context.settings.estimation
        geometry = no_geometry(settings, record.geometry.parameter_key)
        empty = replace(record, geometry=geometry, track_versions={}, parameters=settings.as_json())
        return self._stamped(empty, self._digest([], None, None))


@dataclass(frozen=True, slots=True)
class GeometryInputs:
    """Inputs of the geometries of a wheelset, and the geometries, which are made while the inputs are read.

    The sums of bin tables are megabytes: each is turned into a geometry when it is read, and only these are kept.
    """

    rules: str
    contents: tuple[tuple[str, str], ...]  # of the roll-ups, as they will be stored
    looked_at: Mapping[int, int]  # due windows, with the versions that were read
    made_from: tuple[str, ...]  # digests of the changed geometries
    # whether all changed roll-ups are in ``parts``; else the rest, and the geometries, follow in later runs
    whole: bool
    records: tuple[GeometryRecord, ...] = field(metadata={"made_from": False})
    parts: tuple[RolledPart, ...] = field(metadata={"made_from": False})
    rolled: RolledGeometries = field(metadata={"made_from": False})


def load(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, GeometryInputs]:
    """Return the inputs of the wheelsets that have a bin table or a geometry; others have nothing to estimate from.

    Where many roll-ups have changed, a few are made again in each run; the geometries follow in the last run.
    """
    wheelsets = unit.geometries.estimable(serials)
    of_wheelsets = geometries_of(unit, [serial for serial in serials if serial in wheelsets], context)
    read_sums_ahead(unit, [(serial, geometries.rolled) for serial, geometries in of_wheelsets.items()])
    return {serial: _inputs(geometries) for serial, geometries in of_wheelsets.items()}


def _inputs(geometries: RolledGeometries) -> GeometryInputs:
    roll_ups = geometries.rolled
    changed = [part for part in roll_ups.parts if part.changed] if roll_ups.due else []
    whole = len(changed) <= WORK.roll_ups_in_memory
    records = geometries.records() if whole else []
    to_store = changed if whole else changed[: WORK.roll_ups_in_memory]
    parts = [RolledPart(part.roll_up, part.before, *geometries.sums(part), part.added) for part in to_store]
    geometries.kept_sums.clear()
    return GeometryInputs(
        rules=repr(roll_ups.state),
        contents=tuple((str(part.roll_up.key), part.roll_up.content) for part in roll_ups.parts),
        looked_at=roll_ups.looked_at,
        made_from=tuple(record.input_digest for record in records),
        whole=whole,
        records=tuple(records),
        parts=tuple(parts),
        rolled=geometries,
    )


def geometries_of(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, RolledGeometries]:
    """Return the geometries of wheelsets by serial, to be made from their roll-ups."""
    memberships = [membership(unit, serial, ClassLookup(unit, context.settings.estimation)) for serial in serials]
    read_ahead(unit, memberships)
    return {rules.wheelset: RolledGeometries(unit, rules, rolled(unit, rules), context) for rules in memberships}


def compute(inputs: GeometryInputs) -> Outcome[WheelsetGeometry]:
    """Return the changed geometries."""
    return Outcome([part_of_result(result_of_geometry(record)) for record in inputs.records], more=not inputs.whole)


def store(
    unit: UnitOfWork, context: JobContext, made: Mapping[str, tuple[GeometryInputs, Outcome[WheelsetGeometry]]]
) -> Mapping[str, int]:
    """Store roll-ups with their state and the bins of current geometries, and drop what is no longer needed."""
    inputs = {serial: loaded for serial, (loaded, _) in made.items()}
    whole = {serial: loaded for serial, loaded in inputs.items() if loaded.whole}
    being_made = {serial: _BEING_MADE for serial in inputs if serial not in whole}
    due = {serial: loaded.rolled.rolled for serial, loaded in whole.items() if loaded.rolled.rolled.due}
    unit.geometries.show_bins([key for key, loaded in whole.items() if any(r.interval is None for r in loaded.records)])
    parts = {serial: loaded.parts for serial, loaded in inputs.items() if serial in due or serial in being_made}
    unit.roll_ups.put(parts, context.clock.now_ns())
    unit.tables.note_running({serial: loaded.mileages for serial, loaded in due.items()})
    looked_at = {(key, at_ns): version for key, loaded in due.items() for at_ns, version in loaded.looked_at.items()}
    unit.due.remove_seen(DueStage.SUMS, looked_at)
    earlier = {serial: loaded.rolled.earlier for serial, loaded in whole.items() if loaded.rolled.earlier is not None}
    unit.roll_ups.put_states(being_made | {serial: loaded.state for serial, loaded in due.items()}, earlier)
    for serial, loaded in due.items():
        unit.roll_ups.drop(serial, loaded.dropped)
        unit.roll_ups.forget(serial, whole[serial].rolled.forgotten())
    unit.roll_ups.put_rolling([sums for loaded in whole.values() for sums in loaded.rolled.radius.fresh.values()])
    unit.roll_ups.keep_rolling(
        {serial: [at for part in loaded.parts for _, at in part.roll_up.chosen] for serial, loaded in due.items()}
    )
    return {}


GEOMETRY = Stage(
    name=GEOMETRIES.stage,
    job="refresh_geometry",
    kind=GEOMETRIES.subject,
    facets=(Facet.REGISTRY, Facet.TABLES, Facet.RESTARTS, TREND.head_facet),
    settings=lambda settings: settings.estimation,
    numbers=(BOGIE, JOBS.bogie_windows),
    load=load,
    compute=compute,
    store=store,
    counted=Counted(looked="wheelsets", changed="geometries"),
    results=GEOMETRIES,
)
JOB = Job(GEOMETRY.job, "Merge bin tables into wheelset geometries", every_s=900.0, run=partial(run, GEOMETRY))

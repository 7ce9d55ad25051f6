"""What a stage reads is what it declares: else it would keep a number that is stale, and nothing would say so."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any

import pytest
from one_database import on_sqlite
from wheelset_life import DAY_NS, START_NS, SetClock, geometry_record, register, run_windows, sample_window, wear

from bench.put_values import put_geometry, put_trend
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.jobs.catalogue import ALL_STAGES
from estimation.jobs.job import JobContext
from estimation.jobs.refresh_trends import TREND, trend_of
from estimation.jobs.settings import JobSettings
from estimation.jobs.stage import AnyStage, made_from
from estimation.storage import Storage, UnitOfWork
from estimation.trend.trend import TrendParameters
from estimation.values.alerts import Alert, AlertEventKind, Condition, Severity
from estimation.values.geometry import GEOMETRY
from estimation.values.opinions import CELLS, CREEP, FRICTION
from estimation.values.quantities import with_interval
from estimation.values.registry import Mounting, Reprofiling, VehicleRecord
from estimation.values.runs import EVERYTHING, Facet, Mark, Result
from estimation.values.signatures import ANSWERS, SIGNATURES
from estimation.values.track import TrackSectionRecord
from estimation.values.trend import (
    AFTER,
    BEFORE,
    FLEET_WEAR,
    IDENTITY,
    OWN_WEAR,
    SUSPENSION,
    SuspensionFinding,
    SuspensionShown,
    TrendRecord,
    TrendStep,
)

READS: Mapping[str, str] = {
    "registry.wheelsets_of": Facet.REGISTRY,
    "registry.mountings_of": Facet.REGISTRY,
    "registry.vehicles_of": Facet.REGISTRY,
    "alerts.of_kind": Facet.RESTARTS,
    "geometries.conicities_of": GEOMETRY.stage,
    "geometries.conicities": GEOMETRY.stage,
    "registry.mountings": Facet.REGISTRY,
    "registry.vehicle": Facet.REGISTRY,
    "registry.vehicle_class": Facet.REGISTRY,
    "registry.wheelsets": Facet.REGISTRY,
    "registry.measured_wheelsets": Facet.REGISTRY,
    "registry.measured_profiles_of": Facet.REGISTRY,
    "registry.measured_profiles": Facet.REGISTRY,
    "tracks.sections": Facet.REGISTRY,
    "tracks.report": GEOMETRY.stage,  # that of a version stays as it is; a geometry says of which it is made
    "alerts.wheelsets_of_kind": Facet.RESTARTS,
    "trends.latest": TREND.name,
    "geometries.interval_digests": GEOMETRY.stage,
    "roll_ups.state": GEOMETRY.stage,
    "roll_ups.read_ahead": GEOMETRY.stage,
    "roll_ups.of": GEOMETRY.stage,
    "due.of_wheelset": GEOMETRY.stage,
    "results.trend.head": "trend.head",
    "geometries.baselines": GEOMETRY.stage,
    "geometries.read_ahead": GEOMETRY.stage,
    "geometries.estimable": Facet.TABLES,
    "windows.passed_over": Facet.TABLES,
    "registry.wheelset": Facet.REGISTRY,
    "tables.tabled": GEOMETRY.stage,
    "tables.last_reading": GEOMETRY.stage,
    "tables.read_ahead": GEOMETRY.stage,
    "rails.cells": CELLS,
    "tracks.standings": Facet.LAYOUTS,
    "signatures.vehicles": Facet.LAYOUTS,
    "signatures.known": SIGNATURES,
    "results.answers": ANSWERS.stage,
    "geometries.having": GEOMETRY.stage,
    "dampers.gears": CREEP,
    "adhesion.made_with": FRICTION,
    "due.of_section": CREEP,
    "geometries.interval_numbers": GEOMETRY.stage,
    "geometries.intervals": GEOMETRY.stage,
    "geometries.current_of": GEOMETRY.stage,
    "geometries.read_with": GEOMETRY.stage,
    "geometries.read_intervals": GEOMETRY.stage,
    "registry.vehicles": Facet.REGISTRY,
    "registry.mounted_on": Facet.REGISTRY,
    "registry.newest_measurement_of": Facet.REGISTRY,
    "sensor_changes.newest": Facet.REGISTRY,
    "suspensions.newest": Facet.STIFFNESS,
    "trends.of": TREND.name,
    "alerts.open_of": Facet.ALERTS,
    "windows.in_service": Facet.WINDOWS,
    "windows.hunted": Facet.BESIDE,
    "dampers.of_vehicles": Facet.BESIDE,
    "plausibility.rejected": Facet.BESIDE,
    "results.identity_jump": "identity_jump",
    "results.identity": "identity",
    "results.suspension": Facet.BESIDE,
    "results.own_wear": OWN_WEAR.stage,
    "results.fleet_wear": FLEET_WEAR.stage,
    "tracks.in_force": Facet.ALIGNMENT,
    "windows.any_decided": Facet.PLACES,
    "windows.refused_on": Facet.PLACES,
    "epochs.outdated": Facet.PLACES,
    "tables.parameter_keys": Facet.PLACES,
    "tables.made_with": Facet.PLACES,
}
"""The facet that is raised with what a method reads; a stage calls no other."""

WHEELSETS = ("W1", "W2", "W3")
STAGES = [stage for stage in ALL_STAGES if stage.facets]  # the others go by the windows that are due
BY_NAME = {stage.name: stage for stage in STAGES}


@dataclass
class Recorded:
    """A unit of work, or a store of it, that notes which methods are called."""

    recorded: Any
    name: str = ""
    called: set[str] = field(default_factory=set)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever the store has
        found = getattr(self.recorded, name)
        if self.name == "results":
            return partial(self._of_kind, found, ".head" if name in {"heads", "latest_head"} else "")
        if self.name:
            self.called.add(f"{self.name}.{name}")
            return found
        return Recorded(found, name, self.called)

    def _of_kind(self, found: Any, part: str, kind: Any, *rest: Any) -> Any:  # noqa: ANN401 - the same
        self.called.add(f"results.{kind.stage}{part}")
        return found(kind, *rest)


def context_of(storage: Storage, settings: JobSettings | None = None, code: str = "test") -> JobContext:
    return JobContext(storage, SetClock(START_NS + 200 * DAY_NS), code, settings or JobSettings())


def lived(storage: Storage) -> None:
    register(storage, *WHEELSETS)
    for serial in WHEELSETS:
        wear(storage, serial, 40)
        run_windows(storage, serial, 39.5, 3)
    with storage.write() as unit:
        put_trend(unit, trend_with_step("W1", 20))


def trend_with_step(wheelset: str, day: int) -> TrendRecord:
    """Return a trend with a step at the end of a day: what is beside the wheelset may have caused it."""
    times = (START_NS + day * DAY_NS, START_NS + (day + 1) * DAY_NS)
    step = TrendStep(day, day + 1.0, *times, times[1], with_interval(0.1, 0.01), 0.2, 3e-3, 0.99, 5, 5)
    return TrendRecord(wheelset, 0, replace(trend_of((), 0.4, TrendParameters()), step=step), f"{day}", "test", 1)


def identity_alert(wheelset: str) -> Alert:
    evidence = {BEFORE: START_NS + 20 * DAY_NS, AFTER: START_NS + 21 * DAY_NS}
    kind = (IDENTITY, Severity.WARNING, Condition.ACTIVE)
    return Alert(0, "F", wheelset, *kind, 10, 10, 1, 0.9, evidence, "inspect", None, None)


@on_sqlite
@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_every_read_is_declared(storage: Storage, stage: AnyStage) -> None:
    lived(storage)
    with storage.write() as unit:
        unit.alerts.save(identity_alert("W1"), [AlertEventKind.RAISED], 1)
        a_measurement(unit)
    with storage.read() as unit:
        recorded = Recorded(unit)
        stage.load(recorded, WHEELSETS, context_of(storage))  # type: ignore[arg-type] - it answers as the unit does
    assert recorded.called <= set(READS), "give every method that is read its facet"
    assert {READS[name] for name in recorded.called} <= {*stage.facets, *stage.frozen, stage.name}


def a_geometry(unit: UnitOfWork) -> None:
    put_geometry(unit, geometry_record("W2", 41, 41, 0.27, recorded_ns=2))


def a_reprofiling(unit: Any) -> None:  # noqa: ANN401 - the unit of fleet_db has more than jobs see
    unit.registry.add_reprofiling(Reprofiling("W2", START_NS + 30 * DAY_NS, 30_000.0))


def a_faster_vehicle(unit: Any) -> None:  # noqa: ANN401 - the same
    unit.registry.add_vehicle(VehicleRecord("V1", "F", "metro", 4, 250.0 / 3.6, (0.0, 2.5, 15.0, 17.5)))


def another_vehicle(unit: Any) -> None:  # noqa: ANN401 - the same
    unit.registry.add_vehicle(VehicleRecord("V2", "F", "metro", 4, 250.0 / 3.6, (0.0, 2.5, 15.0, 17.5)))
    unit.registry.add_mounting(Mounting("W2", "V1", 2, START_NS, START_NS + 50 * DAY_NS, 0.0, 0.0))
    unit.registry.add_mounting(Mounting("W2", "V2", 2, START_NS + 50 * DAY_NS, None, 0.0, 0.0))


def an_identity_change(unit: Any) -> None:  # noqa: ANN401 - the same
    unit.alerts.save(identity_alert("W2"), [AlertEventKind.RAISED], 1)


def a_measurement(unit: Any) -> None:  # noqa: ANN401 - the same
    unit.tracks.add_section(TrackSectionRecord("S", 1, "", "60E1", 0.05, 1.435, 2000.0))
    wheel = wheel_profile("P8")
    unit.registry.add_measured_profiles(MeasuredProfiles("W2", START_NS + 21 * DAY_NS, 21_000.0, wheel, wheel, 2e-4))


CHANGES: tuple[Callable[[Any], None], ...] = (
    a_geometry,
    a_reprofiling,
    a_faster_vehicle,
    another_vehicle,
    an_identity_change,
    a_measurement,
)
OF_TREND = {change.__name__ for change in CHANGES}


def a_window(unit: Any) -> None:  # noqa: ANN401 - the same
    unit.windows.put(sample_window("W2", START_NS + 41 * DAY_NS), 41_000.0, 1)


def a_step_beside(unit: UnitOfWork) -> None:
    put_trend(unit, trend_with_step("W3", 21))


def a_section(unit: Any) -> None:  # noqa: ANN401 - the same
    unit.tracks.add_section(TrackSectionRecord("S9", 9, "", "60E1", 0.05, 1.435, 5000.0))


def a_stiffness(unit: Any) -> None:  # noqa: ANN401 - the same
    a_section(unit)
    unit.suspensions.put(SuspensionFinding("V1", "S9", START_NS, START_NS + DAY_NS, 1.0, 0.03, 0.34, "v", 1))


def a_suspension(unit: UnitOfWork) -> None:
    shown = SuspensionShown(None, stands=True)
    unit.results.put_all(SUSPENSION, [Result("V1", "another", "test", 1, shown)])


OF_ALERTS = {
    change.__name__: wheelset
    for change, wheelset in ((a_window, "W2"), (a_step_beside, "W1"), (a_section, "W1"), (a_suspension, "W1"))
}
CHANGES += (a_window, a_step_beside, a_section, a_stiffness, a_suspension)


def digests(storage: Storage, stage: AnyStage, context: JobContext) -> dict[str, str]:
    with storage.read() as unit:
        loaded = stage.load(unit, WHEELSETS, context)
    return {subject: made_from(inputs) for subject, inputs in loaded.items()}


@on_sqlite
@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_what_has_other_inputs_is_due(storage: Storage, change: Callable[[Any], None]) -> None:
    """Of every stage, after one change; the same inputs may be due as well, and are not computed again then."""
    lived(storage)
    context = context_of(storage)
    before = {}
    for stage in STAGES:
        before[stage.name] = digests(storage, stage, context)
        seen_all(storage, stage, context)
    with storage.write() as unit:
        change(unit)
    for name, digest_of in before.items():
        after = digests(storage, BY_NAME[name], context)
        changed = {subject for subject, digest in after.items() if digest_of.get(subject) != digest}
        if (name, change) != (GEOMETRY.stage, a_geometry):  # nobody else makes its results
            assert changed <= due(storage, BY_NAME[name], context), name
        if name == "trend":
            assert bool(changed) == (change.__name__ in OF_TREND)
        if name == "alerts" and change.__name__ in OF_ALERTS:
            assert OF_ALERTS[change.__name__] in changed


@on_sqlite
@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_settings_that_are_read_make_all_due(storage: Storage, stage: AnyStage) -> None:
    lived(storage)
    context, shipped = context_of(storage), JobSettings()
    before, everybody = digests(storage, stage, context), {EVERYTHING} if stage.together else set(WHEELSETS)
    with storage.write() as unit:
        for subject, facet in product(WHEELSETS, stage.facets):
            unit.subjects.raised(stage.kind, subject, facet)  # type: ignore[attr-defined] - of fleet_db
    seen_all(storage, stage, context)
    others = (
        replace(shipped, trend=replace(shipped.trend, horizon_km=99_000.0)),
        replace(shipped, rules=RuleBook().with_rules(ConicityLimitRule(bands=(SpeedBand(0.3),)))),
    )
    for settings in others:
        other = context_of(storage, settings)
        if digests(storage, stage, other) != before:
            assert due(storage, stage, other) == everybody
    due_of_others = due(storage, stage, context_of(storage, code="another")) - {""}  # what is on no section
    assert due_of_others == (set() if stage.inline else everybody)


def seen_all(storage: Storage, stage: AnyStage, context: JobContext) -> None:
    inputs = stage.inputs(context)
    with storage.write() as unit:
        known = unit.marks.due(inputs, context.clock.now_ns())
        unit.marks.note(inputs, {subject: Mark(state.seen, "") for subject, state in known.items()})


def due(storage: Storage, stage: AnyStage, context: JobContext) -> set[str]:
    with storage.read() as unit:
        return set(unit.marks.due(stage.inputs(context), context.clock.now_ns()))

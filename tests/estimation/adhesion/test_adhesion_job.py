"""A fleet on rails of changing friction through the product: forces, friction, alert, REST, and the second run."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import httpx
import numpy as np
import pytest
from adhesion_fleet import EstimatedFleet

from api.comparison.trial import copied, opened, run_jobs
from api.serving import create_app
from api.settings import Settings
from api.times import to_rfc3339
from bench.adhesion_fleet import true_friction
from estimation.adhesion.creep_forces import FileErrors, FrictionParameters
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.running_gear import LowAdhesionRule
from estimation.jobs import refresh_adhesion
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.rules_replay import section_replayed
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.jobs.steps.load_window import inputs_of_batch
from estimation.jobs.steps.window_creep import friction_parameters, pool_ends
from estimation.values.alerts import AlertEventKind, AlertScope
from estimation.values.opinions import SectionAdhesion
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.runs import JobTrigger
from estimation.values.windows import WindowState
from fleet_db.storage import SqlStorage
from ingest.simulator.campaign import scenario_track
from ingest.simulator.scenario import Scenario


@dataclass(frozen=True, slots=True)
class Deployed:
    """A store after one run of all jobs."""

    scenario: Scenario
    settings: Settings
    storage: SqlStorage
    context: JobContext


@pytest.fixture(scope="module")
def deployed(estimated_fleet: EstimatedFleet, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployed]:
    settings = copied(estimated_fleet.settings, tmp_path_factory.mktemp("deployed"))
    with opened(settings) as (storage, context):
        run_jobs(context, ALL_JOBS)
        yield Deployed(estimated_fleet.scenario, settings, storage, context)


def section_of(deployed: Deployed) -> SectionAdhesion:
    with deployed.storage.read() as unit:
        found = unit.adhesion.section(deployed.scenario.section.code)
    assert found is not None
    return found


def test_low_friction_is_found_where_it_is(deployed: Deployed) -> None:
    track, limit = scenario_track(deployed.scenario), FrictionParameters().low
    found = section_of(deployed)
    assert found.low_stretches
    for begin, end in found.low_stretches:
        friction = true_friction(deployed.scenario, track, 0, np.arange(begin, end))
        assert friction.min() < 1.2 * limit
    for cell in found.cells:
        if cell.friction.low is not None and cell.friction.high is not None:
            true = true_friction(deployed.scenario, track, 0, np.array([0.5 * (cell.from_m + cell.to_m)]))[0]
            assert 0.7 * cell.friction.low < true < 1.4 * cell.friction.high


def test_the_alert_is_in_the_feed_after_one_run(deployed: Deployed) -> None:
    with deployed.storage.read() as unit:
        events = [event for event in unit.alerts.feed(0, 100) if event.alert.kind == "low_adhesion"]
    assert [event.kind for event in events] == [AlertEventKind.RAISED]
    alert = events[0].alert
    assert (alert.scope, alert.track_section) == (AlertScope.TRACK_SECTION, deployed.scenario.section.code)
    assert alert.wheelset is None
    assert alert.fleet == deployed.scenario.fleet_code


def test_every_window_has_forces_and_none_waits(deployed: Deployed) -> None:
    with deployed.storage.read() as unit:
        windows = [record for one in unit.registry.wheelsets() for record in unit.windows.list(one.serial)]
        for record in windows:
            if record.reason is not None:  # it had no geometry to be compared with
                continue
            (found,) = unit.adhesion.of_wheelset(record.wheelset, record.start_ns - 1, 1)
            assert found.status is Status.ESTIMATED
            assert found.yaw_creep.value is not None
            assert 300.0 < found.yaw_creep.value < 8000.0
            assert found.sums is not None
    assert not [record for record in windows if record.state is WindowState.PENDING]


def asked(settings: Settings, paths: tuple[str, ...]) -> list[Any]:
    app = create_app(settings)

    async def get() -> list[httpx.Response]:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://treadwatch") as client:
            return [await client.get(path) for path in paths]

    return asyncio.run(get())


def test_rest_answers_friction_and_the_alert_links_to_it(deployed: Deployed) -> None:
    code = deployed.scenario.section.code
    own = f"/v1/track-sections/{code}/adhesion"
    paths = (
        own,
        "/v1/alerts?scope=track_section",
        "/v1/alerts?scope=fleet&kind=low_adhesion",
        "/v1/track-sections/nowhere/adhesion",
        f"{own}?at=2001-01-01T00:00:00Z",
    )
    (answer, listed, of_fleet, missing, before) = asked(deployed.settings, paths)
    alerts, fleet = listed.json()["items"], of_fleet.json()["items"]
    answer = answer.json()
    found = section_of(deployed)
    assert [(one["from_m"], one["to_m"]) for one in answer["low_stretches"]] == list(found.low_stretches)
    assert len(answer["places"]) == len(found.cells)
    assert alerts[0]["links"]["adhesion"] == f"/v1/track-sections/{code}/adhesion"
    assert alerts[0]["evidence"]["kind"] == "low_adhesion"
    assert alerts[0]["evidence"]["stretches"] == answer["low_stretches"]
    assert fleet == []
    assert (missing.status_code, before.status_code) == (404, 404)


def test_dampers_are_judged_where_windows_are_read(deployed: Deployed) -> None:
    """The windows are too few for a share; what each says is stored, and REST says why there is no more."""
    with deployed.storage.read() as unit:
        plan = next(one for one in deployed.scenario.vehicles if unit.dampers.of_vehicles([one.code]))
        vehicle, found = plan.code, unit.dampers.of_vehicles([plan.code])
        said = {one.first_axle: unit.dampers.newest(vehicle, one.first_axle, 100) for one in found}
    assert [one.first_axle for one in found] == [1, 3]
    for one in found:
        assert one.windows + one.diverged + one.refused == len(said[one.first_axle])
        assert one.share.reason is not None
        assert one.share.reason.code is ReasonCode.TOO_FEW_WINDOWS
        assert one.windows > 0
        assert {window.wheelset for window in said[one.first_axle]} == {plan.wheelsets[one.first_axle - 1].serial}
    answer, missing = asked(deployed.settings, (f"/v1/vehicles/{vehicle}/dampers", "/v1/vehicles/none/dampers"))
    first = answer.json()["dampers"][0]
    assert (first["first_axle"], first["weak"], first["weak_probability_1"]) == (1, None, None)
    assert first["damping_share_1"]["value"] is None
    assert first["damping_share_1"]["reason_code"] == "too_few_windows"
    assert missing.status_code == 404


def test_as_few_spans_as_hold_all_times_are_pooled() -> None:
    assert pool_ends([1, 5, 9, 30, 31], 8) == [9, 31]
    assert pool_ends([1, 5, 10, 30, 31], 8) == [1, 10, 31]
    assert pool_ends([], 8) == []


def everything(deployed: Deployed) -> dict[str, object]:
    """Return what is published of the fleet: windows, geometries, friction and alerts."""
    with deployed.storage.read() as unit:
        serials = [one.serial for one in unit.registry.wheelsets()]
        found: dict[str, object] = {"events": unit.alerts.feed(0, 1000), "section": section_of(deployed)}
        for serial in serials:
            current = unit.geometries.current(serial)
            found[serial] = (
                None if current is None else (current.input_digest, current.recorded_ns, current.geometry.conicity),
                [(record.key, record.state, record.reason) for record in unit.windows.list(serial)],
                unit.adhesion.of_wheelset(serial, None, 1000) != [],
            )
    return found


def test_one_run_leaves_certainly_low_friction_out_and_a_second_one_changes_nothing(deployed: Deployed) -> None:
    found, before = section_of(deployed), everything(deployed)
    assert found.certain_stretches
    for begin, end in found.certain_stretches:
        assert any(first <= begin and end <= behind for first, behind in found.low_stretches)
    with deployed.storage.read() as unit:
        windows = [record for one in unit.registry.wheelsets() for record in unit.windows.list(one.serial)]
        for one in windows:
            read = inputs_of_batch(unit, [one], ClassLookup(unit, deployed.context.settings.estimation)).found[one.key]
            assert read.low_adhesion == found.certain_stretches
    refused = {record.reason.code for record in windows if record.reason is not None}
    assert refused <= {ReasonCode.LOW_ADHESION, ReasonCode.TOO_FEW_SAMPLES}
    run_jobs(deployed.context, ALL_JOBS)
    assert everything(deployed) == before
    run = run_job(refresh_adhesion.JOB, deployed.context, JobTrigger.CLI)
    assert (run.error, run.counts["windows"], run.counts["sections"]) == (None, 0, 0)


def test_friction_follows_another_rule(deployed: Deployed) -> None:
    """Also where no window is new: it is found with the limits of the rule."""
    other = RuleBook().with_rules(LowAdhesionRule(raise_friction=0.05))
    strict = replace(deployed.context, settings=replace(deployed.context.settings, rules=other))
    before = section_of(deployed)
    assert run_job(refresh_adhesion.JOB, strict, JobTrigger.CLI).counts["sections"] >= 1
    assert section_of(deployed).low_stretches != before.low_stretches
    assert run_job(refresh_adhesion.JOB, strict, JobTrigger.CLI).counts["sections"] == 0
    assert run_job(refresh_adhesion.JOB, deployed.context, JobTrigger.CLI).counts["sections"] >= 1
    assert section_of(deployed) == before


def test_every_time_stays_in_some_hours_and_few_are_kept(deployed: Deployed) -> None:
    found = section_of(deployed)
    with deployed.storage.write() as unit:
        for minute in range(1, 40):
            later = replace(found, from_ns=found.to_ns + (minute - 10) * 60, to_ns=found.to_ns + minute * 60)
            unit.adhesion.put_section(later, "test", "d" * 64)
        first, last = found.from_ns, found.to_ns + 39 * 60
        for at_ns in range(found.to_ns, last, 30):
            one = unit.adhesion.section(found.track_section, at_ns)
            assert one is not None
            assert one.from_ns <= at_ns <= one.to_ns
        assert len(unit.adhesion.during(found.track_section, first, last)) < 12
        newest = unit.adhesion.section(found.track_section)
    assert newest is not None
    assert newest.to_ns == last


def test_replay_gives_the_alert_on_file_and_other_rules_give_theirs(deployed: Deployed) -> None:
    code, span = deployed.scenario.section.code, (0, 2**62)
    strict = RuleBook((LowAdhesionRule(raise_friction=0.02),))
    off = RuleBook((LowAdhesionRule(enabled=False),))
    with deployed.storage.read() as unit:
        (alert,) = unit.alerts.open_of_section(code, "low_adhesion")
        (again,) = section_replayed(unit, code, RuleBook(), span)
        assert section_replayed(unit, code, strict, span) == []
        assert section_replayed(unit, code, off, span) == []
        assert section_replayed(unit, code, RuleBook(), (0, 1)) == []
    assert (again.kind, again.fleet, again.track_section) == (alert.kind, alert.fleet, alert.track_section)
    assert again.evidence["stretches"] == alert.evidence["stretches"]


def test_sums_are_forgotten_and_forces_stay(deployed: Deployed) -> None:
    section = deployed.scenario.section.code
    with deployed.storage.write() as unit:
        passes = unit.adhesion.of_section(section, 0, 2**62)
        first = min(one.start_ns for one in passes)
        assert unit.adhesion.forget_sums(section, first) == 0
        assert unit.adhesion.forget_sums(section, first + 1) == sum(one.start_ns == first for one in passes)
        after = unit.adhesion.of_section(section, 0, 2**62)
    assert [one.yaw_creep for one in after] == [one.yaw_creep for one in passes]
    assert {one.start_ns for one in after if one.sums is None} == {first}


def test_creep_forces_of_a_wheelset_are_listed_window_by_window(deployed: Deployed) -> None:
    with deployed.storage.read() as unit:
        serial = unit.registry.wheelsets()[0].serial
        stored = unit.adhesion.of_wheelset(serial, None, 100)
    assert len(stored) > 1
    path = f"/v1/wheelsets/{serial}/creep-forces"
    paths = (f"{path}?limit=1", f"{path}?limit=100", f"{path}?from=2099-01-01T00:00:00Z")
    first, after, none = (one.json() for one in asked(deployed.settings, paths))
    assert [one["measured_from"] for one in after["items"]] == [to_rfc3339(one.start_ns) for one in stored]
    assert first["items"] == after["items"][:1]
    assert first["next_cursor"] is not None
    assert none["items"] == []
    for item, one in zip(after["items"], stored, strict=True):
        assert item["contact_force_n"]["value"] == one.contact_force.value
        assert item["yaw_creep_moment_n_m"]["value"] == one.yaw_creep.value
        assert 0.0 < item["used_adhesion_1"]["value"] < 0.6


def test_the_stds_of_the_class_on_file_are_those_of_the_friction(deployed: Deployed) -> None:
    with deployed.storage.read() as unit:
        passes = unit.adhesion.of_section(deployed.scenario.section.code, 0, 2**62)
        rule = replace(LowAdhesionRule(), raise_friction=0.2, raise_probability=0.7)
        found = friction_parameters(rule, unit, passes)
        on_file = unit.registry.vehicle_class(unit.registry.vehicle(passes[0].vehicle).vehicle_class)
    assert on_file is not None
    assert found.file == FileErrors.of([on_file.vehicle_class])
    assert (found.low, found.likely) == (0.2, 0.7)

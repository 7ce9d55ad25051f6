"""Wheelsets of a bogie whose class does not describe it, from windows to REST: no number, no alert, and why."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest
from alignment_job import LENGTH, surveyed
from bogie_run import SOFT, WHEELBASE, of_bogie, windows
from smooth_wheelset import SmoothTable

from api.comparison.trial import geometry_by
from api.serving import create_app
from api.settings import Settings
from bench.put_values import put_geometry
from bench.standing_clock import StandingClock
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand
from estimation.contact.conicity import equivalent_conicity
from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import EstimationSettings, JobSettings
from estimation.jobs.steps.assumptions import Assumed, ClassLookup
from estimation.jobs.steps.estimated_geometry import RadiusOnFile, former, remembered, stated
from estimation.storage import Storage
from estimation.values.geometry import Contradiction
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import JobTrigger
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import WindowState
from fleet_db.storage import SqlStorage

LOW_LIMIT = RuleBook().with_rules(ConicityLimitRule(minimum_windows=1, bands=(SpeedBand(0.02),)))
SOON_NS = 200 * 10**9  # the windows end 80 s before


def register(storage: SqlStorage, yaw_stiffness: float, radius: float = 0.45) -> None:
    """Register a soft bogie by a class of a certain yaw stiffness, and put the windows of both axles."""
    with storage.write() as unit:
        unit.registry.add_vehicle_class(of_bogie(yaw_stiffness), 1)
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "56E1", 0.05, 1.435, LENGTH))
        unit.tracks.add_alignment(surveyed())
        unit.registry.add_vehicle(VehicleRecord("V1", "F", "bogie", 2, 40.0, (1.0, 1.0 + WHEELBASE)))
        for axle in (1, 2):
            unit.registry.add_wheelset(WheelsetRecord(f"W{axle}", "F", "P8", radius, None))
            unit.registry.add_mounting(Mounting(f"W{axle}", "V1", axle, 0, None, 0.0, 0.0))
            for window in windows(SOFT, axle):
                unit.windows.put(replace(window, track_section="S1"), 10.0, 1)


def context_of(storage: Storage) -> JobContext:
    return JobContext(storage, StandingClock(SOON_NS), "test", JobSettings(rules=LOW_LIMIT))


def run_jobs(storage: Storage) -> None:
    for name in ("estimate_windows", "refresh_geometry", "refresh_trends", "evaluate_alerts"):
        done = run_job(job_named(name), context_of(storage), JobTrigger.CLI)
        assert done.outcome == "succeeded", done.error


def served(storage: SqlStorage, path: str) -> Any:  # noqa: ANN401 - JSON
    url = f"sqlite:///{storage.engine.url.database}"
    app = create_app(Settings(data_dir=storage.data_dir, database_url=url, port=0, _env_file=None))

    async def get() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://treadwatch") as client:
            return await client.get(path)

    answer = asyncio.run(get())
    assert answer.status_code == 200, answer.text
    return answer.json()


def numbers(document: object, name: str = "") -> Iterator[float | None]:
    """Yield every value and standard deviation in a document."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield from numbers(value, key)
    elif isinstance(document, list):
        for value in document:
            yield from numbers(value, name)
    elif name in {"value", "std"}:
        assert document is None or isinstance(document, float)
        yield document


def kinds_of_alerts(storage: SqlStorage) -> set[tuple[str, str]]:
    return {(one["wheelset"], one["kind"]) for one in served(storage, "/v1/alerts")["items"]}


def test_a_class_twice_as_stiff_gives_no_number_and_no_alert(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, 2 * SOFT)
    run_jobs(sqlite_storage)
    for serial in ("W1", "W2"):
        geometry = served(sqlite_storage, f"/v1/wheelsets/{serial}/geometry")
        assert (geometry["status"], geometry["reason_code"]) == ("model_mismatch", "yaw_spring_differs")
        assert "of the yaw spring" in geometry["reason"]
        assert geometry["n_windows"] == len(windows(SOFT, 1))
        trend = served(sqlite_storage, f"/v1/wheelsets/{serial}/trend")
        assert trend["points"]["value_1"] == []
        assert (trend["current_1"]["status"], trend["status"]) == ("model_mismatch", "unestimated")
        found = [*numbers(geometry), *numbers(trend)]
        assert len(found) > 100
        assert set(found) == {None}
        rival = geometry_by(sqlite_storage, context_of(sqlite_storage), serial, "cubic")
        assert rival is not None
        assert code_of(rival.reason) is ReasonCode.YAW_SPRING_DIFFERS
        assert rival.equivalent_conicity.value is None
    assert kinds_of_alerts(sqlite_storage) == set()


def test_a_radius_on_file_of_another_wheel_gives_no_number_and_names_both(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, SOFT, radius=0.5)
    run_jobs(sqlite_storage)
    for serial in ("W1", "W2"):
        geometry = served(sqlite_storage, f"/v1/wheelsets/{serial}/geometry")
        assert (geometry["status"], geometry["reason_code"]) == ("model_mismatch", "rolling_radius_differs")
        assert "on file are 500 mm" in geometry["reason"]
        assert set(numbers(geometry)) == {None}
        rival = geometry_by(sqlite_storage, context_of(sqlite_storage), serial, "cubic")
        assert rival is not None
        assert code_of(rival.reason) is ReasonCode.ROLLING_RADIUS_DIFFERS
    assert kinds_of_alerts(sqlite_storage) == set()


def test_windows_that_cannot_speak_of_the_radius_do_not_contradict_it(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, SOFT, radius=0.5)
    with sqlite_storage.read() as unit:
        chosen = [(one.content_digest, one.start_ns) for one in unit.windows.list("W1")]
        lost = [(digest, start_ns + 1) for digest, start_ns in chosen]
        assumed = ClassLookup(unit, EstimationSettings()).assumed("V1", "W1")
        assert isinstance(assumed, Assumed)
        radius = RadiusOnFile(unit, "W1")
        contradiction = radius.contradicted(chosen, assumed)
        assert contradiction is not None
        assert radius.contradicted(chosen[:1], assumed) is None
        assert radius.contradicted(lost, assumed) is None
        # what was found remains when samples are gone
        assert radius.contradicted(lost, assumed, lambda: contradiction) == contradiction
        assert radius.contradicted(lost, assumed, lambda: None) is None


def test_a_doubt_on_the_radius_lives_with_the_geometry(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, SOFT)
    run_jobs(sqlite_storage)
    with sqlite_storage.read() as unit:
        stored = unit.geometries.current("W1")
    assert stored is not None
    doubt = Contradiction(Reason(ReasonCode.ROLLING_RADIUS_DIFFERS, "in doubt"), certain=False, relative=0.07)
    certain = replace(doubt, certain=True)
    doubted = replace(
        stored, geometry=stored.geometry.against(doubt), parameters={**stored.parameters, **stated(doubt)}
    )
    with sqlite_storage.write() as unit:
        put_geometry(unit, replace(doubted, input_digest="0" * 64, recorded_ns=doubted.recorded_ns + 1))
        kept = former(unit, "W1", stored.baseline, None)
        assert remembered(kept) == doubt
        assert kept is not None
        assert remembered(replace(kept, geometry=kept.geometry.mismatched(doubt.reason))) == replace(
            certain, relative=0.0
        )
    assert stated(certain) == stated(None) == {}
    assert remembered(None) is None
    assert remembered(stored) is None


def test_of_the_right_class_the_same_windows_exceed_the_limit(sqlite_storage: SqlStorage) -> None:
    register(sqlite_storage, SOFT)
    run_jobs(sqlite_storage)
    for serial, cone in (("W1", 0.1), ("W2", 0.14)):
        geometry = served(sqlite_storage, f"/v1/wheelsets/{serial}/geometry")
        assert geometry["status"] == "estimated"
        table = SmoothTable(cone)
        x = table.lateral_displacement
        (true,) = equivalent_conicity(table.standard_displacement, table.left(x) - table.right(x), np.array([3e-3]))
        assert sum(one is not None for one in numbers(geometry)) > 50
        assert geometry["equivalent_conicity_at_3_mm_1"]["value"] == pytest.approx(true, abs=0.01)
        rival = geometry_by(sqlite_storage, context_of(sqlite_storage), serial, "cubic")
        assert rival is not None
        assert rival.equivalent_conicity.value == pytest.approx(true, abs=0.01)
    assert kinds_of_alerts(sqlite_storage) == {("W1", "conicity_limit"), ("W2", "conicity_limit")}


def test_where_most_windows_contradict_the_registry_what_is_left_is_held_back_too(sqlite_storage: SqlStorage) -> None:
    """What was published before they were refused is taken back."""
    register(sqlite_storage, SOFT)
    run_jobs(sqlite_storage)
    assert served(sqlite_storage, "/v1/wheelsets/W1/geometry")["status"] == "estimated"
    reason = Reason(ReasonCode.AXLE_DISTANCE, "the axles are elsewhere")
    with sqlite_storage.write() as unit:
        for hour in (1, 2):
            for window in windows(SOFT, 1):
                later = replace(window, track_section="S1", start_ns=window.start_ns + hour * 3600 * 10**9)
                unit.windows.put(later, 10.0, 1)
                unit.windows.mark("W1", later.start_ns, WindowState.REFUSED, reason)
    run_jobs(sqlite_storage)
    geometry = served(sqlite_storage, "/v1/wheelsets/W1/geometry")
    assert (geometry["status"], geometry["reason_code"]) == ("model_mismatch", "axle_distance")
    assert set(numbers(geometry)) == {None}

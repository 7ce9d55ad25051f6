"""A wheelset without an estimate always has an answer: why, by its windows, and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import api_fleet as fleet
import httpx
import numpy as np
import pytest
from running_service import Service, running

from api.factory import open_store
from api.schemas.windows import WindowReasons
from api.settings import Settings
from bench.put_values import put_geometry
from estimation.errors import NotFoundError
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.runs import JobOutcome, JobTrigger, Quarantined, SubjectKind
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord
from estimation.values.windows import WindowPosition, WindowState
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.window_counts import COUNTED, _grouped
from ingest.vehicle_class_schema import shipped_class

SERIAL, OTHER = "W-1", "W-2"
AT = f"/v1/wheelsets/{SERIAL}"
KM4 = TrackSectionRecord("KM4", 4, "by the river", "56E1", 0.05, 1.435, 5000.0)


@pytest.fixture
def service(storage_url: str, tmp_path: Path) -> Iterator[Service]:
    """Yield a service that knows two wheelsets of a vehicle and a section, and has received nothing."""
    settings = Settings(data_dir=tmp_path, database_url=storage_url, port=0, log_level="warning", _env_file=None)
    storage = open_store(settings)
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.registry.add_vehicle_class(replace(shipped_class("coach"), code="regional"), 1)
        unit.registry.add_vehicle(VehicleRecord("V-1", "F", "regional", 4, 44.5, (0.0, 2.5, 17.0, 19.5)))
        unit.tracks.add_section(KM4)
        for axle, serial in enumerate((SERIAL, OTHER), start=1):
            unit.registry.add_wheelset(WheelsetRecord(serial, "F", "P8", 0.46, None))
            unit.registry.add_mounting(Mounting(serial, "V-1", axle, 0, None, 0.0, 0.0))
    with running(settings) as address, httpx.Client(base_url=address, timeout=30.0) as client:
        yield Service(address, client, storage)
    storage.close()


def put(unit: SqlUnitOfWork, count: int, first: int = 0, *, section: str | None = "KM4") -> list[int]:
    """Store windows of the wheelset; return when they start."""
    starts = []
    for index in range(first, first + count):
        window = replace(fleet.window(index, SERIAL), vehicle="V-1", track_section=section)
        unit.windows.put(window, 100.0 + index, fleet.RECORDED)
        starts.append(window.start_ns)
    return starts


def refuse(unit: SqlUnitOfWork, starts: list[int], code: ReasonCode, text: str = "it is so") -> None:
    for start_ns in starts:
        unit.windows.mark(SERIAL, start_ns, WindowState.REFUSED, Reason(code, text))


def align(unit: SqlUnitOfWork, source: AlignmentSource, status: Status = Status.ESTIMATED) -> None:
    deviations, std = 1e-3 * np.array([1.5, -2.0, 0.25, 0.0], np.float64), np.full(4, 0.5e-3)
    passes = np.array([0, 0, 1, 2])
    found = TrackAlignment("KM4", 0, np.arange(4) * 0.5, deviations, std, -deviations, std, passes, status, source)
    recorded_ns = None if source is AlignmentSource.RECORDED else fleet.RECORDED
    unit.tracks.add_alignment(found, recorded_ns=recorded_ns)


def ran(storage: SqlStorage, job: str, error: str | None = None) -> None:
    outcome = JobOutcome.SUCCEEDED if error is None else JobOutcome.FAILED
    with storage.write() as unit:
        run = unit.jobs.start(job, JobTrigger.CLI, fleet.RECORDED)[0]
        unit.jobs.finish(run.run_id, outcome, {}, fleet.RECORDED + fleet.SECOND, error)


def got(service: Service, path: str, **query: str) -> Any:  # noqa: ANN401 - JSON
    return service.client.get(path, params=query or None).raise_for_status().json()


def because(service: Service) -> Any:  # noqa: ANN401 - JSON
    """Return why nothing is estimated, which geometry and trend agree on."""
    geometry, trend = got(service, f"{AT}/geometry"), got(service, f"{AT}/trend")
    for answer in (geometry, trend):
        assert (answer["status"], answer["reason_code"], answer["recorded_at"]) == ("unestimated", "no_geometry", None)
    assert geometry["reason"] == trend["reason"] == geometry["equivalent_conicity_1"]["reason"]
    assert geometry["unestimated_because"] == trend["unestimated_because"]
    return geometry["unestimated_because"] | {"reason": geometry["reason"]}


def reasons(found: dict[str, Any]) -> list[tuple[str, str, int]]:
    return [(one["state"], one["reason_code"], one["windows"]) for one in found["reasons"]]


def test_nothing_received_says_what_is_missing(service: Service) -> None:
    found = because(service)
    assert (found["windows"], found["reasons"], found["last_data_at"], found["counted_from"]) == (0, [], None, None)
    assert found["reason"] == "no recording of V-1 has been received"
    assert found["what_to_do"] == "Check the vehicle and its receiver."
    with service.storage.write() as unit:
        unit.registry.add_wheelset(WheelsetRecord("W-3", "F", "P8", 0.46, None))
    spare = got(service, "/v1/wheelsets/W-3/geometry")
    assert spare["reason"] == "it runs under no vehicle, and no window of it has been received"
    assert service.client.get("/v1/wheelsets/none/geometry").status_code == 404
    assert service.client.get("/v1/wheelsets/none/trend").status_code == 404


def test_a_recording_that_was_rejected_or_holds_nothing_of_the_axle_is_named(service: Service) -> None:
    behind = Reason(ReasonCode.CLOCK_IMPLAUSIBLE, "the clock of the vehicle is 3 h ahead of /srv/raw/ab/one.blf")
    rejected = ChunkRecord("ab" * 32, "V-1", ".blf", 10, ChunkState.REJECTED, behind, None, None, 0, {}, 5, 5)
    with service.storage.write() as unit:
        unit.chunks.put(rejected)
    found = because(service)
    assert (
        found["reason"] == "the newest recording of V-1 is rejected: the clock of the vehicle is 3 h ahead of one.blf"
    )
    assert found["what_to_do"] == ReasonCode.CLOCK_IMPLAUSIBLE.remedy
    decoded = replace(rejected, digest="cd" * 32, state=ChunkState.DECODED, reason=None, received_ns=6)
    with service.storage.write() as unit:
        unit.chunks.put(replace(decoded, first_ns=1, last_ns=2))
    assert "hold no window of axle 1" in because(service)["reason"]


def test_windows_wait_for_an_alignment_which_the_last_look_did_not_find(service: Service) -> None:
    with service.storage.write() as unit:
        put(unit, 4)
    found = because(service)
    assert reasons(found) == [("pending", "alignment_unknown", 4)]
    assert found["reasons"][0]["reason"] == (
        "the alignment of section KM4 is not known yet: refresh_alignment has yet to run"
    )
    few = Reason(ReasonCode.TOO_FEW_PASSES, "no place with 3 passes: 1 at most, 2 to go")
    with service.storage.write() as unit:
        report = replace(fleet.track_report("KM4", None, Status.UNESTIMATED), reason=few)
        said = {"recording": "not used: it is mirrored", "recording_code": "survey_mirrored"}
        unit.tracks.add_report(replace(report, report={**report.report, **said}))
    (one,) = because(service)["reasons"]
    assert one["reason"] == (
        "the alignment of section KM4 is not known yet: no place with 3 passes: 1 at most, 2 to go;"
        " the survey is not used: it is mirrored"
    )
    assert one["what_to_do"].startswith("Survey it, or wait for more passes.")
    assert [window["reason_code"] for window in got(service, f"{AT}/windows")["items"]] == ["alignment_unknown"] * 4
    with service.storage.write() as unit:
        align(unit, AlignmentSource.FLEET, Status.UNESTIMATED)  # as where a survey is refused and nothing replaces it
    assert because(service)["reasons"] == [one]


def test_windows_wait_for_the_job_the_class_and_their_place(service: Service) -> None:
    with service.storage.write() as unit:
        align(unit, AlignmentSource.RECORDED)
        put(unit, 2)
    assert reasons(because(service)) == [("pending", "waits_for_estimation", 2)]
    assert because(service)["reasons"][0]["reason"] == "it waits for estimate_windows, which has never run"
    ran(service.storage, "estimate_windows", "ValueError: no")
    assert because(service)["reasons"][0]["reason"].endswith("failed: ValueError: no")
    ran(service.storage, "estimate_windows")
    assert because(service)["reasons"][0]["reason"] == "it waits for the next run of estimate_windows"
    with service.storage.write() as unit:
        align(unit, AlignmentSource.FLEET)
    assert reasons(because(service)) == [("pending", "waits_for_position", 2)]
    with service.storage.write() as unit:
        window = unit.windows.list(SERIAL)[0]
        unit.tracks.put_positions([WindowPosition(SERIAL, window.start_ns, window.content_digest, 2)])
    assert sorted(reasons(because(service))) == [
        ("pending", code, 1) for code in ("waits_for_estimation", "waits_for_position")
    ]
    listed = [window["reason_code"] for window in got(service, f"{AT}/windows")["items"]]
    assert listed == ["waits_for_estimation", "waits_for_position"]
    with service.storage.write() as unit:
        unit.registry.add_vehicle(VehicleRecord("V-1", "F", "unheard", 4, 44.5, (0.0, 2.5, 17.0, 19.5)))
    assert reasons(because(service)) == [("pending", "class_unknown", 2)]
    assert because(service)["reasons"][0]["reason"] == "class 'unheard' of V-1 is not on file"


def test_refused_windows_are_counted_by_reason_and_the_newest_sentence_is_shown(service: Service) -> None:
    with service.storage.write() as unit:
        starts = put(unit, 10)
        refuse(unit, starts[:6], ReasonCode.POSITION_UNCERTAIN, "old")
        refuse(unit, starts[5:6], ReasonCode.POSITION_UNCERTAIN, "its position along the section is not certain")
        refuse(unit, starts[6:9], ReasonCode.CLIPPED, "12 % of the samples")
        refuse(unit, starts[9:], ReasonCode.SENSOR_FAULT, "self-test")
    found = because(service)
    assert reasons(found) == [
        ("refused", "position_uncertain", 6),
        ("refused", "clipped", 3),
        ("refused", "sensor_fault", 1),
    ]
    assert found["reasons"][0]["reason"] == "its position along the section is not certain"
    assert (found["windows"], found["refused"], found["pending"], found["estimated"]) == (10, 10, 0, 0)
    assert found["reason"].startswith("of the newest 10 windows 6 are refused: its position")
    assert found["what_to_do"].startswith(ReasonCode.POSITION_UNCERTAIN.remedy)
    windows = got(service, f"{AT}/windows")["items"]
    assert (found["counted_from"], found["last_data_at"]) == (windows[0]["measured_from"], windows[-1]["measured_to"])
    state = got(service, f"{AT}/state")["state"]
    assert state["conicity_1"]["reason"] == (
        "windows refused: 6 position uncertain, 3 clipped, 1 other; there is no geometry yet"
    )
    assert [one["text"] for one in state["reasons"]] == [state["conicity_1"]["reason"]]


def test_one_reason_for_all_a_mix_with_waiting_ones_and_the_etag(service: Service) -> None:
    with service.storage.write() as unit:
        refuse(unit, put(unit, 3, section=None), ReasonCode.SECTION_UNKNOWN, "it is on no section")
    answer = service.client.get(f"{AT}/geometry")
    assert reasons(answer.json()["unestimated_because"]) == [("refused", "section_unknown", 3)]
    held = {"If-None-Match": answer.headers["etag"]}
    assert service.client.get(f"{AT}/geometry", headers=held).status_code == 304
    with service.storage.write() as unit:
        align(unit, AlignmentSource.RECORDED)
        put(unit, 5, 3)
    changed = service.client.get(f"{AT}/geometry", headers=held)
    assert changed.status_code == 200, "what waits is never out of date"
    assert reasons(changed.json()["unestimated_because"]) == [
        ("pending", "waits_for_estimation", 5),
        ("refused", "section_unknown", 3),
    ]
    tables = [service.client.get(f"{AT}/{name}", headers={"Accept": "text/csv"}) for name in ("geometry", "trend")]
    assert [len(table.text.splitlines()) for table in tables] == [1, 1], "a head and no rows"


def test_quarantine_says_when_it_is_tried_again(service: Service) -> None:
    failed = Quarantined(
        kind=SubjectKind.WINDOW,
        key="",
        stage="estimate_windows",
        code=ReasonCode.PROCESSING_FAILED,
        error="ValueError: no",
        inputs="1",
        first_ns=fleet.START,
        last_ns=fleet.START,
        due_ns=fleet.START + 240 * fleet.SECOND,
        attempts=2,
    )
    again = "tried again from 2025-06-15T15:10:40Z on (2 failures in a row)"
    with service.storage.write() as unit:
        (start_ns,) = put(unit, 1)
        refuse(unit, [start_ns], ReasonCode.PROCESSING_FAILED, "ValueError: no")
        unit.quarantine.put(replace(failed, key=f"{SERIAL}@{start_ns}"))
    assert because(service)["reasons"][0]["reason"] == f"ValueError: no; {again}"
    assert got(service, f"{AT}/windows")["items"][0]["reason"] == f"ValueError: no; {again}"
    with service.storage.write() as unit:
        align(unit, AlignmentSource.FLEET)
        put(unit, 2, 1)
        unit.quarantine.put(replace(failed, kind=SubjectKind.SECTION, key="KM4", stage="refresh_alignment"))
    (waiting, _) = because(service)["reasons"]
    assert waiting["reason"] == (
        f"its place on section KM4 is not found yet: refresh_alignment failed at it: ValueError: no; {again}"
    )
    with service.storage.write() as unit:
        for window in unit.windows.list(SERIAL):
            unit.windows.mark(*window.key, WindowState.ESTIMATED)
        unit.quarantine.put(replace(failed, kind=SubjectKind.WHEELSET, key=SERIAL, stage="refresh_geometry"))
    (one,) = because(service)["reasons"]
    assert (one["state"], one["reason"]) == ("estimated", f"refresh_geometry failed at it: ValueError: no; {again}")


def test_who_is_bound_to_a_fleet_sees_the_same_and_nothing_of_others(service: Service) -> None:
    with service.storage.write() as unit:
        refuse(unit, put(unit, 3), ReasonCode.CLIPPED)
        put(unit, 2, 3)
    with service.storage.read() as unit:
        seen = WindowReasons(unit).without_estimate(SERIAL)
    with service.storage.seen_by(frozenset({"F"})).read() as unit:
        assert WindowReasons(unit).without_estimate(SERIAL) == seen
        assert WindowReasons(unit).waiting(vehicles=["V-1"]) == [seen.windows[1]]
        assert WindowReasons(unit).without_estimate(OTHER).reason.text.startswith("no recording of V-1")
    with service.storage.seen_by(frozenset({"other"})).read() as unit:
        with pytest.raises(NotFoundError):
            WindowReasons(unit).without_estimate(SERIAL)
        assert WindowReasons(unit).waiting() == []


def test_windows_before_the_last_reprofiling_and_older_ones_are_not_counted(service: Service) -> None:
    with service.storage.write() as unit:
        starts = put(unit, 8)
        refuse(unit, starts, ReasonCode.CLIPPED)
        refuse(unit, starts[:2], ReasonCode.SENSOR_FAULT)
    with service.storage.read() as unit:
        newest = WindowReasons(unit).without_estimate(SERIAL, most=7)
    assert (newest.counted, newest.from_ns, COUNTED) == (7, starts[1], 1000)
    assert [(one.reason and one.reason.code, one.windows) for one in newest.windows] == [
        (ReasonCode.CLIPPED, 6),
        (ReasonCode.SENSOR_FAULT, 1),
    ]
    with service.storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling(SERIAL, starts[5], 100.0))
    found = because(service)
    assert (found["windows"], reasons(found)) == (3, [("refused", "clipped", 3)])
    with service.storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling(SERIAL, starts[-1] + fleet.DAY, 100.0))
    found = because(service)
    assert (found["windows"], found["reason"]) == (0, "no window has been received since the last reprofiling")
    assert found["last_data_at"] is not None


def test_a_geometry_without_a_number_says_what_became_of_the_windows_and_a_mismatch_says_its_own(
    service: Service,
) -> None:
    few = Reason(ReasonCode.TOO_FEW_BLOCKS, "2 blocks of running time, 8 are needed")
    open_ = replace(fleet.geometry(), status=Status.UNESTIMATED, reason=few, windows=1)
    record = replace(fleet.geometry_record(fleet.RECORDED, 0.2), wheelset=SERIAL, baseline=0, geometry=open_)
    with service.storage.write() as unit:
        starts = put(unit, 5)
        refuse(unit, starts[1:], ReasonCode.CLIPPED)
        unit.windows.mark(SERIAL, starts[0], WindowState.ESTIMATED)
        put_geometry(unit, record)
    found = got(service, f"{AT}/geometry")
    assert (found["status"], found["reason"]) == ("unestimated", few.text)
    assert reasons(found["unestimated_because"]) == [("refused", "clipped", 4), ("estimated", "too_few_blocks", 1)]
    then = got(service, found["links"]["as_recorded"])
    assert (then["unestimated_because"], then["reason"]) == (None, few.text)
    contradicted = fleet.geometry().mismatched(Reason(ReasonCode.ROLLING_RADIUS_DIFFERS, "405 mm for 450 mm"))
    with service.storage.write() as unit:
        put_geometry(unit, replace(record, geometry=contradicted, input_digest="e" * 64))
    found = got(service, f"{AT}/geometry")
    assert (found["status"], found["reason"]) == ("model_mismatch", "405 mm for 450 mm")
    assert found["unestimated_because"] is None


def test_only_the_newest_windows_are_read_however_many_there_are(sqlite_storage: SqlStorage) -> None:
    with sqlite_storage.read() as unit:
        text = str(_grouped().compile(unit.connection, compile_kwargs={"literal_binds": False}))
        plan = unit.connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {text}", ("pending", "W", 0, 10, 0)).all()
    steps = [row.detail for row in plan]
    assert any("SEARCH windows USING" in step and "wheelset=? AND start_ns>?" in step for step in steps), steps
    assert not any(step.startswith("SCAN windows") for step in steps)

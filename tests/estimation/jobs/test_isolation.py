"""One window, wheelset, section or fleet at which a job fails harms itself only, and is tried ever more rarely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from alignment_job import LENGTH, surveyed
from paper_class import paper_class
from section_runs import windows
from sqlalchemy import update
from wheelset_life import SetClock

from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.values.reasons import ReasonCode
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import JobTrigger, QuarantineState, SubjectKind, delay_s
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import DueStage, WindowKey, WindowPosition, WindowRecord, WindowState
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.stores.tracks import TrackStore
from fleet_db.stores.windows import WindowStore
from fleet_db.tables.results import ResultRow
from fleet_db.tables.track import TrackAlignmentRow
from fleet_db.tables.windows import WindowBinTableRow, WindowRow

NAMES = ("W0", "W1", "W2")
MINUTE_NS = 60 * 10**9
ALL = (
    "refresh_alignment",
    "estimate_windows",
    "refresh_geometry",
    "refresh_trends",
    "evaluate_alerts",
    "refresh_signatures",
)


@pytest.fixture
def clock() -> SetClock:
    return SetClock(10**15)


@pytest.fixture
def fleet(sqlite_storage: SqlStorage) -> SqlStorage:
    """Return three vehicles of one wheelset with two windows each on a surveyed section."""
    with sqlite_storage.write() as unit:
        unit.registry.add_vehicle_class(paper_class("metro"), 1)
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "56E1", 0.05, 1.435, LENGTH))
        unit.tracks.add_alignment(surveyed())
        for number, name in enumerate(NAMES):
            unit.registry.add_vehicle(VehicleRecord(name, "F", "metro", 1, 40.0, (0.0,)))
            unit.registry.add_wheelset(WheelsetRecord(name, "F", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(name, name, 1, 0, None, 0.0, 0.0))
            for window in windows(number):
                unit.windows.put(replace(window, wheelset=name, vehicle=name, track_section="S1"), 10.0, 1)
    return sqlite_storage


def counts(storage: SqlStorage, clock: SetClock, *jobs: str) -> Mapping[str, int]:
    """Run jobs, all of which succeed; return the counts of the last."""
    clock.at_ns += 1
    context = JobContext(storage, clock, "test", JobSettings())
    runs = [run_job(job_named(name), context, JobTrigger.CLI) for name in jobs]
    assert {run.outcome for run in runs} == {"succeeded"}, runs
    return runs[-1].counts


def of(storage: SqlStorage, name: str) -> list[WindowRecord]:
    with storage.read() as unit:
        return list(unit.windows.list(name))


def test_one_window_that_cannot_be_read_waits_alone_and_is_tried_again(
    fleet: SqlStorage, clock: SetClock, tmp_path: Path
) -> None:
    victim = of(fleet, "W0")[0]
    (path,) = tmp_path.rglob(f"{victim.content_digest}.window")
    whole = path.read_bytes()
    path.unlink()
    path.mkdir()  # the system refuses to read it, for root too
    assert counts(fleet, clock, "refresh_alignment")["quarantined"] == 0  # the section goes on without it
    found = counts(fleet, clock, "estimate_windows")
    assert (found["estimated"], found["refused"], found["quarantined"]) == (5, 0, 1)
    refused = of(fleet, "W0")[0]
    assert refused.reason is not None
    assert (refused.state, refused.reason.code) == (WindowState.REFUSED, ReasonCode.WAITS_FOR_STORAGE)
    with fleet.read() as unit:
        (item,) = unit.quarantine.held("estimate_windows")
    assert (item.kind, item.key, item.attempts) == (SubjectKind.WINDOW, f"W0@{victim.start_ns}", 1)
    assert path.name in item.error
    path.rmdir()
    path.write_bytes(whole)
    found = counts(fleet, clock, "refresh_alignment", "estimate_windows")  # the survey does not wait for positions
    assert (found["estimated"], found["quarantined"]) == (1, 0)
    with fleet.read() as unit:
        assert unit.quarantine.held() == []


def test_a_window_that_fails_is_tried_ever_more_rarely_until_it_is_another_or_gone(
    fleet: SqlStorage, clock: SetClock, tmp_path: Path
) -> None:
    victim = of(fleet, "W0")[0]
    (path,) = tmp_path.rglob(f"{victim.content_digest}.window")
    path.unlink()
    path.mkdir()
    attempts = []
    for minutes in (0, 0, 0, 1, 1, 2):
        clock.at_ns += minutes * MINUTE_NS
        assert counts(fleet, clock, "estimate_windows")["quarantined"] == 1
        assert of(fleet, "W0")[0].state is WindowState.REFUSED
        with fleet.read() as unit:
            attempts += [item.attempts for item in unit.quarantine.held("estimate_windows")]
    assert attempts == [1, 2, 2, 3, 3, 4]
    with fleet.write() as unit:  # other samples: tried at once
        other = replace(windows(1)[0], wheelset="W0", vehicle="W0", track_section="S1", start_ns=victim.start_ns)
        unit.windows.put(other, 10.0, 2)
    found = counts(fleet, clock, "estimate_windows")
    assert (found["estimated"], found["quarantined"]) == (1, 0)
    with fleet.read() as unit:
        assert unit.quarantine.held() == []


def test_a_window_that_failed_and_is_gone_is_forgotten(fleet: SqlStorage, clock: SetClock, tmp_path: Path) -> None:
    victim = of(fleet, "W0")[0]
    (path,) = tmp_path.rglob(f"{victim.content_digest}.window")
    path.unlink()
    path.mkdir()
    counts(fleet, clock, "estimate_windows")
    with fleet.write() as unit:
        unit.assembled.remove([victim])
    assert counts(fleet, clock, "estimate_windows")["quarantined"] == 0
    with fleet.read() as unit:
        assert (unit.quarantine.held(), unit.due.of_wheelset(DueStage.TABLES, "W0")) == ([], {})


def test_a_window_that_is_another_when_it_is_stored_is_estimated_again_in_the_same_run(
    fleet: SqlStorage, clock: SetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim, several, changes = of(fleet, "W1")[0], WindowStore.several, []

    def turned_meanwhile(
        store: WindowStore, keys: Sequence[WindowKey], *, held: bool = False
    ) -> Sequence[WindowRecord]:
        if held and not changes:
            position = WindowPosition(*victim.key, victim.content_digest, 1, 2.5)
            changes.append(TrackStore(store.connection, store.subjects).put_positions([position]))
            store.subjects.places(victim.track_section)  # as whoever stores an epoch with its windows does
        return several(store, keys, held=held)

    monkeypatch.setattr(WindowStore, "several", turned_meanwhile)
    found = counts(fleet, clock, "estimate_windows")
    assert (changes, found["estimated"], found["changed_meanwhile"]) == ([{victim.key: None}], 6, 1)
    with fleet.read() as unit:
        assert unit.due.of_wheelset(DueStage.TABLES, "W1") == {}


def test_a_mileage_that_nothing_can_be_computed_with_leaves_the_other_wheelsets_their_geometry(
    fleet: SqlStorage, clock: SetClock
) -> None:
    counts(fleet, clock, "refresh_alignment", "estimate_windows")
    first = of(fleet, "W1")[0]
    table = table_of(WindowRow)
    with fleet.engine.begin() as connection:
        key = (table.c.wheelset == "W1", table.c.start_ns == first.start_ns)
        connection.execute(update(table).where(*key).values(mileage_km=1e300))
    counts(fleet, clock, *ALL[2:])
    with fleet.read() as unit:
        assert [unit.geometries.current(name) is None for name in ("W0", "W2")] == [False, False]


def test_a_wheelset_that_fails_is_tried_ever_more_rarely_and_at_once_with_other_inputs(
    fleet: SqlStorage, clock: SetClock
) -> None:
    counts(fleet, clock, "refresh_alignment", "estimate_windows")
    table = table_of(WindowBinTableRow)
    with fleet.engine.begin() as connection:
        connection.execute(update(table).where(table.c.wheelset == "W1").values(packed=b"rubbish"))
    assert counts(fleet, clock, "refresh_geometry")["quarantined"] == 1
    with fleet.read() as unit:
        assert [unit.geometries.current(name) is None for name in NAMES] == [False, True, False]
        (item,) = unit.quarantine.held("refresh_geometry")
    assert (item.key, item.code) == ("W1", ReasonCode.FILE_DAMAGED)
    assert counts(fleet, clock, "refresh_geometry")["quarantined"] == 1  # not due: nothing is tried
    with fleet.read() as unit:
        assert unit.quarantine.held() == [item]
    clock.at_ns = item.due_ns
    counts(fleet, clock, "refresh_geometry")
    with fleet.read() as unit:
        (again,) = unit.quarantine.held()
    assert (again.attempts, again.due_ns - again.last_ns) == (2, 4 * MINUTE_NS)
    with fleet.write() as unit:  # made again: its inputs have changed, and it is tried before its time
        for record in unit.windows.list("W1"):
            unit.windows.mark("W1", record.start_ns, WindowState.PENDING)
    assert counts(fleet, clock, "estimate_windows", "refresh_geometry")["quarantined"] == 0
    with fleet.read() as unit:
        assert unit.geometries.current("W1") is not None
        (gone,) = unit.quarantine.all(10)
    assert gone.state is QuarantineState.RESOLVED


@pytest.mark.parametrize("head", [None, "rubbish", '{"conicities":[[1.0]]}', '{"no_conicity":["no code","text"]}'])
def test_a_damaged_geometry_leaves_the_others_their_trends_and_alerts(
    fleet: SqlStorage, clock: SetClock, head: str | None
) -> None:
    counts(fleet, clock, *ALL[:3])
    table = table_of(ResultRow)
    with fleet.engine.begin() as connection:
        connection.execute(update(table).where(table.c.subject == "W1").values(value=b"rubbish", head=head))
    trends = counts(fleet, clock, "refresh_trends")
    assert (trends["wheelsets"], trends["quarantined"]) == (2, 1)
    alerts = counts(fleet, clock, "evaluate_alerts")
    assert alerts["wheelsets"] == 2
    with fleet.read() as unit:
        held = {(item.kind.value, item.key) for item in unit.quarantine.held("evaluate_alerts")}
    assert ("wheelset", "W1") in held
    assert not {("wheelset", "W0"), ("wheelset", "W2")} & held


def test_a_damaged_alignment_leaves_the_other_sections_theirs(fleet: SqlStorage, clock: SetClock) -> None:
    with fleet.write() as unit:
        unit.tracks.add_section(TrackSectionRecord("S0", 2, "Section", "56E1", 0.05, 1.435, LENGTH))
        unit.tracks.add_alignment(replace(surveyed(), section="S0"))
        for window in windows(0, 2):
            unit.windows.put(
                replace(window, wheelset="W0", vehicle="W0", start_ns=window.start_ns + 10**15, track_section="S0"),
                10.0,
                1,
            )
    table = table_of(TrackAlignmentRow)
    with fleet.engine.begin() as connection:
        connection.execute(update(table).where(table.c.section == "S0").values(packed=b"rubbish"))
    found = counts(fleet, clock, "refresh_alignment")
    assert found["quarantined"] == 1
    with fleet.read() as unit:
        (item,) = unit.quarantine.held("refresh_alignment")
        assert unit.tracks.report("S1") is not None
    assert (item.kind, item.key) == (SubjectKind.SECTION, "S0")


@pytest.mark.parametrize(
    ("code", "delays"),
    [
        (ReasonCode.PROCESSING_FAILED, [60, 240, 960, 3840, 15360, 61440, 86400, 86400]),
        (ReasonCode.WAITS_FOR_STORAGE, [0, 60, 120, 240, 480, 960, 1920, 3600, 3600]),
        (ReasonCode.WAITS_FOR_MEMORY, [60, 120, 240, 480, 960, 1920, 3600, 3600]),
    ],
)
def test_what_fails_again_and_again_is_tried_ever_more_rarely(code: ReasonCode, delays: list[int]) -> None:
    assert [delay_s(code, attempts) for attempts in range(1, len(delays) + 1)] == delays

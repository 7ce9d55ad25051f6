"""The alignment job on a real store: epochs become versions, once; windows wait for it no longer than they must."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from alignment_job import DAY_NS, QUIET, counts, in_force, put, register, report, run, surveyed
from sqlalchemy import update

from estimation.jobs.settings import JobSettings
from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.track.settings import AlignmentSettings
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.track import AlignmentSource
from estimation.values.windows import WindowState
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.track import TrackAlignmentRow
from fleet_db.tables.windows import WindowBinTableRow

TABLES = table_of(WindowBinTableRow)


def test_an_epoch_becomes_a_version_once_and_its_windows_are_estimated_on_it(storage: SqlStorage) -> None:
    register(storage)
    put(storage, range(6))
    first = counts(storage, "refresh_alignment")
    assert (first["versions"], first["windows"]) == (1, 12)
    found = in_force(storage)
    assert (found.version, found.source, found.gauge_known) == (1, AlignmentSource.FLEET, False)
    latest = report(storage)
    assert (latest.version, latest.made, latest.status) == (1, True, Status.ESTIMATED)
    assert counts(storage, "estimate_windows")["estimated"] == 12
    with storage.read() as unit:
        assert {one.track_version for one in unit.tables.tabled("W0")} == {1}
    again = counts(storage, "refresh_alignment")
    assert (again["versions"], again["unchanged"]) == (0, 1)
    assert report(storage) == latest
    assert counts(storage, "estimate_windows") == QUIET


def test_the_next_epoch_is_placed_on_the_last_version_and_waits_until_it_is(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage)
    put(storage, range(6))
    counts(storage, "refresh_alignment")
    counts(storage, "estimate_windows")
    first = in_force(storage)
    put(storage, [1, 4, 5], day=3, offset=14.0)
    assert counts(storage, "estimate_windows")["estimated"] == 0  # no epoch has placed them
    assert counts(storage, "refresh_alignment")["windows"] == 6
    with storage.read() as unit:
        positions = [unit.tracks.position("W4", window.start_ns) for window in unit.windows.list("W4", DAY_NS)]
        record = unit.tracks.in_force("S1")
    assert record is not None
    assert (record.version, record.same_since) in {(2, 1), (2, 2)}
    assert report(storage).report["evidence"] == ["fleet version 1"]
    for position in positions:
        assert position is not None
        shift = position.offset_m + position.scale * (1000.0 - position.middle_m)
        assert shift == pytest.approx(-14.0, abs=1.5)
    held = np.isfinite(first.alignment)
    assert np.isfinite(in_force(storage).alignment[held]).all()
    done = counts(storage, "estimate_windows")
    assert done["requeued"] == (0 if record.same_since == 1 else 12)
    assert done["estimated"] == 6 + done["requeued"]


def test_a_geometry_names_every_version_that_its_windows_were_estimated_with(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    alike = AlignmentSettings(
        same_share=1e6, same_stretch=1.0, same_std=0.0, same_coverage=1.0, same_ratio=1.0, same_gauge=1.0
    )
    lenient = JobSettings(alignment=alike)

    register(storage)
    for day, numbers in ((0, range(6)), (3, [1, 4])):
        put(storage, numbers, day=day)
        assert counts(storage, "refresh_alignment", lenient)["versions"] == 1
        counts(storage, "estimate_windows")
    later = update(TABLES).where(TABLES.c.wheelset == "W1", TABLES.c.start_ns >= 3 * DAY_NS)
    with storage.engine.begin() as connection:
        connection.execute(later.values(track_version=2))
    counts(storage, "refresh_geometry")
    with storage.read() as unit:
        current = {name: unit.geometries.current(name) for name in ("W0", "W1")}
    assert {name: one.track_versions for name, one in current.items() if one} == {
        "W0": {"S1": (1,)},
        "W1": {"S1": (1, 2)},
    }


def test_what_one_wheelset_cannot_determine_is_estimated_together_with_those_that_come_later(
    sqlite_storage: SqlStorage,
) -> None:
    storage = sqlite_storage
    register(storage)
    put(storage, [0])
    assert counts(storage, "refresh_alignment")["unestimated"] == 1
    latest = report(storage)
    assert (latest.version, latest.status) == (None, Status.UNESTIMATED)
    assert code_of(latest.reason) is ReasonCode.SINGLE_WHEELSET
    assert counts(storage, "estimate_windows")["refused"] == 2
    with storage.read() as unit:
        assert {window.reason for window in unit.windows.list("W0")} == {NO_ALIGNMENT}
    assert counts(storage, "refresh_alignment")["unchanged"] == 1
    assert report(storage).report_id == latest.report_id
    put(storage, range(1, 6))
    assert counts(storage, "refresh_alignment")["windows"] == 12
    assert counts(storage, "estimate_windows")["estimated"] == 12
    with storage.read() as unit:
        assert {window.state for window in unit.windows.list("W0")} == {WindowState.ESTIMATED}


def test_one_section_that_fails_does_not_keep_the_others(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage, ("S0", "S1"))
    with storage.write() as unit:
        unit.tracks.add_alignment(replace(surveyed(), section="S0"))
        unit.connection.execute(update(table_of(TrackAlignmentRow)).values(packed=b"no alignment"))
    put(storage, range(6))
    put(storage, [0], day=1, section="S0")
    done = run(storage, "refresh_alignment")
    assert (done.outcome, done.counts["quarantined"]) == ("succeeded", 1)
    assert in_force(storage).version == 1


def test_a_run_that_is_stopped_stores_nothing_half_and_the_next_does_the_rest(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage)
    put(storage, range(6))
    stopped = run(
        storage, "refresh_alignment", stop_after=6
    )  # a checkpoint before each run, of two windows, and one before all
    assert (stopped.outcome, stopped.counts) == ("abandoned", {"done": 10, "total": 12})
    with storage.read() as unit:
        assert unit.tracks.in_force("S1") is None
        assert unit.tracks.report("S1") is None
        assert len(unit.epochs.remaining("S1", 1, 100)) == 12
        assert unit.tracks.position("W0", unit.windows.list("W0")[0].start_ns) is None
    assert counts(storage, "refresh_alignment")["versions"] == 1


def test_more_windows_than_an_epoch_holds_are_several_epochs(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage)
    put(storage, range(6))
    put(storage, [0, 2], day=1)
    done = counts(storage, "refresh_alignment", JobSettings(alignment=AlignmentSettings(most_windows=12)))
    assert (done["windows"], done["versions"]) == (16, 2)


def test_a_window_that_is_found_elsewhere_is_estimated_again(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage)
    found = put(storage, range(6))
    counts(storage, "refresh_alignment")
    counts(storage, "estimate_windows")
    moved = replace(found[0], distance=found[0].distance + 9.0)
    with storage.write() as unit:
        unit.windows.put(moved, 10.0, 2)
    assert counts(storage, "estimate_windows")["estimated"] == 0
    counts(storage, "refresh_alignment")
    with storage.read() as unit:
        position = unit.tracks.position(moved.wheelset, moved.start_ns)
    assert position is not None
    assert counts(storage, "estimate_windows")["estimated"] >= 1

"""Versions of alignments by where they came from, reports of runs, positions of windows: the same on both databases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import stored_values as make
from waiting_windows import waiting_windows

from bench.put_values import put_table
from estimation.errors import ConflictError
from estimation.values.geometry import TableKey
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import (
    AlignmentRecord,
    AlignmentSource,
    GaugeShift,
    TrackAlignment,
    TrackFindings,
    TrackReport,
)
from estimation.values.windows import WindowPosition, WindowState
from fleet_db.packed_values import pack_alignment, unpack_alignment
from fleet_db.storage import SqlStorage

FOUND = TrackFindings(
    {"V-1": 1.05}, 0.02, {"W-1": GaugeShift(np.linspace(-5e-3, 5e-3, 3), np.linspace(-4e-3, 4e-3, 2), np.ones((3, 2)))}
)


def of_fleet(seed: int) -> TrackAlignment:
    """Return an alignment from the fleet, unknown at its first place."""
    made = make.alignment(seed)
    d, std = made.alignment.copy(), made.alignment_std.copy()
    d[0] = std[0] = np.nan
    return replace(
        made,
        alignment=d,
        alignment_std=std,
        source=AlignmentSource.FLEET,
        cutoff_wavelength=62.5,
        scale_std=0.0125,
        gauge_known=False,
    )


ALIKE = Reason(ReasonCode.PASSES_ALIKE, "too alike")
REPORT = TrackReport(
    "S-7", None, made=False, status=Status.UNESTIMATED, reason=ALIKE, windows=3, input_digest="d" * 64,
    code_version="1+x", report={"rounds": 4, "journeys": [{"vehicle": "V-1", "residual_rms_m": None}]}, recorded_ns=7,
)  # fmt: skip


def test_where_an_alignment_came_from_comes_back_with_it_and_a_recording_is_packed_as_ever() -> None:
    fleet = of_fleet(1)
    assert make.same(unpack_alignment(pack_alignment(fleet), 0, where="here"), fleet)
    recorded = make.alignment(1)
    assert unpack_alignment(pack_alignment(recorded), 0, where="here").source == AlignmentSource.RECORDED
    assert b"" != pack_alignment(recorded) != pack_alignment(replace(recorded, cutoff_wavelength=60.0))
    with_findings = unpack_alignment(pack_alignment(replace(recorded, findings=FOUND)), 0, where="here")
    assert (with_findings.source, with_findings.findings is not None) == (AlignmentSource.RECORDED, True)
    assert make.same(replace(with_findings, findings=None), recorded)


def test_a_recording_registered_again_does_not_come_before_what_the_fleet_has_found(fleet: SqlStorage) -> None:
    recorded = make.alignment(1)
    with fleet.write() as unit:
        assert unit.tracks.in_force("S-7") is None
        assert unit.tracks.add_alignment(recorded) == 1
        assert unit.tracks.add_alignment(of_fleet(2), recorded_ns=50) == 2
        assert unit.tracks.add_alignment(of_fleet(2), recorded_ns=60) == 2
        assert unit.tracks.add_alignment(of_fleet(3), same_since=2, recorded_ns=70) == 3
        assert unit.tracks.add_alignment(recorded) == 1
    with fleet.read() as unit:
        newest = unit.tracks.in_force("S-7")
        found = unit.tracks.versions("S-7", None, 10)
        assert make.same(unit.tracks.alignment("S-7"), replace(of_fleet(3), version=3))
        assert unit.tracks.versions("S-7", 1, 1) == found[1:2]
        assert unit.tracks.versions("S-8", None, 10) == []
    std = float(np.nanmedian(of_fleet(3).alignment_std))
    assert newest == found[-1]
    with_findings = AlignmentRecord(
        "S-7",
        3,
        Status.ESTIMATED,
        AlignmentSource.FLEET,
        same_since=2,
        cut_off_m=62.5,
        scale_std=0.0125,
        gauge_known=False,
        alignment_std_m=std,
        points=40,
        recorded_ns=70,
    )
    assert newest == with_findings
    assert found[0] == replace(
        with_findings, version=1, source=AlignmentSource.RECORDED, same_since=1, cut_off_m=np.inf, scale_std=0.0,
        gauge_known=True, alignment_std_m=None, recorded_ns=None,
    )  # fmt: skip


def test_what_the_fleet_finds_again_after_a_recording_comes_in_force_again(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        assert unit.tracks.add_alignment(of_fleet(2), recorded_ns=50) == 1
        assert unit.tracks.add_alignment(make.alignment(1)) == 2
        assert unit.tracks.add_alignment(of_fleet(2), recorded_ns=60) == 3


def test_a_recording_registered_again_does_not_come_before_itself_with_what_the_fleet_has_found(
    fleet: SqlStorage,
) -> None:
    recorded, other = make.alignment(1), make.alignment(2)
    with_findings = replace(recorded, findings=FOUND)
    with fleet.write() as unit:
        assert unit.tracks.add_alignment(recorded) == 1
        assert unit.tracks.add_alignment(with_findings, recorded_ns=50) == 2
        assert unit.tracks.add_alignment(with_findings, recorded_ns=60) == 2
        assert unit.tracks.add_alignment(recorded) == 1
        newest = unit.tracks.in_force("S-7")
        assert newest is not None
        assert (newest.version, newest.source, newest.same_since) == (2, AlignmentSource.RECORDED, 2)
        in_force = unit.tracks.alignment("S-7")
        assert in_force is not None
        assert in_force.findings is not None
        assert unit.tracks.add_alignment(other) == 3
        assert unit.tracks.add_alignment(recorded) == 4  # back to the first


def test_reports_are_kept_and_the_one_that_made_a_version_is_found(fleet: SqlStorage) -> None:
    made = replace(REPORT, version=1, made=True, status=Status.ESTIMATED, reason=None)
    kept = replace(REPORT, version=1)
    with fleet.write() as unit:
        assert unit.tracks.report("S-7") is None
        numbers = [unit.tracks.add_report(one) for one in (REPORT, made, kept)]
    assert numbers == sorted(set(numbers))
    with fleet.read() as unit:
        assert unit.tracks.report("S-7") == replace(kept, report_id=numbers[2])
        assert unit.tracks.report("S-7", 1) == replace(made, report_id=numbers[1])
        assert unit.tracks.report("S-7", 2) is None


def test_windows_wait_until_it_has_been_looked_at_where_they_were(fleet: SqlStorage) -> None:
    windows = [make.window(number) for number in range(3)]
    elsewhere = make.window(3, track_section=None)
    with fleet.write() as unit:
        for window in (*windows, elsewhere):
            unit.windows.put(window, 1.0, 1)
        records = {record.start_ns: record for record in waiting_windows(unit)}
        assert len(records) == 4
        unit.tracks.add_alignment(of_fleet(1), recorded_ns=1)
        assert [one.start_ns for one in waiting_windows(unit)] == [elsewhere.start_ns]
        digest = records[windows[0].start_ns].content_digest
        position = WindowPosition("WS-1", windows[0].start_ns, digest, None, 12.5, -1e-3, 6000.0)
        assert unit.tracks.position("WS-1", windows[0].start_ns) is None
        assert unit.tracks.put_positions([position])
        assert not unit.tracks.put_positions([position])
        assert unit.tracks.put_positions([replace(position, offset_m=12.25)])
    with fleet.read() as unit:
        assert unit.tracks.position("WS-1", windows[0].start_ns) == replace(position, offset_m=12.25)
        assert [one.start_ns for one in waiting_windows(unit)] == [windows[0].start_ns, elsewhere.start_ns]
    with fleet.write() as unit:  # other samples: not estimated yet
        unit.windows.put(make.window(0, seed=5), 1.0, 2)
        assert [one.start_ns for one in waiting_windows(unit)] == [elsewhere.start_ns]
    with pytest.raises(ConflictError), fleet.write() as unit:
        unit.tracks.put_positions([replace(position, start_ns=5)])


def test_where_windows_of_a_section_were_can_be_forgotten(fleet: SqlStorage) -> None:
    windows = [make.window(1), make.window(2, track_section=None)]
    with fleet.write() as unit:
        for window in windows:
            unit.windows.put(window, 1.0, 1)
        for record in waiting_windows(unit):
            unit.tracks.put_positions([WindowPosition(record.wheelset, record.start_ns, record.content_digest, None)])
        assert unit.tracks.forget_positions("S-8") == 0
        assert unit.tracks.forget_positions("S-7") == 1
        assert unit.tracks.position("WS-1", windows[0].start_ns) is None
        assert unit.tracks.position("WS-1", windows[1].start_ns) is not None


def test_tables_are_found_by_what_they_were_made_with(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        for number, version in enumerate((1, 2, 3)):
            window = make.window(number)
            unit.windows.put(window, 1.0, 1)
            unit.windows.mark("WS-1", window.start_ns, WindowState.ESTIMATED)
            record = unit.windows.get("WS-1", window.start_ns)
            assert record is not None
            put_table(unit, "WS-1", window.start_ns, make.bin_table(), version, record.content_digest)
        (key,) = unit.tables.parameter_keys(["S-7"])
        assert unit.tables.parameter_keys(["S-8", ""]) == []
        assert key == TableKey("WS-1", "V-1", make.bin_table().parameter_key)
        assert len(unit.tables.made_with(key)) == 3
        for other in (replace(key, wheelset="WS-2"), replace(key, vehicle="V-2"), replace(key, parameter_key="other")):
            assert unit.tables.made_with(other) == []

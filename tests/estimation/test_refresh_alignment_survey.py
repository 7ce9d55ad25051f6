"""The alignment job with data on file: a survey is checked against the fleet, a surveyed gauge gives shifts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from alignment_job import LENGTH, NAMES, QUIET, counts, in_force, put, register, report, surveyed
from section_runs import windows
from sqlalchemy import update

from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.storage import Storage
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.track import AlignmentSource, TrackAlignment
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.track import TrackEpochRow
from ingest.registry_file import FORMAT, load_registry


@pytest.mark.parametrize(
    ("factor", "code"), [(1.0, "survey_confirmed"), (1e3, "survey_unit"), (-1.0, "survey_mirrored")]
)
def test_a_recording_is_kept_unless_the_fleet_contradicts_it(
    sqlite_storage: SqlStorage, factor: float, code: str
) -> None:
    storage = sqlite_storage
    register(storage)
    with storage.write() as unit:
        unit.tracks.add_alignment(surveyed(factor))
    put(storage, range(6))
    counts(storage, "refresh_alignment")
    latest = report(storage)
    assert latest.report["recording_code"] == code
    if code == "survey_confirmed":
        assert (in_force(storage).version, in_force(storage).source) == (1, AlignmentSource.RECORDED)
        assert latest.report["recording"] == "agrees with what the fleet has measured"
        with storage.read() as unit:
            position = unit.tracks.position("W0", windows(0)[0].start_ns)
        assert position is not None
        assert position.offset_m == pytest.approx(0.0, abs=0.05)  # always corrected, and right
        assert position.scale == pytest.approx(0.0, abs=5e-5)
        assert position.reason is None
    else:
        assert (in_force(storage).version, in_force(storage).source) == (2, AlignmentSource.FLEET)
        assert str(latest.report["recording"]).startswith("not used: ")
        with storage.write() as unit:  # what is registered again at the next start does not come back
            assert unit.tracks.add_alignment(surveyed(factor)) == 1
        assert in_force(storage).version == 2


def verdict(storage: Storage) -> object:
    return report(storage).report["recording_code"]


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1e3])
def test_the_verdict_on_a_recording_stays_once_it_is_made(sqlite_storage: SqlStorage, factor: float) -> None:
    storage = sqlite_storage
    register(storage)
    with storage.write() as unit:
        unit.tracks.add_alignment(surveyed(factor))
    put(storage, range(6))
    counts(storage, "refresh_alignment")
    first = verdict(storage)
    assert first is not None
    for day, in_epoch in ((2, 4), (4, 8)):  # few windows end no epoch
        put(storage, [1, 4], day=day)
        assert counts(storage, "refresh_alignment")["windows"] == in_epoch
        assert verdict(storage) == first
    with storage.write() as unit:
        unit.tracks.add_alignment(replace(surveyed(), alignment=1.001 * surveyed().alignment))
    put(storage, range(6), day=6)
    counts(storage, "refresh_alignment")
    assert verdict(storage) == "survey_confirmed"


@pytest.mark.slow
def test_a_survey_that_could_not_be_assessed_is_judged_again(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage)
    with storage.write() as unit:
        unit.tracks.add_alignment(surveyed())
    put(storage, range(6))
    counts(storage, "refresh_alignment")
    with storage.write() as unit:
        unit.connection.execute(update(table_of(TrackEpochRow)).values(survey_code="survey_not_assessable"))
    put(storage, range(6), day=2)
    counts(storage, "refresh_alignment")
    assert verdict(storage) == "survey_confirmed"


@pytest.mark.parametrize(("factor", "left"), [(1.0, "estimated"), (-1.0, "refused_alignment_unknown")])
def test_one_wheelset_alone_keeps_a_right_survey_and_no_window_waits_for_a_wrong_one(
    sqlite_storage: SqlStorage, factor: float, left: str
) -> None:
    storage = sqlite_storage
    register(storage)
    with storage.write() as unit:
        unit.tracks.add_alignment(surveyed(factor))
    stored = [window for day in (0, 2, 3) for window in put(storage, [0], day=day)]
    counts(storage, "refresh_alignment")
    assert counts(storage, "estimate_windows")[left] == len(stored)


def gauged() -> TrackAlignment:
    """Return the recording with a gauge that varies by 1 mm SD; to the wheelsets of these runs it does nothing."""
    known = surveyed()
    gauge = np.sqrt(2.0) * 1e-3 * np.sin(2 * np.pi * known.s / 40.0)
    return replace(known, gauge_deviation=gauge, gauge_deviation_std=np.full(len(known.s), 0.1e-3))


@pytest.mark.slow
def test_what_a_recorded_gauge_does_to_wheelsets_becomes_a_version_of_the_recording(
    sqlite_storage: SqlStorage,
) -> None:
    storage = sqlite_storage
    register(storage)
    with storage.write() as unit:
        assert unit.tracks.add_alignment(gauged()) == 1
    put(storage, range(5))
    put(storage, range(5), day=1)
    assert counts(storage, "estimate_windows")["estimated"] == 20  # on a surveyed section no window waits
    assert counts(storage, "refresh_alignment")["versions"] == 1
    found = in_force(storage)
    assert (found.version, found.source, found.gauge_known, found.cutoff_wavelength) == (
        2,
        AlignmentSource.RECORDED,
        True,
        np.inf,
    )
    for name in ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes"):
        np.testing.assert_array_equal(getattr(found, name), getattr(gauged(), name))
    assert found.findings is not None
    assert set(found.findings.gauge_shifts) == set(NAMES[:5])
    assert set(found.findings.stiffness_ratio) == {name.replace("W", "V") for name in NAMES[:5]}
    assert (report(storage).made, report(storage).version) == (True, 2)
    with storage.read() as unit:
        position = unit.tracks.position("W0", windows(0)[0].start_ns)
    assert position is not None
    assert position.offset_m == pytest.approx(0.0, abs=0.05)
    assert position.scale == pytest.approx(0.0, abs=5e-5)
    assert position.reason is None
    assert counts(storage, "estimate_windows") == {
        "estimated": 20, "refused": 0, "changed_meanwhile": 0, "requeued": 0, "quarantined": 0
    }  # fmt: skip
    with storage.write() as unit:  # the registry is loaded at every start
        assert unit.tracks.add_alignment(gauged()) == 1
    for day in (3, 5):
        put(storage, range(5), day=day)
        assert counts(storage, "refresh_alignment")["kept"] == 1
        assert in_force(storage).version == 2
    put(storage, range(6), day=7)
    assert counts(storage, "refresh_alignment")["versions"] == 1
    more = in_force(storage).findings
    assert more is not None
    assert set(more.gauge_shifts) == set(NAMES)
    with storage.read() as unit:
        record = unit.tracks.in_force("S1")
    assert record is not None
    assert (record.version, record.same_since, record.source) == (3, 1, AlignmentSource.RECORDED)
    done = counts(storage, "estimate_windows")
    assert done["estimated"] - done["requeued"] == 32  # what has come,
    assert done["requeued"] <= 4  # and of one vehicle at most, whose stiffness ratio is another now


def test_nothing_is_made_of_a_recorded_gauge_that_hardly_varies(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage)
    with storage.write() as unit:
        unit.tracks.add_alignment(replace(gauged(), gauge_deviation=0.2 * gauged().gauge_deviation + 1e-3))
    put(storage, range(6))
    assert counts(storage, "refresh_alignment")["kept"] == 1
    assert in_force(storage).version == 1


def load_gauge(storage: Storage, folder: Path) -> None:
    """Load a registry whose track file has the gauge alone."""
    known = gauged()
    rows = [f"{s:.3f},{1e3 * e:.6f}" for s, e in zip(known.s[::4], known.gauge_deviation[::4], strict=True)]
    load(storage, folder, "s_m,gauge_deviation_mm", rows)


def load_survey(storage: Storage, folder: Path) -> None:
    """Load a registry with the alignment."""
    known = surveyed()
    rows = [f"{s:.3f},{1e3 * d:.6f},0" for s, d in zip(known.s, known.alignment, strict=True)]
    load(storage, folder, "s_m,alignment_mm,gauge_deviation_mm", rows, alignment_std_mm=0.05)


def load(storage: Storage, folder: Path, header: str, rows: Sequence[str], **stds: float) -> None:
    (folder / "track.csv").write_text("\n".join([header, *rows]))
    section = {
        "code": "S1", "number": 1, "name": "Section", "rail_profile": "56E1", "rail_inclination": 0.05,
        "nominal_gauge_mm": 1435.0, "length_m": LENGTH,
        "alignment": {"file": "track.csv", "gauge_deviation_std_mm": 0.1, **stds},
    }  # fmt: skip
    (folder / "registry.json").write_text(json.dumps({"format": FORMAT, "track_sections": [section]}))
    with storage.write() as unit:
        load_registry(folder / "registry.json", unit, 1)


def test_of_a_section_whose_gauge_alone_is_on_file_the_fleet_finds_the_alignment(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    storage = sqlite_storage
    register(storage)
    load_gauge(storage, tmp_path)
    on_file = in_force(storage)
    assert (on_file.version, on_file.source, on_file.status) == (1, AlignmentSource.RECORDED, Status.UNESTIMATED)
    assert on_file.gauge_known
    assert np.isnan(on_file.alignment).all()
    put(storage, [0])
    assert counts(storage, "refresh_alignment")["unestimated"] == 1
    assert code_of(report(storage).reason) is ReasonCode.SINGLE_WHEELSET
    assert counts(storage, "estimate_windows")["refused"] == 2
    with storage.read() as unit:
        assert {window.reason for window in unit.windows.list("W0")} == {NO_ALIGNMENT}
        assert unit.tracks.position("W0", windows(0)[0].start_ns) is None  # left for the next
    assert counts(storage, "refresh_alignment")["unchanged"] == 1
    assert counts(storage, "estimate_windows") == QUIET
    put(storage, range(1, 6))
    assert counts(storage, "refresh_alignment")["versions"] == 1
    found = in_force(storage)
    assert (found.version, found.source, found.status, found.gauge_known) == (
        2,
        AlignmentSource.FLEET,
        Status.ESTIMATED,
        True,
    )
    np.testing.assert_allclose(found.gauge_deviation, np.interp(found.s, on_file.s, on_file.gauge_deviation), atol=1e-9)
    assert report(storage).report["evidence"] == ["recorded version 1"]
    load_gauge(storage, tmp_path)
    assert in_force(storage).version == 2
    assert counts(storage, "estimate_windows")["estimated"] == 12
    put(storage, [1, 4], day=3)
    assert counts(storage, "refresh_alignment")["versions"] == 1
    assert in_force(storage).gauge_known


@pytest.mark.slow
def test_a_track_file_that_comes_later_lets_the_windows_be_looked_at_again(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    """The alignment of the fleet is at the mean position of its odometers; the survey is elsewhere."""
    offsets = (0.0, 4.0, 9.0, -3.0, 12.0, 7.0)
    storage = sqlite_storage
    register(storage)
    for number, offset in enumerate(offsets):
        put(storage, [number], offset=offset)
    counts(storage, "refresh_alignment")
    assert counts(storage, "estimate_windows")["estimated"] == 12
    load_survey(storage, tmp_path)
    assert counts(storage, "refresh_alignment")["windows"] == 12
    assert in_force(storage).source == AlignmentSource.RECORDED
    with storage.read() as unit:
        positions = [unit.tracks.position(f"W{number}", windows(number)[0].start_ns) for number in range(6)]
    for position, offset in zip(positions, offsets, strict=True):
        assert position is not None
        shift = position.offset_m + position.scale * (1000.0 - position.middle_m)
        assert (position.version, shift) == (2, pytest.approx(-offset, abs=1.5))
    assert counts(storage, "estimate_windows")["estimated"] == 12
    load_survey(storage, tmp_path)
    assert counts(storage, "refresh_alignment")["windows"] == 0
    load_gauge(storage, tmp_path)
    assert counts(storage, "refresh_alignment")["versions"] == 1
    found = in_force(storage)
    assert (found.version, found.source, found.gauge_known) == (4, AlignmentSource.FLEET, True)
    assert counts(storage, "estimate_windows")["estimated"] == 12

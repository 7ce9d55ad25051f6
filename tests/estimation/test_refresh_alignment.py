"""The alignment job on a real store: epochs become versions, once; windows wait for it no longer than they must."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from section_runs import RUNS, windows
from smooth_wheelset import alignment, track
from sqlalchemy import update

from estimation.jobs.catalogue import job_named
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.storage import Storage
from estimation.track.settings import AlignmentSettings
from estimation.track.survey_check import SurveyCheck, check_survey
from estimation.track.versions import carry_over_findings, gauge_shift_changed, requires_reestimation
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import JobRun, JobTrigger
from estimation.values.track import (
    FLEET,
    RECORDED,
    GaugeShift,
    TrackAlignment,
    TrackFindings,
    TrackReport,
    TrackSectionRecord,
)
from estimation.values.windows import Window, WindowState
from fleet_db.models import TrackAlignmentRow
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from ingest.registry_file import load_registry
from ingest.registry_schema import FORMAT

LENGTH = 2900.0
DAY_NS = 86_400 * 10**9
NAMES = [f"W{number}" for number in range(len(RUNS))]


@dataclass(slots=True)
class Clock:
    at_ns: int = 10**15

    def now_ns(self) -> int:
        self.at_ns += 1_000_000
        return self.at_ns


def register(storage: Storage, sections: Sequence[str] = ("S1",)) -> None:
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        for number, code in enumerate(sections, start=1):
            unit.tracks.add_section(TrackSectionRecord(code, number, "Section", "56E1", 0.05, 1.435, LENGTH))
        for name in NAMES:
            unit.registry.add_vehicle(VehicleRecord(name.replace("W", "V"), "F", "metro", 1, 40.0, (0.0,)))
            unit.registry.add_wheelset(WheelsetRecord(name, "F", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(name, name.replace("W", "V"), 1, 0, None, 0.0, 0.0))


def put(
    storage: Storage, numbers: Sequence[int], *, day: int = 0, offset: float = 0.0, section: str = "S1"
) -> list[Window]:
    """Store the windows of some runs, as reported by odometers that are ``offset`` m off."""
    found = [
        replace(
            window,
            start_ns=window.start_ns + day * DAY_NS,
            distance=window.distance + offset,
            track_section=section,
        )
        for number in numbers
        for window in windows(number)
    ]
    with storage.write() as unit:
        for window in found:
            unit.windows.put(window, 10.0 + day, 1)
    return found


def run(storage: Storage, name: str, settings: JobSettings | None = None, *, stop_after: int | None = None) -> JobRun:
    left = [stop_after]

    def stopping() -> bool:
        if left[0] is None:
            return False
        left[0] -= 1
        return left[0] < 0

    job: Job = job_named(name)
    return run_job(
        job, JobContext(storage, Clock(), "test", settings or JobSettings(), stopping=stopping), JobTrigger.CLI
    )


def counts(storage: Storage, name: str, settings: JobSettings | None = None) -> Mapping[str, int]:
    done = run(storage, name, settings)
    assert done.outcome == "succeeded", done.error
    return done.counts


def report(storage: Storage, section: str = "S1") -> TrackReport:
    with storage.read() as unit:
        found = unit.tracks.report(section)
    assert found is not None
    return found


def in_force(storage: Storage, section: str = "S1") -> TrackAlignment:
    with storage.read() as unit:
        found = unit.tracks.alignment(section)
    assert found is not None
    return found


def surveyed(factor: float = 1.0) -> TrackAlignment:
    known = alignment(track(1))
    part = known.s <= LENGTH
    n = int(part.sum())
    return replace(
        known,
        version=0,
        s=known.s[part],
        alignment=factor * known.alignment[part],
        alignment_std=np.full(n, 0.05e-3),
        gauge_deviation=np.zeros(n),
        gauge_deviation_std=np.zeros(n),
        passes=np.zeros(n, dtype=np.int64),
    )


def test_an_epoch_becomes_a_version_once_and_its_windows_are_estimated_on_it(storage: SqlStorage) -> None:
    register(storage)
    put(storage, range(6))
    first = counts(storage, "refresh_alignment")
    assert (first["versions"], first["windows"]) == (1, 12)
    found = in_force(storage)
    assert (found.version, found.source, found.gauge_known) == (1, FLEET, False)
    latest = report(storage)
    assert (latest.version, latest.made, latest.status) == (1, True, Status.ESTIMATED)
    assert counts(storage, "estimate_windows")["estimated"] == 12
    with storage.read() as unit:
        assert {version for _, _, version in unit.tables.index("W0", 0, None)} == {1}
    again = counts(storage, "refresh_alignment")
    assert (again["versions"], again["unchanged"]) == (0, 1)
    assert report(storage) == latest
    assert counts(storage, "estimate_windows") == {"estimated": 0, "refused": 0, "changed_meanwhile": 0, "requeued": 0}


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


@pytest.mark.parametrize(("factor", "said"), [(1.0, None), (1e3, "millimetres"), (-1.0, "mirror image")])
def test_a_recording_is_kept_unless_the_fleet_contradicts_it(
    sqlite_storage: SqlStorage, factor: float, said: str | None
) -> None:
    storage = sqlite_storage
    register(storage)
    with storage.write() as unit:
        unit.tracks.add_alignment(surveyed(factor))
    put(storage, range(6))
    counts(storage, "refresh_alignment")
    latest = report(storage)
    if said is None:
        assert (in_force(storage).version, in_force(storage).source) == (1, RECORDED)
        assert latest.report["recording"] == "agrees with what the fleet has measured"
        with storage.read() as unit:
            position = unit.tracks.position("W0", windows(0)[0].start_ns)
        assert position is not None
        assert (position.offset_m, position.scale, position.reason) == (0.0, 0.0, None)
    else:
        assert (in_force(storage).version, in_force(storage).source) == (2, FLEET)
        assert said in str(latest.report["recording"])
        with storage.write() as unit:  # what is registered again at the next start does not come back
            assert unit.tracks.add_alignment(surveyed(factor)) == 1
        assert in_force(storage).version == 2


def verdict(storage: Storage) -> object:
    return report(storage).report["recording"]


@pytest.mark.parametrize("factor", [1.0, 1e3])
def test_the_verdict_on_a_recording_stays_over_the_epochs_that_do_not_judge(
    sqlite_storage: SqlStorage, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage = sqlite_storage
    asked = []

    def judged(*given: object, place_std: float = 0.0) -> SurveyCheck:
        asked.append(place_std)
        return check_survey(*given, place_std=place_std)  # type: ignore[arg-type] - as they come

    monkeypatch.setattr("estimation.track.update.check_survey", judged)
    register(storage)
    with storage.write() as unit:
        unit.tracks.add_alignment(surveyed(factor))
    put(storage, range(6))
    counts(storage, "refresh_alignment")
    first = verdict(storage)
    assert first is not None
    for day in (2, 4):
        put(storage, [1, 4], day=day)
        assert counts(storage, "refresh_alignment")["windows"] == 4
        assert verdict(storage) == first
    assert len(asked) == 1
    with storage.write() as unit:
        unit.tracks.add_alignment(replace(surveyed(), alignment=1.001 * surveyed().alignment))
    put(storage, range(6), day=6)
    counts(storage, "refresh_alignment")
    assert len(asked) == 2  # of the new one nothing had been said
    assert verdict(storage) == "agrees with what the fleet has measured"


def gauged() -> TrackAlignment:
    """Return the recording with a gauge that varies by 1 mm SD; to the wheelsets of these runs it does nothing."""
    known = surveyed()
    gauge = np.sqrt(2.0) * 1e-3 * np.sin(2 * np.pi * known.s / 40.0)
    return replace(known, gauge_deviation=gauge, gauge_deviation_std=np.full(len(known.s), 0.1e-3))


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
    assert (found.version, found.source, found.gauge_known, found.cutoff_wavelength) == (2, RECORDED, True, np.inf)
    for name in ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes"):
        np.testing.assert_array_equal(getattr(found, name), getattr(gauged(), name))
    assert found.findings is not None
    assert set(found.findings.gauge_shifts) == set(NAMES[:5])
    assert set(found.findings.stiffness_ratio) == {name.replace("W", "V") for name in NAMES[:5]}
    assert (report(storage).made, report(storage).version) == (True, 2)
    with storage.read() as unit:
        position = unit.tracks.position("W0", windows(0)[0].start_ns)
    assert position is not None
    assert (position.offset_m, position.scale, position.reason) == (0.0, 0.0, None)  # positions stay as reported
    assert counts(storage, "estimate_windows") == {
        "estimated": 20, "refused": 0, "changed_meanwhile": 0, "requeued": 20
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
    assert (record.version, record.same_since, record.source) == (3, 3, RECORDED)


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
        load_registry(folder / "registry.json", unit)


def test_of_a_section_whose_gauge_alone_is_on_file_the_fleet_finds_the_alignment(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    storage = sqlite_storage
    register(storage)
    load_gauge(storage, tmp_path)
    on_file = in_force(storage)
    assert (on_file.version, on_file.source, on_file.status) == (1, RECORDED, Status.UNESTIMATED)
    assert on_file.gauge_known
    assert np.isnan(on_file.alignment).all()
    put(storage, [0])
    assert counts(storage, "refresh_alignment")["unestimated"] == 1
    assert code_of(report(storage).reason) is ReasonCode.SINGLE_WHEELSET
    assert counts(storage, "estimate_windows")["refused"] == 2
    with storage.read() as unit:
        assert {window.reason for window in unit.windows.list("W0")} == {NO_ALIGNMENT}
        assert len(unit.windows.unplaced("S1", 100)) == 2  # left for the next
    assert counts(storage, "refresh_alignment")["unchanged"] == 1
    assert counts(storage, "estimate_windows") == {"estimated": 0, "refused": 0, "changed_meanwhile": 0, "requeued": 0}
    put(storage, range(1, 6))
    assert counts(storage, "refresh_alignment")["versions"] == 1
    found = in_force(storage)
    assert (found.version, found.source, found.status, found.gauge_known) == (2, FLEET, Status.ESTIMATED, True)
    np.testing.assert_allclose(found.gauge_deviation, np.interp(found.s, on_file.s, on_file.gauge_deviation), atol=1e-9)
    assert report(storage).report["evidence"] == ["recorded version 1"]
    load_gauge(storage, tmp_path)
    assert in_force(storage).version == 2
    assert counts(storage, "estimate_windows")["estimated"] == 12
    put(storage, [1, 4], day=3)
    assert counts(storage, "refresh_alignment")["versions"] == 1
    assert in_force(storage).gauge_known


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
    assert in_force(storage).source == RECORDED
    with storage.read() as unit:
        positions = [unit.tracks.position(f"W{number}", windows(number)[0].start_ns) for number in range(6)]
    for position, offset in zip(positions, offsets, strict=True):
        assert position is not None
        shift = position.offset_m + position.scale * (1000.0 - position.middle_m)
        within_limit = abs(offset) < 5.0
        assert (position.version, shift) == (2, 0.0 if within_limit else pytest.approx(-offset, abs=1.5))
    assert counts(storage, "estimate_windows")["estimated"] == 12
    load_survey(storage, tmp_path)
    assert counts(storage, "refresh_alignment")["windows"] == 0
    load_gauge(storage, tmp_path)
    assert counts(storage, "refresh_alignment")["versions"] == 1
    found = in_force(storage)
    assert (found.version, found.source, found.gauge_known) == (4, FLEET, True)
    assert counts(storage, "estimate_windows")["estimated"] == 12


def test_one_section_that_fails_does_not_keep_the_others(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage, ("S0", "S1"))
    with storage.write() as unit:
        unit.tracks.add_alignment(replace(surveyed(), section="S0"))
        unit.connection.execute(update(table_of(TrackAlignmentRow)).values(packed=b"no alignment"))
    put(storage, range(6))
    put(storage, [0], day=1, section="S0")
    done = run(storage, "refresh_alignment")
    assert done.outcome == "failed"
    assert "alignment 1 of track section 'S0'" in str(done.error)
    assert in_force(storage).version == 1


def test_a_run_that_is_stopped_stores_nothing_half_and_the_next_does_the_rest(sqlite_storage: SqlStorage) -> None:
    storage = sqlite_storage
    register(storage)
    put(storage, range(6))
    stopped = run(storage, "refresh_alignment", stop_after=5)  # a checkpoint before each run, of two windows
    assert (stopped.outcome, stopped.counts) == ("abandoned", {"done": 10, "total": 12})
    with storage.read() as unit:
        assert unit.tracks.in_force("S1") is None
        assert unit.tracks.report("S1") is None
        assert len(unit.windows.unplaced("S1", 100)) == 12
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


def test_only_what_matters_is_another_alignment() -> None:
    settings = AlignmentSettings()
    n = 2000
    rng = np.random.default_rng(1)
    d, zero = 1e-3 * rng.standard_normal(n), np.zeros(n)
    std = np.full(n, 0.1e-3)
    old = TrackAlignment(
        "S1",
        1,
        np.arange(n) * 1.0,
        d,
        std,
        zero,
        zero,
        np.full(n, 5),
        Status.ESTIMATED,
        FLEET,
        60.0,
        0.0,
        False,  # noqa: FBT003 - the gauge is not known
    )
    hole = np.where(np.arange(n) < 100, np.nan, d)
    assert not requires_reestimation(old, replace(old, version=2), settings)
    assert not requires_reestimation(old, replace(old, alignment=d + 0.08e-3), settings)
    assert requires_reestimation(old, replace(old, alignment=d + 0.12e-3), settings)
    assert not requires_reestimation(old, replace(old, alignment=1.004 * d), settings)
    assert requires_reestimation(old, replace(old, alignment=1.006 * d), settings)  # does not average out
    assert requires_reestimation(old, replace(old, alignment_std=0.6 * std), settings)
    assert requires_reestimation(replace(old, alignment=hole), old, settings)
    assert requires_reestimation(old, replace(old, cutoff_wavelength=np.inf), settings)
    assert requires_reestimation(replace(old, scale_std=0.03), replace(old, scale_std=0.01), settings)
    sure = replace(old, alignment_std=0.1 * std)
    assert not requires_reestimation(sure, replace(sure, alignment=d + 0.04e-3, alignment_std=0.01 * std), settings)
    assert requires_reestimation(sure, replace(sure, alignment=d + 0.06e-3), settings)
    wide = 1e-3 * rng.standard_normal(n)
    assert requires_reestimation(old, replace(old, gauge_deviation=wide), settings)
    assert not requires_reestimation(old, replace(old, gauge_deviation=0.1 * wide), settings)
    estimated = replace(old, findings=TrackFindings({"A": 0.96}, 0.01, {}))
    assert not requires_reestimation(estimated, replace(old, findings=TrackFindings({"A": 0.975}, 0.01, {})), settings)
    assert requires_reestimation(estimated, replace(old, findings=TrackFindings({"A": 0.99}, 0.01, {})), settings)
    assert requires_reestimation(estimated, replace(old, findings=TrackFindings({"B": 1.0}, 0.01, {})), settings)
    recorded = replace(old, source=RECORDED, gauge_known=True)
    wheel = GaugeShift(np.linspace(-5e-3, 5e-3, 3), np.linspace(-4e-3, 4e-3, 2), np.zeros((3, 2)))
    with_one = replace(recorded, findings=TrackFindings({}, 0.01, {"A1": wheel}))
    with_two = replace(recorded, findings=TrackFindings({}, 0.01, {"A1": wheel, "A2": wheel}))
    assert requires_reestimation(recorded, with_one, settings)
    assert requires_reestimation(with_one, with_two, settings)
    assert not requires_reestimation(with_two, with_two, settings)
    doubtful = replace(old, findings=TrackFindings({"A": 0.96}, 0.04, {}))
    assert not requires_reestimation(doubtful, replace(old, findings=TrackFindings({"A": 0.99}, 0.01, {})), settings)


def test_another_gauge_shift_is_one_that_noise_does_not_make() -> None:
    settings, n = AlignmentSettings(), 2000
    gauge = 1e-3 * np.random.default_rng(1).standard_normal(n)
    R, e = np.linspace(-6e-3, 6e-3, 25), np.linspace(-4e-3, 4e-3, 17)

    def with_shift(per_gauge: float | None) -> TrackAlignment:
        table = {} if per_gauge is None else {"A": GaugeShift(R, e, per_gauge * np.sign(R)[:, None] * e[None, :])}
        zero = np.zeros(n)
        return TrackAlignment(
            "S1", 1, np.arange(n) * 1.0, zero, zero, gauge, zero, zero.astype(np.int64), Status.ESTIMATED,
            findings=TrackFindings({}, 0.01, table),
        )  # fmt: skip

    assert not gauge_shift_changed(with_shift(0.1), with_shift(0.2), settings)
    assert gauge_shift_changed(with_shift(0.1), with_shift(0.3), settings)
    assert not gauge_shift_changed(with_shift(None), with_shift(0.3), settings)
    assert not gauge_shift_changed(replace(with_shift(0.1), findings=None), with_shift(0.3), settings)


def test_what_was_found_of_those_who_stayed_away_is_kept() -> None:
    n, rng = 500, np.random.default_rng(1)
    zero, gauge = np.zeros(n), 1e-3 * rng.standard_normal(n)
    wheel = GaugeShift(np.linspace(-5e-3, 5e-3, 3), np.linspace(-4e-3, 4e-3, 2), np.zeros((3, 2)))
    base = TrackAlignment(
        "S1", 1, np.arange(n) * 1.0, zero, zero, gauge, zero, np.full(n, 5), Status.ESTIMATED, FLEET
    )  # fmt: skip
    before = replace(base, findings=TrackFindings({"A": 0.9, "B": 1.1}, 0.02, {"A1": wheel, "B1": wheel}))
    again = replace(base, gauge_deviation=gauge + 0.3e-3 * rng.standard_normal(n))
    epoch = TrackFindings({"A": 0.95}, 0.01, {"A1": wheel})
    kept = carry_over_findings(replace(again, findings=epoch), before).findings
    assert kept is not None
    assert (kept.stiffness_ratio, kept.stiffness_ratio_std) == ({"A": 0.95, "B": 1.1}, 0.02)
    assert set(kept.gauge_shifts) == {"A1", "B1"}
    other = carry_over_findings(replace(base, gauge_deviation=-gauge, findings=epoch), before).findings
    assert other is not None
    assert set(other.gauge_shifts) == {"A1"}  # the gauge under the others was another one
    every = replace(epoch, stiffness_ratio={"A": 1.0, "B": 1.0})
    found = replace(again, findings=every)
    assert carry_over_findings(found, before).findings == replace(every, gauge_shifts=kept.gauge_shifts)
    assert carry_over_findings(found, None) is found

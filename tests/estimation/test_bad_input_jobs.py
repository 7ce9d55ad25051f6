"""Bad input through the real store and jobs: each is refused or reported with its reason; no other result moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from paper_class import paper_class
from section_runs import RUNS, windows
from smooth_wheelset import alignment, mems_windows, run, track

from bench.standing_clock import StandingClock
from estimation.jobs.catalogue import run_all
from estimation.jobs.job import JobContext
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.geometry import GeometryRecord
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import JobTrigger
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord
from estimation.values.windows import Window, WindowRecord, WindowState

LENGTH = 2900.0
HOUR_NS = 3_600 * 10**9


def surveyed(std: float = 0.05e-3) -> TrackAlignment:
    """Return what a recording car would have written of the section."""
    known = alignment(track(1))
    part = known.s <= LENGTH
    rng = np.random.default_rng(4)
    n = int(part.sum())
    return replace(
        known,
        version=0,
        s=known.s[part],
        alignment=known.alignment[part] + std * rng.standard_normal(n),
        alignment_std=np.full(n, std),
        gauge_deviation=np.zeros(n),
        gauge_deviation_std=np.zeros(n),
        passes=np.zeros(n, dtype=np.int64),
    )


def deployed(storage: Storage, found: dict[str, Sequence[Window]], recorded: TrackAlignment | None = None) -> None:
    """Register a vehicle of one wheelset for each name, put its windows, and run all jobs."""
    with storage.write() as unit:
        unit.registry.add_vehicle_class(paper_class("metro"), 1)
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "56E1", 0.05, 1.435, LENGTH))
        if recorded is not None:
            unit.tracks.add_alignment(recorded)
        for name, items in found.items():
            unit.registry.add_vehicle(VehicleRecord(name, "F", "metro", 1, 40.0, (0.0,)))
            unit.registry.add_wheelset(WheelsetRecord(name, "F", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(name, name, 1, 0, None, 0.0, 0.0))
            for window in items:
                unit.windows.put(replace(window, wheelset=name, vehicle=name, track_section="S1"), 10.0, 1)
    run_jobs(storage)


def run_jobs(storage: Storage) -> None:
    runs = run_all(JobContext(storage, StandingClock(10**15), "test", JobSettings()), JobTrigger.CLI)
    assert [run.outcome for run in runs] == ["succeeded"] * len(runs), runs


def valid_windows() -> dict[str, Sequence[Window]]:
    return {f"W{number}": windows(number) for number in range(len(RUNS))}


def geometries(storage: Storage) -> dict[str, GeometryRecord]:
    with storage.read() as unit:
        found = {f"W{number}": unit.geometries.current(f"W{number}") for number in range(len(RUNS))}
    return {name: record for name, record in found.items() if record is not None}


def same(first: dict[str, GeometryRecord], second: dict[str, GeometryRecord]) -> None:
    assert set(first) == set(second)
    for name, record in first.items():
        ours, theirs = record.geometry.rolling_radius_difference, second[name].geometry.rolling_radius_difference
        np.testing.assert_allclose(ours.value, theirs.value, rtol=1e-9, atol=1e-12, equal_nan=True)
        assert ours.status == theirs.status
        found = [[np.nan if e.value is None else e.value for e in r.geometry.conicity] for r in (record, second[name])]
        np.testing.assert_allclose(found[0], found[1], rtol=1e-9, equal_nan=True)


def states(storage: Storage, name: str) -> Sequence[WindowRecord]:
    with storage.read() as unit:
        return unit.windows.list(name)


def bad_windows() -> dict[str, tuple[Sequence[Window], ReasonCode]]:
    """Return by vehicle windows with something wrong with them, and the expected reason of each."""
    first = windows(1)[0]
    n = len(first.valid)
    elsewhere = tuple(replace(w, distance=o.distance) for w, o in zip(windows(1, 2), windows(1), strict=True))
    return {
        "B0": (elsewhere, ReasonCode.OTHER_SECTION),
        "B1": (_yaw_reversed(windows(1)), ReasonCode.MIRRORED),
        "B2": ((replace(first, speed=np.zeros(n), distance=np.full(n, 500.0)),), ReasonCode.NOT_MOVING),
        "B4": ((replace(first, valid=np.arange(n) < 1200),), ReasonCode.INTERRUPTED),
        "B5": ((replace(first, speed=first.speed * 0.7),), ReasonCode.POSITION_JUMP),
        "B6": (_all_reversed(windows(3)), ReasonCode.MIRRORED),
    }


def _short_pass() -> Sequence[Window]:
    """Return a window of a vehicle that left the section after 100 m: shorter than the longest wavelength."""
    (whole,) = mems_windows(run(12, cone=0.1, speed=8.5), seed=77, length_s=12)
    return (replace(whole, start_ns=0),)


def _yaw_reversed(found: Sequence[Window]) -> Sequence[Window]:
    """Return windows whose yaw sensor has the other sign: as of a vehicle with its rear end first, on another track."""
    return [replace(w, yaw_acceleration=-w.yaw_acceleration) for w in found]


def _all_reversed(found: Sequence[Window]) -> Sequence[Window]:
    """Return windows whose sensors all have the other sign, so that nothing in them contradicts itself."""
    names = ("lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration")
    return [replace(w, **{name: -getattr(w, name) for name in names}) for w in found]


@pytest.fixture(scope="module")
def without(new_sqlite_storage: Callable[[], Storage]) -> dict[str, GeometryRecord]:
    """Return the geometries of the valid windows alone on unknown track."""
    storage = new_sqlite_storage()
    deployed(storage, valid_windows())
    return geometries(storage)


@pytest.fixture(scope="module")
def without_on_record(new_sqlite_storage: Callable[[], Storage]) -> dict[str, GeometryRecord]:
    """Return those on a recorded track."""
    storage = new_sqlite_storage()
    deployed(storage, valid_windows(), surveyed())
    return geometries(storage)


@pytest.mark.parametrize("track_is", [pytest.param("unknown", marks=pytest.mark.slow), "recorded"])
def test_bad_passes_are_refused_with_their_reason_and_the_others_stay_as_they_were(
    sqlite_storage: Storage, request: pytest.FixtureRequest, track_is: str
) -> None:
    without = request.getfixturevalue("without" if track_is == "unknown" else "without_on_record")
    recorded = surveyed() if track_is == "recorded" else None
    bad = bad_windows()
    if recorded is None:  # on a recording nothing is asked of a pass that says nothing against it
        bad["B3"] = (_short_pass(), ReasonCode.PASS_TOO_SHORT)
    deployed(sqlite_storage, valid_windows() | {name: items for name, (items, _) in bad.items()}, recorded)
    for name, (items, expected) in bad.items():
        records = states(sqlite_storage, name)
        assert len(records) == len(items)
        assert {record.state for record in records} == {WindowState.REFUSED}, (name, records)
        assert {code_of(record.reason) for record in records} == {expected}, (name, [r.reason for r in records])
    assert len(without) == len(RUNS)
    same(geometries(sqlite_storage), without)


def test_of_a_window_whose_position_jumps_what_fits_helps_the_track_and_nothing_is_estimated(
    sqlite_storage: Storage, without: dict[str, GeometryRecord]
) -> None:
    first = windows(1)[0]
    jumping = replace(first, distance=first.distance + 15.0 * (np.arange(len(first.valid)) > len(first.valid) // 2))
    deployed(sqlite_storage, valid_windows() | {"B": (jumping,)})
    (record,) = states(sqlite_storage, "B")
    assert record.state is WindowState.REFUSED
    assert "the position jumps once against the speed, by 15.0 m" in str(record.reason)
    before, after = without, geometries(sqlite_storage)
    for name, one in before.items():
        ours, theirs = one.geometry.rolling_radius_difference, after[name].geometry.rolling_radius_difference
        known = np.isfinite(ours.value + theirs.value)
        assert np.abs((ours.value - theirs.value)[known] / ours.std[known]).max() < 2.0


WRONG = {
    "in the wrong unit": (
        lambda t: replace(t, alignment=1e3 * t.alignment),
        "millimetres were taken for metres",
        "survey_unit",
    ),
    "shifted by 10 m": (lambda t: replace(t, s=t.s + 10.0), "too far along", "survey_displaced"),
    "mirrored": (lambda t: replace(t, alignment=-t.alignment), "mirror image", "survey_mirrored"),
    "of another section": (lambda t: replace(t, alignment=t.alignment[::-1]), "no more in common", "survey_unrelated"),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_recording_is_not_used_and_the_fleet_finds_the_track_itself(
    sqlite_storage: Storage, without: dict[str, GeometryRecord], kind: str
) -> None:
    spoil, expected, code = WRONG[kind]
    deployed(sqlite_storage, valid_windows(), spoil(surveyed()))
    with sqlite_storage.read() as unit:
        report, in_force = unit.tracks.report("S1"), unit.tracks.in_force("S1")
    assert report is not None
    verdict = str(report.report["recording"])
    assert verdict.startswith("not used: ")
    assert expected in verdict
    assert report.report["recording_code"] == code
    assert in_force is not None
    assert (in_force.source, in_force.version) == (AlignmentSource.FLEET, 2)
    same(geometries(sqlite_storage), without)


def test_a_correct_survey_is_used(sqlite_storage: Storage) -> None:
    deployed(sqlite_storage, valid_windows(), surveyed())
    with sqlite_storage.read() as unit:
        report = unit.tracks.report("S1")
    assert report is not None
    assert not str(report.report["recording"]).startswith("not used")

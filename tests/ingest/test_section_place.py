"""GNSS against the line of the section that a vehicle reports."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_reassembly import received
from test_receiver import CountingClock
from vehicle_bus import CATALOGUE, SECOND_NS, SECTION, START_NS, VEHICLE, Run, register

from estimation.errors import InputError
from estimation.jobs.estimate_windows import JUDGE
from estimation.jobs.job import JobContext
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.values.reasons import ReasonCode
from estimation.values.registry import Mounting, VehicleRecord
from estimation.values.track import SectionLine, TrackSectionRecord
from estimation.values.windows import WindowRecord, WindowState
from fleet_db.storage import SqlStorage
from ingest import catalogue as kinds
from ingest.align.clock import align_to_clock
from ingest.align.windows import MountedWindow, RegistryLookup, vehicle_samples, windows_of
from ingest.frames import merge
from ingest.plausibility import ALONG_M, FEWEST_FIXES, LIMIT_M, off_line_m, steps_m
from ingest.registry_file import load_registry

DAY_NS = 86_400 * SECOND_NS
METRES = 6_371_008.8 * np.pi / 180.0  # of a degree of a sphere: within 0.5 % of the ellipsoid
SECTION_ENTRY = {
    "code": "KM12",
    "number": SECTION,
    "name": "km 12",
    "rail_profile": "56E1",
    "rail_inclination": 0.05,
    "nominal_gauge_mm": 1435.0,
    "length_m": 2000.0,
}


def place(s: np.ndarray, aside: float = 0.0, start: tuple[float, float] = (51.5, -0.2)) -> np.ndarray:
    """Return latitude and longitude (n, 2) on a line to the north-east, or ``aside`` to its right."""
    north = (s - aside) / np.sqrt(2.0) / METRES
    east = (s + aside) / np.sqrt(2.0) / METRES / np.cos(np.deg2rad(start[0]))
    return np.column_stack([start[0] + north, (start[1] + east + 180.0) % 360.0 - 180.0])


def line(start: tuple[float, float] = (51.5, -0.2)) -> SectionLine:
    s = np.arange(0.0, 2001.0, 100.0)
    return tuple(map(tuple, np.column_stack([s, place(s, start=start)]).tolist()))


RUN = np.arange(300.0, 500.0, 20.0)


@pytest.mark.parametrize("start", [(51.5, -0.2), (-17.0, 179.995), (69.0, 18.0)])
@pytest.mark.parametrize("way", [1, -1])
def test_a_vehicle_on_its_line_is_there_with_noise_outliers_and_tunnels(start: tuple[float, float], way: int) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        fixes = place(RUN, start=start) + rng.normal(0.0, 10.0 / METRES, (len(RUN), 2))
        fixes[2] += 0.02  # 2 km
        fixes[5] = np.nan
        fixes[6] = 0.0
        assert off_line_m(line(start), RUN[::way], fixes[::way]) == 0.0


@pytest.mark.parametrize("start", [(51.5, -0.2), (-17.0, 179.995)])
def test_a_parallel_line_300_m_away_is_another_one(start: tuple[float, float]) -> None:
    assert off_line_m(line(start), RUN, place(RUN, 300.0, start)) == pytest.approx(300.0, rel=0.01)


def test_exchanged_coordinates_are_far_away() -> None:
    assert off_line_m(line(), RUN, place(RUN)[:, ::-1]) > 1e6


def test_without_fixes_or_beyond_the_points_nothing_is_said() -> None:
    off = place(RUN, 300.0)
    for missing in (np.nan, 0.0):
        assert off_line_m(line(), RUN, np.full_like(off, missing)) == 0.0
    assert off_line_m(line(), RUN + 5000.0, off) == 0.0
    assert off_line_m(line(), np.full_like(RUN, np.nan), off) == 0.0
    few = off.copy()
    few[FEWEST_FIXES - 1 :] = np.nan
    assert off_line_m(line(), RUN, few) == 0.0
    few[FEWEST_FIXES - 1] = off[FEWEST_FIXES - 1]
    assert off_line_m(line(), RUN, few) > 0.0


def test_the_limits_are_50_m_aside_and_200_m_along() -> None:
    assert (LIMIT_M, ALONG_M, FEWEST_FIXES) == (50.0, 200.0, 3)
    assert off_line_m(line(), RUN, place(RUN, 48.0)) == 0.0
    assert off_line_m(line(), RUN, place(RUN, 52.0)) > 0.0
    assert off_line_m(line(), RUN + 240.0, place(RUN)) == 0.0
    assert off_line_m(line(), RUN + 260.0, place(RUN)) == pytest.approx(60.0, abs=3.0)


def off_lines(lines: dict[str, SectionLine], fixes: np.ndarray | None, run: Run) -> list[float]:
    changes = {} if fixes is None else {(kinds.PLACE, 16): {"latitude": fixes[:, 0], "longitude": fixes[:, 1]}}
    batch = merge([replace(run, changes=changes).frames()])
    samples, _ = vehicle_samples(VEHICLE, CATALOGUE, align_to_clock(CATALOGUE, batch).messages)
    record = VehicleRecord(VEHICLE, "north", "multiple unit", 2, 40.0, (2.0, 4.5))
    mounted = tuple(Mounting(f"WS-{axle}", VEHICLE, axle, 0, None, 0.0, 0.0) for axle in (1, 2))
    start = run.start_ns // (10 * SECOND_NS) * 10 * SECOND_NS
    found = windows_of(
        samples,
        range(start, start + 30 * SECOND_NS, 10 * SECOND_NS),
        10 * SECOND_NS,
        RegistryLookup(record, mounted, {SECTION: "KM12"}, lines),
    )
    return [window.off_line_m for window in found if isinstance(window, MountedWindow)]


def test_windows_from_frames_are_compared_where_both_are_known() -> None:
    run = Run(seconds=25.0)
    s = run.distance + run.metres()
    assert off_lines({"KM12": line()}, place(s), run) == [0.0] * 6
    assert off_lines({"KM12": line()}, place(s, 300.0), run) == pytest.approx([300.0] * 6, rel=0.01)
    assert off_lines({"KM12": line()}, None, run) == [0.0] * 6
    assert off_lines({"KM13": line()}, place(s, 300.0), run) == [0.0] * 6


def registry(folder: Path, rows: np.ndarray | None, **changes: object) -> Path:
    entry = SECTION_ENTRY | changes
    if rows is not None:
        lines = ["s_m,latitude_deg,longitude_deg", *(",".join(f"{value:.8f}" for value in row) for row in rows)]
        (folder / "line.csv").write_text("\n".join(lines))
        entry = entry | {"coordinates": {"file": "line.csv"}}
    path = folder / "registry.json"
    path.write_text(json.dumps({"format": "treadwatch-registry-1", "track_sections": [entry]}))
    return path


def load(storage: SqlStorage, path: Path) -> None:
    with storage.write() as unit:
        load_registry(path, unit, 1)


def test_a_line_is_stored_once_changed_and_taken_away(storage: SqlStorage, tmp_path: Path) -> None:
    for rows, events in ((np.array(line()), 0), (np.array(line()), 0), (np.array(line((51.6, -0.2))), 1), (None, 2)):
        load(storage, registry(tmp_path, rows))
        with storage.read() as unit:
            stored = unit.tracks.section("KM12").line
            assert len(unit.registry_history.list("KM12")) == events
        if rows is None:
            assert stored is None
        else:
            assert stored is not None
            assert np.allclose(np.array(stored), rows, atol=1e-8)
            assert steps_m(stored) == pytest.approx([100.0] * 20, rel=0.01)


def shifted(row: int, column: int, by: float) -> np.ndarray:
    rows = np.array(line())
    rows[row:, column] += by
    return rows


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (shifted(0, 1, 40.0), "beyond 90 degrees"),
        (shifted(0, 2, 200.0), "beyond 180 degrees"),
        (shifted(0, 0, 100.0), "has 0 to 2000 m"),
        (shifted(0, 0, -100.0), "has 0 to 2000 m"),
        (shifted(9, 1, 0.002), "m apart on the map"),
        (shifted(15, 0, 0.0)[[0, 1, 2, 6, 7]], "at most 200 m may be"),
        (np.array(line())[:, [0, 2, 1]], "133 m apart on the map"),
        (np.array(line()) * [0.5, 1.0, 1.0], "apart on the map|long on the map"),
        (np.array(line())[:1], "at least 2"),
    ],
)
def test_a_line_that_contradicts_itself_is_refused(
    sqlite_storage: SqlStorage, tmp_path: Path, rows: np.ndarray, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        load(sqlite_storage, registry(tmp_path, rows))
    with sqlite_storage.read() as unit:
        assert unit.tracks.sections() == []


def at(run: Run, aside: float) -> Run:
    fixes = place(run.distance + run.metres(), aside)
    return replace(run, changes={(kinds.PLACE, 16): {"latitude": fixes[:, 0], "longitude": fixes[:, 1]}, **run.changes})


def refused(storage: SqlStorage) -> list[int]:
    """Judge what is new; return the starts of the windows whose place is not believed."""
    run(JUDGE, JobContext(storage, CountingClock(), "test", JobSettings()))
    with storage.read() as unit:
        windows = unit.windows.list("WS-1")
        assert unit.plausibility.left_out("WS-1", 0) == (
            {ReasonCode.PLACE_IMPLAUSIBLE: len([w for w in windows if w.implausible])} if refusals(windows) else {}
        )
        assert all((w.state is WindowState.REFUSED) == (w.implausible is not None) for w in windows)
    return refusals(windows)


def refusals(windows: Sequence[WindowRecord]) -> list[int]:
    return [window.start_ns for window in windows if window.implausible is not None]


def test_a_wrong_section_is_refused_until_its_line_or_number_is_corrected(storage: SqlStorage, tmp_path: Path) -> None:
    """Two runs a week apart: on the section, and with the number of another, 300 m from it."""
    there = at(Run(), 0.0)
    changes = {(kinds.POSITION, 16): {"track_section": SECTION + 1}}
    elsewhere = replace(at(replace(Run(), start_ns=START_NS + 7 * DAY_NS, odometer=5_001_000.0), 300.0))
    elsewhere = replace(elsewhere, changes={**elsewhere.changes, **changes})
    with storage.write() as unit:
        register(unit)
        for code, number in (("KM12", SECTION), ("KM13", SECTION + 1)):
            unit.tracks.add_section(TrackSectionRecord(code, number, code, "56E1", 0.05, 1.435, 2000.0, line()))
    receiver = received(storage, tmp_path, [there.frames(), elsewhere.frames()])
    assert len(wrong := refused(storage)) == 3
    assert min(wrong) > START_NS + 6 * DAY_NS
    s = np.arange(0.0, 2001.0, 100.0)
    right = tuple(map(tuple, np.column_stack([s, place(s, 300.0)]).tolist()))
    with storage.write() as unit:
        unit.tracks.add_section(replace(unit.tracks.section("KM13"), line=right))
        (span,) = unit.stale_spans.all()
        assert (span.from_ns, span.to_ns) == (min(wrong), max(wrong) + 10 * SECOND_NS)
        assert (span.vehicle, span.cause) == (VEHICLE, "coordinates of track section KM13")
    receiver.reassembler.work_off()
    assert refused(storage) == []
    with storage.write() as unit:  # nobody ran on another number: the windows on it alone are made again
        unit.tracks.add_section(replace(unit.tracks.section("KM12"), number=SECTION + 2))
        (span,) = unit.stale_spans.all()
        assert (span.to_ns, span.cause) < (START_NS + DAY_NS, "number of track section KM12 ")
    receiver.reassembler.work_off()
    with storage.read() as unit:
        found = {window.start_ns > START_NS + DAY_NS: window.track_section for window in unit.windows.list("WS-1")}
    assert found == {False: None, True: "KM13"}
    with storage.write() as unit:
        unit.tracks.add_section(replace(unit.tracks.section("KM12"), number=SECTION))
        assert len(unit.stale_spans.all()) == 1  # those on no section may have sent it
    receiver.reassembler.work_off()
    with storage.read() as unit:
        assert {window.track_section for window in unit.windows.list("WS-1")} == {"KM12", "KM13"}

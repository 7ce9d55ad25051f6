"""A small fleet on a real store, its windows stored by runs, and the jobs run on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from paper_class import paper_class
from section_runs import RUNS, windows
from smooth_wheelset import alignment, track

from bench.standing_clock import StandingClock
from estimation.jobs.catalogue import job_named
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import JobRun, JobTrigger
from estimation.values.track import TrackAlignment, TrackReport, TrackSectionRecord
from estimation.values.windows import Window

LENGTH = 2900.0
DAY_NS = 86_400 * 10**9
QUIET = {"estimated": 0, "refused": 0, "changed_meanwhile": 0, "requeued": 0, "quarantined": 0}
NAMES = [f"W{number}" for number in range(len(RUNS))]


def register(storage: Storage, sections: Sequence[str] = ("S1",)) -> None:
    with storage.write() as unit:
        unit.registry.add_vehicle_class(paper_class("metro"), 1)
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
        job,
        JobContext(storage, StandingClock(10**15), "test", settings or JobSettings(), stopping=stopping),
        JobTrigger.CLI,
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

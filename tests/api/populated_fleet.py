"""The fleet of ``api_fleet``, stored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.put_values import put_geometry, put_trend
from estimation.storage import Storage, UnitOfWork
from estimation.values.opinions import GEAR_DAMPERS, SECTION_RAILS, WHEELSET_RAILS, part_of_gear
from estimation.values.quantities import Status
from estimation.values.registry import FleetRecord, VehicleRecord
from estimation.values.runs import JobOutcome, JobTrigger, Result
from estimation.values.signatures import ANSWERS
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord
from ingest.vehicle_class_schema import shipped_class
from tests.api.api_fleet import (
    DAY,
    RECORDED,
    SECOND,
    START,
    WHEELSETS,
    WINDOWS,
    gear_dampers,
    geometry_record,
    measured,
    quarantined,
    raised,
    section_rails,
    signature_record,
    suspension_findings,
    track_report,
    trend_record,
    wheelset,
    wheelset_rails,
    window,
)


def _put_dampers(unit: UnitOfWork) -> None:
    for damper in gear_dampers():
        result = Result(damper.vehicle, "d" * 64, "1", RECORDED, damper, part_of_gear(damper.first_axle))
        unit.results.put_all(GEAR_DAMPERS, [result])


def _put_sections(unit: UnitOfWork) -> None:
    for number in (1, 2, 3):
        section = TrackSectionRecord(f"S-{number}", number, "by the river", "56E1", 0.05, 1.435, 5000.0)
        unit.tracks.add_section(section)
    deviations = np.array([1.5, -2.0, 0.25, 0.0]) * 1e-3
    std = np.full(4, 0.5e-3)
    passes = np.array([0, 0, 1, 2])
    status = Status.ESTIMATED
    known = TrackAlignment("S-1", 0, np.arange(4) * 0.5, deviations, std, -deviations, std, passes, status)
    unit.tracks.add_alignment(known)
    found = replace(
        known,
        section="S-3",
        source=AlignmentSource.FLEET,
        cutoff_wavelength=60.0,
        scale_std=0.0125,
        gauge_known=False,
    )
    for version, same_since in ((1, None), (2, 1), (3, 1)):
        found = replace(found, alignment=found.alignment * 0.5)
        unit.tracks.add_alignment(found, same_since=same_since, recorded_ns=RECORDED + version)
    unit.tracks.add_report(track_report("S-3", 3, Status.ESTIMATED))
    unit.tracks.add_report(track_report("S-2", None, Status.UNESTIMATED))


def populate(storage: Storage) -> None:
    """Store everything."""
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("alpha", "Alpha railway"))
        unit.registry.add_vehicle_class(replace(shipped_class("coach"), code="regional"), RECORDED)
        unit.registry.add_fleet(FleetRecord("=beta", "=1+1"))
        for number in range(3):
            offsets = (0.0, 2.5, 17.0, 19.5)
            unit.registry.add_vehicle(VehicleRecord(f"V-{number}", "alpha", "regional", 4, 44.5, offsets))
        for number in range(len(WHEELSETS)):
            unit.registry.add_wheelset(wheelset(number))
        for days in (5, 9, 12):
            unit.registry.add_measured_profiles(measured(START + days * DAY))
        _put_sections(unit)
        for index in range(WINDOWS):
            unit.windows.put(window(index), 9000.0 + index, RECORDED + index)
        put_geometry(unit, geometry_record(RECORDED, 0.1875))
        put_geometry(unit, geometry_record(RECORDED + DAY, 0.25))
        put_trend(unit, trend_record(RECORDED, 0.1875))
        put_trend(unit, trend_record(RECORDED + DAY, 0.25))
        unit.results.put_all(ANSWERS, [signature_record()])
        _put_dampers(unit)
        for finding in suspension_findings():
            unit.suspensions.put(finding)
        unit.results.put_all(SECTION_RAILS, [section_rails()])
        unit.results.put_all(WHEELSET_RAILS, [wheelset_rails()])
    for serial in WHEELSETS[:10]:
        raised(storage, serial, fleet="alpha" if int(serial[-1]) % 2 == 0 else "=beta")
    raised(storage, WHEELSETS[0], "no_data")
    with storage.write() as unit:
        for item in quarantined():
            unit.quarantine.put(item)
    for number in range(7):
        with storage.write() as unit:
            run = unit.jobs.start("estimate_windows", JobTrigger.SCHEDULE, RECORDED + number)[0]
            unit.jobs.finish(
                run.run_id,
                JobOutcome.SUCCEEDED,
                {"estimated": number},
                RECORDED + number + SECOND // 2,
            )

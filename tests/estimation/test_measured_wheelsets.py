"""Measured profiles in the registry become evidence of the alignment job, as long as they are those of the wheelset."""

from __future__ import annotations

import numpy as np
import pytest
from alignment_job import DAY_NS, counts, in_force, put, register, report
from one_database import on_sqlite
from sqlalchemy import update

from estimation.accuracy.wheel_contact import wheel_contact
from estimation.contact.profiles import MeasuredProfiles, Profile, wheel_profile
from estimation.jobs.steps.measured_wheelsets import ComparisonReader, rests_on
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.registry import Reprofiling
from estimation.values.track import TrackSectionRecord
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.registry import MeasuredProfilesRow

STD = 0.1e-3  # m


def one_wheelset_three_times(storage: SqlStorage) -> None:
    register(storage)
    for day in (1, 2, 3):
        put(storage, [0], day=day)


def measure(storage: SqlStorage, *, mileage_km: float = 10.0, at_ns: int = 0, wheel: Profile | None = None) -> None:
    left = wheel if wheel is not None else wheel_profile("P8")
    with storage.write() as unit:
        unit.registry.add_measured_profiles(MeasuredProfiles("W0", at_ns, mileage_km, left, wheel_profile("P8"), STD))


def test_a_wheelset_that_has_been_measured_can_be_read_alone(storage: SqlStorage) -> None:
    one_wheelset_three_times(storage)
    counts(storage, "refresh_alignment")
    assert code_of(report(storage).reason) is ReasonCode.SINGLE_WHEELSET
    measure(storage)
    counts(storage, "refresh_alignment")  # the same windows, but more is known
    track_report = report(storage)
    assert track_report.status is Status.ESTIMATED
    assert track_report.report["evidence"] == ["measured profiles of W0 of 1970-01-01"]
    found = in_force(storage)
    known = np.isfinite(found.alignment_std)
    assert known.any()
    assert (found.alignment_std[known] > 0.9 * STD).all()
    assert counts(storage, "estimate_windows")["estimated"] > 0
    assert counts(storage, "refresh_alignment")["unchanged"] == 1


@on_sqlite
@pytest.mark.parametrize("case", ["long ago", "before the lathe"])
def test_profiles_that_the_wheelset_has_no_longer_say_nothing(storage: SqlStorage, case: str) -> None:
    one_wheelset_three_times(storage)
    measure(storage, mileage_km=-2000.0 if case == "long ago" else 10.0)
    if case == "before the lathe":
        with storage.write() as unit:
            unit.registry.add_reprofiling(Reprofiling("W0", DAY_NS // 2, 10.2))
    counts(storage, "refresh_alignment")
    track_report = report(storage)
    assert code_of(track_report.reason) is ReasonCode.SINGLE_WHEELSET
    assert track_report.report["evidence"] == []


@on_sqlite
def test_profiles_that_cannot_be_used_are_reported(storage: SqlStorage) -> None:
    one_wheelset_three_times(storage)
    with storage.write() as unit:
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "99E9", 0.05, 1.435, 2900.0))
    measure(storage)
    counts(storage, "refresh_alignment")
    (refusal,) = report(storage).report["evidence"]  # type: ignore[misc]
    assert str(refusal).startswith("measured profiles of W0 of 1970-01-01 are not used: ")
    assert "99E9" in str(refusal)


@on_sqlite
def test_a_damaged_measurement_is_reported_and_the_section_goes_on(storage: SqlStorage) -> None:
    one_wheelset_three_times(storage)
    measure(storage)
    with storage.engine.begin() as connection:
        connection.execute(update(table_of(MeasuredProfilesRow)).values(packed=b"damaged"))
    counts(storage, "refresh_alignment")
    track_report = report(storage)
    assert code_of(track_report.reason) is ReasonCode.SINGLE_WHEELSET
    (note,) = track_report.report["evidence"]  # type: ignore[misc]
    assert "W0" in str(note)


@on_sqlite
def test_an_estimate_on_an_alignment_that_a_measurement_has_made_is_no_check_of_it(storage: SqlStorage) -> None:
    one_wheelset_three_times(storage)
    measure(storage)
    for job in ("refresh_alignment", "estimate_windows", "refresh_geometry"):
        counts(storage, job)
    wheel = wheel_profile("P8")
    elsewhere = MeasuredProfiles("W1", 0, 10.0, wheel, wheel, STD)
    with storage.write() as unit:
        unit.registry.add_measured_profiles(elsewhere)
    with storage.read() as unit:
        (record, *_) = unit.geometries.intervals("W0")
        (own,) = unit.registry.measured_profiles("W0")
        assert rests_on(unit, record, [own])
        assert not rests_on(unit, record, [elsewhere]), "the alignment was found without it"
        (found,) = ComparisonReader(unit, wheel_contact, 1000.0).of_wheelset(unit.registry.wheelset("W0"), [own])
    assert found.independent is False
    assert not isinstance(found.contact, Reason)
    assert [one.rail for one in found.contact.rails] == ["56E1"]

"""Another estimator is chosen after the samples were purged: the former geometry stays, and says so."""

from __future__ import annotations

import pytest
from alignment_job import NAMES, counts, put, register, surveyed
from one_database import on_sqlite
from sqlalchemy import update

from estimation.jobs.settings import EstimationSettings, JobSettings
from estimation.storage import Storage
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from fleet_db.models import WindowRow
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage

SERIAL = NAMES[0]


@pytest.fixture
def received(storage: Storage) -> Storage:
    register(storage, ("S1",))
    with storage.write() as unit:
        unit.tracks.add_alignment(surveyed())
    put(storage, (0, 1))
    counts(storage, "estimate_windows")
    return storage


def purge(storage: SqlStorage) -> None:
    with storage.write() as unit:
        unit.connection.execute(update(table_of(WindowRow)).values(samples_purged_ns=1))


def refreshed(storage: Storage, estimator: str) -> list[GeometryRecord]:
    """Return the geometries of a wheelset after a run: of the interval, and the current one."""
    counts(storage, "refresh_geometry", JobSettings(estimation=EstimationSettings(estimator=estimator)))
    with storage.read() as unit:
        current = unit.geometries.current(SERIAL)
        assert current is not None
        return [*unit.geometries.intervals(SERIAL), current]


def stale(storage: Storage, estimator: str) -> bool:
    with storage.read() as unit:
        return bool(unit.geometries.stale(10, "" if estimator == "bins" else estimator))


def test_the_former_geometry_stays_with_its_reason_and_is_looked_at_once(received: SqlStorage) -> None:
    before = refreshed(received, "bins")
    purge(received)
    after = refreshed(received, "cubic")
    assert len(after) == len(before) == 2
    for old, new in zip(before, after, strict=True):
        assert new.geometry.equivalent_conicity == old.geometry.equivalent_conicity
        assert new.geometry.equivalent_conicity.value is not None
        assert new.geometry.parameter_key == old.geometry.parameter_key
        assert new.parameters == old.parameters
        assert new.geometry.reason is not None
        assert new.geometry.reason.code is ReasonCode.SAMPLES_PURGED
        assert new.geometry.windows == old.geometry.windows
    assert not stale(received, "cubic")
    with received.read() as unit:
        numbers = unit.geometries.newest_numbers()
    refreshed(received, "cubic")
    with received.read() as unit:
        assert unit.geometries.newest_numbers() == numbers
    assert stale(received, "bins")
    assert [one.geometry.reason for one in refreshed(received, "bins")] == [one.geometry.reason for one in before]
    assert not stale(received, "bins")


@on_sqlite
def test_without_a_former_geometry_there_is_none_and_that_is_why(received: SqlStorage) -> None:
    purge(received)
    for one in refreshed(received, "cubic"):
        assert one.geometry.equivalent_conicity.value is None
        assert one.geometry.status is Status.UNESTIMATED
        assert one.geometry.reason is not None
        assert one.geometry.reason.code is ReasonCode.SAMPLES_PURGED


@on_sqlite
def test_windows_that_have_samples_give_the_geometry_of_the_new_estimator(received: SqlStorage) -> None:
    refreshed(received, "bins")
    for one in refreshed(received, "cubic"):
        assert one.geometry.parameter_key.endswith(" cubic")
        assert one.geometry.reason is None or one.geometry.reason.code is not ReasonCode.SAMPLES_PURGED

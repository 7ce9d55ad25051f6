"""A recording that is rejected raises an alert of its vehicle, until it is decoded or set aside."""

from __future__ import annotations

from pathlib import Path

import pytest
from vehicle_bus import SECOND_NS, START_NS, VEHICLE, Run, register

from api.factory import SystemClock
from estimation.jobs import evaluate_alerts
from estimation.jobs.job import JobContext
from estimation.jobs.settings import JobSettings
from estimation.values.alerts import Alert
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState, RecordingAction
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.corrections import Author, RecordingCorrections
from ingest.logs import write_blf
from ingest.receiver import Receiver

AUTHOR = Author("j.smith", "a test")


class SlowClock:
    def now_ns(self) -> int:
        return START_NS - 3 * 86_400 * SECOND_NS


def evaluated(storage: SqlStorage) -> list[Alert]:
    """Evaluate the rules and return the open alerts of this kind."""
    evaluate_alerts.run(JobContext(storage, SystemClock(), "test", JobSettings()))
    with storage.read() as unit:
        return [alert for alert in unit.alerts.all_open() if alert.kind == "data_quality"]


@pytest.fixture
def receiver(sqlite_storage: SqlStorage, tmp_path: Path) -> Receiver:
    with sqlite_storage.write() as unit:
        register(unit)
    return Receiver(
        sqlite_storage, FileRawStore(tmp_path / "raw"), default_catalogue(), SystemClock(), window_length_s=10.0
    )


def rejected(storage: SqlStorage, receiver: Receiver, path: Path) -> str:
    list(receiver.receive_files([(path, VEHICLE)]))
    with storage.read() as unit:
        (record,) = unit.chunks.with_state(ChunkState.REJECTED)
    return record.digest


def test_it_is_one_alert_at_the_first_axle_and_ends_when_it_is_set_aside(
    sqlite_storage: SqlStorage, receiver: Receiver, tmp_path: Path
) -> None:
    assert evaluated(sqlite_storage) == []
    path = tmp_path / f"{VEHICLE}__a.blf"
    path.write_bytes(b"LOGG" + bytes(400))
    digest = rejected(sqlite_storage, receiver, path)
    (alert,) = evaluated(sqlite_storage)
    with sqlite_storage.read() as unit:
        mounted = [wheelset.mounting for wheelset in unit.registry.wheelsets() if wheelset.mounting is not None]
        (own,) = [mounting for mounting in mounted if mounting.wheelset == alert.wheelset]
    assert own.axle == min(mounting.axle for mounting in mounted if mounting.vehicle == VEHICLE)
    assert alert.condition == "active"
    assert (alert.evidence["rejected_recordings"], alert.evidence["rejected_reasons"]) == (1, {"log_damaged": 1})
    assert evaluated(sqlite_storage) == [alert]
    RecordingCorrections(sqlite_storage, SystemClock()).correct(digest, RecordingAction.SET_ASIDE, AUTHOR)
    assert evaluated(sqlite_storage) == []


def test_it_ends_when_the_recording_is_decoded(sqlite_storage: SqlStorage, receiver: Receiver, tmp_path: Path) -> None:
    path = tmp_path / f"{VEHICLE}__a.blf"
    write_blf(path, Run().frames())
    slow = Receiver(
        sqlite_storage, FileRawStore(tmp_path / "raw"), default_catalogue(), SlowClock(), window_length_s=10.0
    )
    digest = rejected(sqlite_storage, slow, path)
    assert len(evaluated(sqlite_storage)) == 1
    corrections = RecordingCorrections(sqlite_storage, SystemClock())
    corrections.correct(digest, RecordingAction.RETRY, AUTHOR, our_clock_was_behind=True)
    list(receiver.decode_stored())
    assert evaluated(sqlite_storage) == []

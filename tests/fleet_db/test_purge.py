"""A purge deletes what has been kept long enough, and nothing that the present state or a kept `as_of` needs."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy
import stored_values as make
from stored_raw import raw_of

from bench.put_values import put_geometry, put_trend
from estimation.errors import ConflictError, ParameterError
from estimation.values.runs import JobOutcome, JobTrigger
from estimation.values.units import DAY_NS
from fleet_db.atomic_files import unlink_old
from fleet_db.keeping import purge as purge_module
from fleet_db.keeping.checks import check_deep
from fleet_db.keeping.kept_files import LEAST_AGE_S, orphaned_recordings, orphaned_samples
from fleet_db.keeping.purge import Purged, purge, purged_before
from fleet_db.keeping.retention import Kept, Retention
from fleet_db.locks import keeping_alone
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState, Delivery, DeliveryState, Failure, Webhook, WebhookState
from fleet_db.storage import SqlStorage
from fleet_db.tables.recordings import PurgeRow

NOW = 2_000 * DAY_NS
NOTHING = dict.fromkeys((kind.value for kind in Kept), None)


def purged(storage: SqlStorage, **days: float) -> dict[str, int]:
    """Return how many items of each kind a purge deletes that keeps only some kinds not for ever."""
    done = purge(storage, raw_of(storage), Retention(**(NOTHING | days)), NOW, lambda: None)
    return {one.kind.value: one.items for one in done}


def left_over(storage: SqlStorage) -> list[Path]:
    """Return what no row refers to, of windows and recordings."""
    return [*orphaned_samples(storage), *(Path(one.place) for one in orphaned_recordings(storage, raw_of(storage)))]


def test_runs_go_but_the_newest_of_each_outcome(fleet: SqlStorage) -> None:
    outcomes = [JobOutcome.SUCCEEDED, JobOutcome.FAILED, JobOutcome.SUCCEEDED, JobOutcome.FAILED, JobOutcome.SUCCEEDED]
    with fleet.write() as unit:
        for day, outcome in enumerate(outcomes):
            run = unit.jobs.start("refresh_trends", JobTrigger.SCHEDULE, day * DAY_NS)[0]
            unit.jobs.finish(run.run_id, outcome, {}, day * DAY_NS + 1)
        unit.jobs.start("refresh_trends", JobTrigger.SCHEDULE, 0)  # it runs still
    assert purged(fleet, job_runs=2000.5) == {"job_runs": 0}
    assert purged(fleet, job_runs=1998.5) == {"job_runs": 1}
    assert purged(fleet, job_runs=10.0, failed_job_runs=10.0) == {"job_runs": 1, "failed_job_runs": 1}
    with fleet.read() as unit:
        left = [unit.jobs.get(number).outcome for number in (4, 5, 6)]
    assert left == [JobOutcome.FAILED, JobOutcome.SUCCEEDED, JobOutcome.RUNNING]


def test_what_was_sent_goes_but_not_what_waits_to_be_sent_again(fleet: SqlStorage) -> None:
    none: frozenset[str] = frozenset()
    webhook = Webhook(0, "https://r.example/", "", none, none, none, None, WebhookState.ACTIVE, None, 1, 1, "a test", 0)
    one = Delivery(0, 1, 1, "id", "raised", 1, 1, DeliveryState.DELIVERED, 1, DAY_NS, DAY_NS, None, 204, None, None)
    waits = replace(one, sequence=2, state=DeliveryState.WAITING, next_ns=NOW, status_code=500, failure=Failure.STATUS)
    with fleet.write() as unit:
        webhook = unit.webhooks.add(webhook, "whsec_c2VjcmV0")
        for delivery in (replace(one, webhook_id=webhook.webhook_id), replace(waits, webhook_id=webhook.webhook_id)):
            assert unit.webhooks.attempted(unit.webhooks.get(webhook.webhook_id), delivery, None)
    assert purged(fleet, webhook_deliveries=1999.5) == {"webhook_deliveries": 0}
    assert purged(fleet, webhook_deliveries=30.0) == {"webhook_deliveries": 1}
    with fleet.read() as unit:
        assert unit.webhooks.get(webhook.webhook_id).position == 1
        assert [found.state for found in unit.webhooks.deliveries(webhook.webhook_id, None, 9)] == [
            DeliveryState.WAITING
        ]


def test_estimates_that_were_replaced_go_and_as_of_stays_true(fleet: SqlStorage) -> None:
    times = [1, 100, 1500, 1990]
    with fleet.write() as unit:
        for seed, day in enumerate(times):
            put_geometry(unit, make.geometry_record(seed, day * DAY_NS))
            put_geometry(unit, make.geometry_record(seed + 50, day * DAY_NS, interval=3))
    asked = [1270 * DAY_NS, 1600 * DAY_NS, NOW]
    with fleet.read() as unit:
        before = [
            (unit.geometries.current("WS-1", at), tuple(unit.geometries.intervals("WS-1", 0, at))) for at in asked
        ]
    assert purged(fleet, superseded_estimates=730.0) == {"superseded_estimates": 2}  # both of the first day
    with fleet.read() as unit:
        after = [(unit.geometries.current("WS-1", at), tuple(unit.geometries.intervals("WS-1", 0, at))) for at in asked]
        assert make.same(tuple(after), tuple(before))
        assert unit.geometries.current("WS-1", 50 * DAY_NS) is None
        assert purged_before(unit.connection, Kept.SUPERSEDED_ESTIMATES) == NOW - 730 * DAY_NS
        assert purged_before(unit.connection, Kept.JOB_RUNS) is None
    assert purged(fleet, superseded_estimates=730.0) == {"superseded_estimates": 0}


def test_trends_that_were_replaced_go(fleet: SqlStorage) -> None:
    from estimation.values.trend import TrendRecord  # noqa: PLC0415 - of this test alone

    with fleet.write() as unit:
        for seed, day in enumerate((1, 2, 1999)):
            put_trend(unit, TrendRecord("WS-1", 0, make.trend(seed), f"{seed:064x}", "1", day * DAY_NS))
    assert purged(fleet, superseded_estimates=100.0) == {"superseded_estimates": 1}
    with fleet.read() as unit:
        assert unit.trends.latest("WS-1", NOW - 100 * DAY_NS) is not None


def test_of_each_old_day_the_last_estimate_stays(fleet: SqlStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(purge_module, "BATCH", 4)
    hour = DAY_NS // 24
    with fleet.write() as unit:
        for seed, at in enumerate(day * DAY_NS + n * hour for day in (1900, 1901, 1969, 1999) for n in (1, 9, 23)):
            put_geometry(unit, make.geometry_record(seed, at))
            put_geometry(unit, make.geometry_record(seed + 50, at, interval=3))
            put_trend(unit, make.trend_record(seed, at))
    ends = [day * DAY_NS - 1 for day in (1901, 1902, 1930, 1970, 2000)]

    def seen() -> tuple[object, ...]:
        with fleet.read() as unit:
            return tuple(
                (unit.geometries.current("WS-1", at), *unit.geometries.intervals("WS-1", 0, at), trend)
                for at in ends
                for trend in [unit.trends.latest("WS-1", at)]
            )

    before = seen()
    assert purged(fleet, every_estimate=30.5) == {"every_estimate": 3 * 2 * 2}  # of two whole days; 1969 is not over
    assert make.same(seen(), before)
    assert purged(fleet, every_estimate=30.5) == {"every_estimate": 0}
    with fleet.read() as unit:
        assert purged_before(unit.connection, Kept.EVERY_ESTIMATE) == 1969 * DAY_NS
    assert purged(fleet, every_estimate=29.0) == {"every_estimate": 3 * 2}
    assert make.same(seen(), before)
    assert Retention().every_estimate == 31.0


def test_a_purge_works_in_batches_with_a_record_of_each(fleet: SqlStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(purge_module, "BATCH", 3)
    with fleet.write() as unit:
        for number in range(7):
            unit.idempotency.put(f"key-{number}", "d" * 64, 200, "{}", number)
    stops = iter([None, None, KeyboardInterrupt])

    def checkpoint() -> None:
        if (stop := next(stops)) is not None:
            raise stop

    with pytest.raises(KeyboardInterrupt):
        purge(fleet, raw_of(fleet), Retention(**(NOTHING | {"idempotency_keys": 7.0})), NOW, checkpoint)
    assert purged(fleet, idempotency_keys=7.0) == {"idempotency_keys": 1}
    with fleet.read() as unit:
        purges = PurgeRow.table.c
        rows = unit.connection.scalars(sqlalchemy.select(purges["items"]).order_by(purges.purge_id)).all()
    assert rows == [3, 3, 1]


def test_files_of_replaced_windows_go(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.windows.put(make.window(0), 100.0, 1)
        unit.windows.put(make.window(0, seed=5), 100.0, 2)
    lost = FileRawStore(fleet.data_dir / "raw").put_bytes(b"of a newer database", ".blf")
    left = fleet.data_dir / "windows" / "ab" / ".writing-x"
    left.parent.mkdir(exist_ok=True)
    left.write_bytes(b"killed")
    (fleet.data_dir / "raw" / ".incoming-y").write_bytes(b"killed")
    assert left_over(fleet) == []  # all of them are young
    for path in fleet.data_dir.rglob("*"):
        os.utime(path, (1e9, 1e9))
    assert len(left_over(fleet)) == 4
    assert purged(fleet, orphaned_files=1.0) == {"orphaned_files": 3}
    assert [path.name for path in left_over(fleet)] == [f"{lost}.blf"]  # a recording is never an orphan to delete
    with fleet.read() as unit:
        assert make.same(unit.windows.load("WS-1", make.START), make.window(0, seed=5))


def test_a_file_that_a_window_takes_up_again_is_young(fleet: SqlStorage) -> None:
    """Between its content's being used again and the commit of its row no purge deletes it."""
    window = make.window(0)
    with fleet.write() as unit:
        unit.windows.put(window, 100.0, 1)
        unit.windows.put(make.window(0, seed=5), 100.0, 2)
    for path in fleet.data_dir.rglob("*.window"):
        os.utime(path, (1e9, 1e9))
    (orphan,) = orphaned_samples(fleet)
    with fleet.write() as unit:
        unit.windows.put(window, 100.0, 3)
        assert unlink_old(fleet.data_dir / orphan, LEAST_AGE_S) is None
    with fleet.read() as unit:
        assert make.same(unit.windows.load("WS-1", make.START), window)
    assert unlink_old(fleet.data_dir / orphan, -60.0) is not None
    assert unlink_old(fleet.data_dir / orphan, -60.0) is None


def test_raw_files_of_old_recordings_go_and_their_receipts_stay(fleet: SqlStorage) -> None:
    raw = FileRawStore(fleet.data_dir / "raw")
    digests = [raw.put_bytes(bytes([number]) * 10, ".blf") for number in range(4)]
    states = [ChunkState.DECODED, ChunkState.DECODED, ChunkState.STORED, ChunkState.REJECTED]
    days = [1, 1990, 1, 1]
    with fleet.write() as unit:
        for digest, state, day in zip(digests, states, days, strict=True):
            unit.chunks.put(replace(make.CHUNK, digest=digest, size_bytes=10, state=state, received_ns=day * DAY_NS,
                                    first_ns=NOW - 1, last_ns=NOW))  # fmt: skip
    assert purged(fleet, recordings=31.0) == {"recordings": 1}
    assert [raw.path(digest, ".blf").is_file() for digest in digests] == [False, True, True, True]
    with fleet.read() as unit:
        assert unit.chunks.purged() == {digests[0]}
        found = unit.chunks.get(digests[0])
    assert found is not None
    assert (found.state, found.purged_ns) == (ChunkState.DECODED, NOW)
    assert check_deep(fleet, raw_of(fleet), lambda _done, _total: None).findings == ()
    raw.put_bytes(bytes([0]) * 10, ".blf")  # as by a process that was killed between row and file
    os.utime(raw.path(digests[0], ".blf"), (1e9, 1e9))
    assert purged(fleet, orphaned_files=1.0) == {"orphaned_files": 1}


def test_a_clock_of_ours_that_is_400_days_ahead_makes_no_data_old(fleet: SqlStorage) -> None:
    raw = FileRawStore(fleet.data_dir / "raw")
    digest = raw.put_bytes(b"a recording", ".blf")
    right = NOW - 400 * DAY_NS
    with fleet.write() as unit:
        unit.chunks.put(replace(make.CHUNK, digest=digest, state=ChunkState.DECODED, received_ns=right - 300 * DAY_NS,
                                first_ns=right - 1, last_ns=right))  # fmt: skip
        for seed, day in enumerate((1, 2)):
            put_geometry(unit, make.geometry_record(seed, right - (500 - day) * DAY_NS))
        unit.idempotency.put("key", "d" * 64, 200, "{}", right)
    kept = {"recordings": 302.0, "superseded_estimates": 730.0, "track_reports": 730.0}
    assert purged(fleet, **kept, idempotency_keys=7.0) == {**dict.fromkeys(kept, 0), "idempotency_keys": 1}
    assert purged(fleet, recordings=300.5, superseded_estimates=498.5) == {"recordings": 1, "superseded_estimates": 1}


def test_recordings_stay_as_long_as_those_beside_them_may_come() -> None:
    assert Retention(recordings=31.0).recordings == 31.0
    with pytest.raises(ParameterError, match="at least 31 days"):
        Retention(recordings=30.9)


def test_young_files_stay_whatever_is_set() -> None:
    assert LEAST_AGE_S == 3600.0


def test_nothing_while_a_backup_runs(fleet: SqlStorage) -> None:
    with keeping_alone(fleet.engine), pytest.raises(ConflictError):
        purge(fleet, raw_of(fleet), Retention(), NOW, lambda: None)


@pytest.mark.parametrize("days", [0.0, -1.0, float("nan"), float("inf")])
def test_days_above_zero(days: float) -> None:
    with pytest.raises(ParameterError) as caught:
        Retention(track_reports=days)
    assert caught.value.field == "track_reports"


def test_what_is_kept_by_default() -> None:
    """These decide what can still be looked at: a change of one is a decision."""
    assert Retention() == Retention(14.0, 180.0, 7.0, 730.0, 31.0, 730.0, None, 730.0, 30.0, 1.0, 31.0, 92.0)
    assert replace(Retention(), job_runs=None).before_ns(Kept.JOB_RUNS, NOW) is None


def test_what_was_purged_is_counted(fleet: SqlStorage) -> None:
    assert Purged(Kept.JOB_RUNS, 0) in purge(fleet, raw_of(fleet), Retention(), NOW, lambda: None)

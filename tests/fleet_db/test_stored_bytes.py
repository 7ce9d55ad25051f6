"""Where the bytes are: every table and file is counted once, and a year follows from running and retention."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy
import stored_values as make
from full_storage import RECORDING, fill
from in_process_command import Run
from stored_raw import raw_of

from bench.put_values import put_trend
from fleet_db.keeping import stored_bytes as module
from fleet_db.keeping.retention import Kept, Retention
from fleet_db.keeping.stored_bytes import OTHER, TABLES, StoredKind, database_size, stored_bytes
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.tables import Base

FOR_EVER = Retention(**dict.fromkeys((kind.value for kind in Kept), None))


def kinds(storage: SqlStorage, retention: Retention = FOR_EVER, hours: float | None = 16.0) -> dict[str, StoredKind]:
    return {kind.kind: kind for kind in stored_bytes(storage, raw_of(storage), retention, hours).kinds}


def analysed(storage: SqlStorage) -> None:
    if storage.engine.dialect.name == "postgresql":
        with storage.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            connection.execute(sqlalchemy.text("ANALYZE"))


def test_every_kind_is_counted(fleet: SqlStorage) -> None:
    fill(fleet)
    analysed(fleet)
    found = kinds(fleet)
    assert set(found) == {*TABLES, OTHER, "samples of windows", "raw recordings"}
    assert (found["raw recordings"].items, found["raw recordings"].bytes) == (1, len(RECORDING))
    files = [path.stat().st_size for path in fleet.data_dir.glob("windows/*/*.window")]
    assert (found["samples of windows"].items, found["samples of windows"].bytes) == (3, sum(files))
    assert found["bin tables"].items == 3
    assert found["windows"].items == 3
    assert found["windows"].index_bytes > 0
    listed = [name for names in TABLES.values() for name in names]
    assert len(listed) == len(set(listed))
    whole = stored_bytes(fleet, raw_of(fleet), FOR_EVER)
    assert whole.total == sum(kind.bytes for kind in whole.kinds)
    assert whole.running.wheelsets == 1


def test_sqlite_pages_add_up_to_the_file(tmp_path: Path) -> None:
    upgrade(url := f"sqlite:///{tmp_path / 'treadwatch.sqlite'}")
    with closing(SqlStorage(database_engine(url), tmp_path)) as storage:
        make.populate(storage)
        fill(storage)
        with storage.engine.connect() as connection:
            exact, sampled = database_size(connection), database_size(connection, exact_bytes=0)
            pages, free, size = (
                connection.execute(sqlalchemy.text(f"PRAGMA {name}")).scalar_one()
                for name in ("page_count", "freelist_count", "page_size")
            )
    used = sum(one.table_bytes + one.index_bytes for one in exact.tables.values())
    assert 0.9 * (pages - free) * size < used <= (pages - free) * size
    assert sum(one.table_bytes + one.index_bytes for one in sampled.tables.values()) == pytest.approx(
        (pages - free) * size, abs=100
    )
    assert {name for name, one in exact.tables.items() if one.rows} == {
        name for name, one in sampled.tables.items() if one.rows
    }
    assert set(exact.tables) == set(Base.metadata.tables)
    assert (exact.tables["windows"].estimated, sampled.tables["windows"].estimated) == (False, True)


def test_a_sample_of_a_large_table_is_about_right(tmp_path: Path) -> None:
    upgrade(url := f"sqlite:///{tmp_path / 'treadwatch.sqlite'}")
    with closing(SqlStorage(database_engine(url), tmp_path)) as storage:
        make.populate(storage)
        with storage.write() as unit:
            for number in range(3000):
                unit.idempotency.put(f"key-{number}", "d" * 64, 200, "{}" * (number % 90), number)
                if number % 5 == 0:
                    put_trend(unit, replace(make.trend_record(number % 7), recorded_ns=number))
        with storage.engine.connect() as connection:
            exact, sampled = database_size(connection).tables, database_size(connection, exact_bytes=0).tables
    for name in ("idempotency_keys", "results"):
        assert sampled[name].rows == exact[name].rows
        assert sampled[name].table_bytes == pytest.approx(exact[name].table_bytes, rel=0.35)


def test_a_year_follows_from_running_and_days(fleet: SqlStorage) -> None:
    fill(fleet)
    analysed(fleet)
    per_hour = 3_600 / (make.LENGTH / make.SECOND)
    forever, limited = kinds(fleet), kinds(fleet, replace(FOR_EVER, recordings=31.0))
    one = forever["samples of windows"].bytes / 3
    assert forever["samples of windows"].wheelset_year_bytes == pytest.approx(one * per_hour * 16 * 365, abs=1)
    raw = forever["raw recordings"].wheelset_year_bytes or 0
    assert limited["raw recordings"].wheelset_year_bytes == pytest.approx(raw * 31 / 365, abs=1)
    assert limited["raw recordings"].days == 31.0
    purged = kinds(fleet, replace(FOR_EVER, window_samples=31.0, window_bin_tables=92.0))
    for kind, days in (("samples of windows", 31.0), ("bin tables", 92.0)):
        assert purged[kind].days == days
        year = forever[kind].wheelset_year_bytes or 0
        assert purged[kind].wheelset_year_bytes == pytest.approx(year * days / 365, abs=1)
    assert kinds(fleet, hours=8.0)["windows"].wheelset_year_bytes == pytest.approx(
        (forever["windows"].wheelset_year_bytes or 0) / 2, abs=1
    )
    lately = stored_bytes(fleet, raw_of(fleet), FOR_EVER).running
    assert lately.hours_per_day == pytest.approx(3 * make.LENGTH / make.SECOND / 3600)  # of one day at the least


def test_of_many_files_whole_directories_are_looked_at(fleet: SqlStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in range(16):
        place = fleet.data_dir / "windows" / f"{folder:02x}"
        place.mkdir(parents=True)
        for number in range(10):
            (place / f"{number}.window").write_bytes(b"x" * 100)
    counted = StoredKind("samples of windows", 160, 16000, 0, estimated=False, days=None, wheelset_year_bytes=None)
    assert kinds(fleet)["samples of windows"] == counted
    monkeypatch.setattr(module, "LOOKED_AT_FILES", 30)
    assert kinds(fleet)["samples of windows"] == replace(counted, estimated=True)


def test_an_empty_database_has_no_year(fleet: SqlStorage) -> None:
    assert {kind.wheelset_year_bytes for kind in stored_bytes(fleet, raw_of(fleet), FOR_EVER).kinds} == {None}


def test_the_command_prints_a_table_and_json(treadwatch: Run, tmp_path: Path) -> None:
    upgrade(url := f"sqlite:///{tmp_path / 'treadwatch.sqlite'}")
    with closing(SqlStorage(database_engine(url), tmp_path)) as storage:
        make.populate(storage)
        fill(storage)
    here = {"data_dir": str(tmp_path), "window_length_s": str(make.LENGTH // make.SECOND)}
    table = treadwatch("db", "stats", **here)
    assert table.returncode == 0, table.stderr
    assert "raw recordings" in table.stdout
    done = treadwatch("db", "stats", "--json", "--hours-per-day", "16", **here)
    found = json.loads(done.stdout)
    assert found["running"]["hours_per_day"] == 16.0
    assert found["total_bytes"] == sum(kind["bytes"] for kind in found["kinds"])

"""A backup holds everything, is verified, and becomes the same installation again, on either database."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy
import stored_values as make
from full_storage import RECORDING, contents, fill
from in_process_command import Run
from stored_raw import installation, raw_of

from bench.put_values import put_geometry
from estimation.errors import ConflictError, InputError, MigrationError
from estimation.values.runs import JobTrigger
from fleet_db.keeping.backup import BackupPlan, back_up, read_manifest, write_manifest
from fleet_db.keeping.checks import check_deep
from fleet_db.keeping.restore import CAUSE, restore
from fleet_db.locks import keeping_alone
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.tables.windows import WheelsetBinRow


def quietly(_done: int, _total: int) -> None:
    """Show no progress."""


@pytest.fixture
def full(fleet: SqlStorage) -> SqlStorage:
    """Return a storage with one of everything."""
    fill(fleet)
    return fleet


@pytest.fixture
def embedded(sqlite_storage: SqlStorage) -> SqlStorage:
    """Return a storage on SQLite with one of everything."""
    make.populate(sqlite_storage)
    fill(sqlite_storage)
    return sqlite_storage


@pytest.fixture(params=["sqlite", "postgresql"])
def target_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return the URL of a database without a table, once on each."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'restored' / 'treadwatch.sqlite'}"
    url: str = request.getfixturevalue("empty_postgres_url")
    return url


@pytest.fixture
def file_url(tmp_path: Path) -> str:
    """Return the URL of an SQLite file that is not there."""
    return f"sqlite:///{tmp_path / 'restored' / 'treadwatch.sqlite'}"


@pytest.fixture
def opened(target_url: str, tmp_path: Path) -> Iterator[SqlStorage]:
    """Yield the storage that a restore fills; nothing is connected before it is used."""
    with closing(SqlStorage(database_engine(target_url), tmp_path / "restored")) as storage:
        yield storage


def test_a_backup_becomes_the_same_installation(
    full: SqlStorage, target_url: str, opened: SqlStorage, tmp_path: Path
) -> None:
    manifest = back_up(full, raw_of(full), tmp_path / "backups", make.START, progress=quietly)
    assert (manifest.raw_files, manifest.window_files, manifest.missing) == (1, 3, ())
    assert {name: count for name, count in manifest.rows.items() if count} == {
        name: len(rows) for name, rows in contents(full).items() if rows
    }
    restored = restore(installation(target_url, tmp_path / "restored"), tmp_path / "backups", progress=quietly)
    assert (restored.files, restored.missing, restored.stale_vehicles) == (4, (), ())
    now, before = contents(opened), contents(full)
    branches, original = now.pop("feed_branches"), before.pop("feed_branches")
    assert now == before
    assert branches[:-1] == original  # cursors of the feed from before are known, and end at the backup
    with opened.read() as unit:
        assert unit.feed_branches.all()[-1].after_sequence == unit.feed_branches.newest_sequence() == 3
    assert check_deep(opened, raw_of(opened), quietly).findings == ()
    with opened.write() as unit:  # numbers go on where they were
        assert unit.jobs.start("refresh_geometry", JobTrigger.CLI, 6)[0].run_id == 2
        assert make.same(unit.windows.load("WS-1", make.START), make.window())


def test_a_second_backup_copies_what_is_new(embedded: SqlStorage, tmp_path: Path) -> None:
    first = back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, progress=quietly)
    raw = next((tmp_path / "b" / "raw").rglob("*.blf"))
    before = raw.stat().st_ino
    with embedded.write() as unit:
        unit.windows.put(make.window(7), 107.0, make.START)
    second = back_up(embedded, raw_of(embedded), tmp_path / "b", make.START + 10**9, progress=quietly)
    assert raw.stat().st_ino == before
    assert (first.window_files, second.window_files) == (3, 4)
    assert read_manifest(tmp_path / "b") == second
    assert read_manifest(tmp_path / "b", first.name) == first


def test_without_windows_they_are_made_again(
    embedded: SqlStorage, target_url: str, opened: SqlStorage, tmp_path: Path
) -> None:
    back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, plan=BackupPlan(windows=False), progress=quietly)
    assert not (tmp_path / "b" / "windows").exists()
    restored = restore(installation(target_url, tmp_path / "restored"), tmp_path / "b", progress=quietly)
    assert restored.stale_vehicles == ("V-1",)
    with opened.read() as unit:
        assert [span.vehicle for span in unit.stale_spans.all() if span.cause == CAUSE] == ["V-1"]


def test_a_damaged_file_is_named_and_the_rest_restored(
    embedded: SqlStorage, target_url: str, opened: SqlStorage, tmp_path: Path
) -> None:
    back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, progress=quietly)
    raw = next((tmp_path / "b" / "raw").rglob("*.blf"))
    raw.write_bytes(RECORDING[:-1] + b"?")
    min((tmp_path / "b" / "windows").rglob("*.window")).unlink()
    restored = restore(installation(target_url, tmp_path / "restored"), tmp_path / "b", progress=quietly)
    assert restored.files == 2
    assert [line.split(" (")[0].split(" ", 1)[1] for line in sorted(restored.missing)] == [
        "is damaged: its content has another digest",
        "is missing",
    ]
    assert restored.stale_vehicles == ("V-1",)
    assert {finding.kind for finding in check_deep(opened, raw_of(opened), quietly).findings} == {
        "recording",
        "window file",
    }


def test_a_damaged_database_is_refused(embedded: SqlStorage, file_url: str, tmp_path: Path) -> None:
    manifest = back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, progress=quietly)
    file = manifest.database_file(tmp_path / "b")
    content = bytearray(file.read_bytes())
    content[5000] ^= 1
    file.write_bytes(content)
    with pytest.raises(InputError, match="another sha256"):
        restore(installation(file_url, tmp_path / "restored"), tmp_path / "b", progress=quietly)
    file.unlink()
    with pytest.raises(InputError, match="is missing"):
        restore(installation(file_url, tmp_path / "restored"), tmp_path / "b", progress=quietly)


def test_a_database_with_content_is_refused(full: SqlStorage, tmp_path: Path) -> None:
    back_up(full, raw_of(full), tmp_path / "b", make.START, progress=quietly)
    url = full.engine.url.render_as_string(hide_password=False)
    before = contents(full)
    with pytest.raises(ConflictError, match=r"has content \(chunks, fleets"):
        restore(installation(url, full.data_dir), tmp_path / "b", progress=quietly)
    assert contents(full) == before


def test_an_interrupted_restore_is_repeated(
    embedded: SqlStorage, target_url: str, opened: SqlStorage, tmp_path: Path
) -> None:
    class PowerCutError(Exception):
        """The process ends here."""

    def cut(done: int, _total: int) -> None:
        if done == 2:
            raise PowerCutError

    back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, progress=quietly)
    with pytest.raises(PowerCutError):
        restore(installation(target_url, tmp_path / "restored"), tmp_path / "b", progress=cut)
    restore(installation(target_url, tmp_path / "restored"), tmp_path / "b", progress=quietly)
    now, before = contents(opened), contents(embedded)
    assert len(now.pop("feed_branches")) == len(before.pop("feed_branches")) + 1
    assert now == before


def test_an_interrupted_backup_does_not_count(embedded: SqlStorage, tmp_path: Path) -> None:
    def cut(_done: int, _total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, progress=cut)
    with pytest.raises(InputError, match="holds no finished backup"):
        read_manifest(tmp_path / "b")


@pytest.mark.parametrize(
    ("migration", "said"), [("r9999", "does not know it"), ("0049", "from before the first release")]
)
def test_a_backup_that_no_upgrade_leads_from_is_refused(
    embedded: SqlStorage, tmp_path: Path, migration: str, said: str
) -> None:
    manifest = back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, progress=quietly)
    write_manifest(tmp_path / "b", replace(manifest, migration=migration))
    url = f"sqlite:///{tmp_path / 'restored' / 'db.sqlite3'}"
    with pytest.raises(InputError, match=rf"is at migration {migration}, .*{said}"):
        restore(installation(url, tmp_path / "restored"), tmp_path / "b", progress=quietly)
    assert not list((tmp_path / "restored").glob("*.sqlite3"))


def test_nothing_is_restored_into_a_database_from_before_the_first_release(
    embedded: SqlStorage, empty_postgres_url: str, tmp_path: Path
) -> None:
    back_up(embedded, raw_of(embedded), tmp_path / "b", make.START, progress=quietly)
    for url in (empty_postgres_url, f"sqlite:///{tmp_path / 'old.sqlite3'}"):
        engine = database_engine(url)
        with engine.begin() as connection:
            connection.exec_driver_sql("CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL)")
            connection.exec_driver_sql("INSERT INTO alembic_version VALUES ('0049')")
        with pytest.raises(MigrationError, match="from before the first release"):
            restore(installation(url, tmp_path / "restored"), tmp_path / "b", progress=quietly)
        assert sqlalchemy.inspect(engine).get_table_names() == ["alembic_version"]
        engine.dispose()


def test_a_baseline_that_was_emptied_is_no_damage(full: SqlStorage) -> None:
    """As after a reprofiling that was entered by mistake and voided."""
    empty = replace(make.geometry_record(9).geometry, windows=0)
    with full.write() as unit:
        put_geometry(unit, make.geometry_record(8, baseline=1))
        put_geometry(unit, make.geometry_record(9, baseline=1, geometry=empty))
    assert check_deep(full, raw_of(full), quietly).findings == ()
    with full.engine.begin() as connection:
        connection.execute(sqlalchemy.update(WheelsetBinRow.table).values(geometry_id=2))
    assert [finding.subject for finding in check_deep(full, raw_of(full), quietly).findings] == [
        "bins of wheelset WS-1"
    ]


def test_one_at_a_time(full: SqlStorage, tmp_path: Path) -> None:
    with keeping_alone(full.engine), pytest.raises(ConflictError, match="is running"):
        back_up(full, raw_of(full), tmp_path / "b", make.START, progress=quietly)
    back_up(full, raw_of(full), tmp_path / "b", make.START, progress=quietly)


def test_by_command(treadwatch: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TREADWATCH_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("TREADWATCH_WINDOW_LENGTH_S", str(make.LENGTH // make.SECOND))
    url = f"sqlite:///{tmp_path / 'data' / 'treadwatch.sqlite'}"
    upgrade(url)
    with closing(SqlStorage(database_engine(url), tmp_path / "data")) as storage:
        make.populate(storage)
        fill(storage)
    assert treadwatch("backup", "b").returncode == 0
    shutil.rmtree(tmp_path / "data")
    done = treadwatch("restore", "b")
    assert (done.returncode, "4 files" in done.stdout) == (0, True)
    checked = treadwatch("db", "check", "--deep")
    assert (checked.returncode, "0 damaged or lost" in checked.stdout) == (0, True)
    raw = tmp_path / "data" / "raw"
    next(raw.rglob("*.blf")).unlink()
    checked = treadwatch("db", "check", "--deep")
    assert (checked.returncode, f"of vehicle V-1: {raw}/" in checked.stdout) == (1, True)
    again = treadwatch("backup", "c")
    assert (again.returncode, f"not in the backup: {raw}/" in again.stdout) == (1, True)

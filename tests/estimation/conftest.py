"""Databases of their own, to compare with."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage


@pytest.fixture(scope="module")
def new_sqlite_storage(
    migrated_sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[], SqlStorage]]:
    """Yield what makes an empty store; all are closed in the end."""
    made: list[SqlStorage] = []

    def make() -> SqlStorage:
        folder = tmp_path_factory.mktemp("store")
        file = folder / "treadwatch.sqlite3"
        shutil.copyfile(migrated_sqlite_file, file)
        made.append(SqlStorage(database_engine(f"sqlite:///{file}"), folder))
        return made[-1]

    yield make
    for storage in made:
        storage.close()

"""Databases of their own, to compare with; and filled ones, which are filled once in a run and copied."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from made_once import made_once

from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

FILE = "treadwatch.sqlite3"


def storage_of(folder: Path) -> SqlStorage:
    return SqlStorage(database_engine(f"sqlite:///{folder / FILE}"), folder)


@pytest.fixture(scope="module")
def new_sqlite_storage(
    migrated_sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[], SqlStorage]]:
    """Yield what makes an empty store; all are closed in the end."""
    made: list[SqlStorage] = []

    def make() -> SqlStorage:
        folder = tmp_path_factory.mktemp("store")
        shutil.copyfile(migrated_sqlite_file, folder / FILE)
        made.append(storage_of(folder))
        return made[-1]

    yield make
    for storage in made:
        storage.close()


@pytest.fixture
def filled_storage(
    migrated_sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> Iterator[Callable[[Callable[[SqlStorage], object]], SqlStorage]]:
    """Yield what returns a store of the test's own as a function leaves it; that runs once for all test processes."""
    copies: list[SqlStorage] = []

    def copy_of(fill: Callable[[SqlStorage], object]) -> SqlStorage:
        def make(folder: Path) -> None:
            shutil.copyfile(migrated_sqlite_file, folder / FILE)
            with closing(storage_of(folder)) as storage:
                fill(storage)

        name = f"{fill.__module__}-{fill.__name__}"
        shutil.copytree(made_once(tmp_path_factory, name, make), tmp_path / name)
        copies.append(storage_of(tmp_path / name))
        return copies[-1]

    yield copy_of
    for storage in copies:
        storage.close()

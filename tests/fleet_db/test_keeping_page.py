"""The commands of the page about keeping do what the page says, in its order."""

from __future__ import annotations

import re
import shlex
from contextlib import closing
from pathlib import Path

import pytest
import stored_values as make
from full_storage import contents, fill
from in_process_command import Run

from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

PAGE = Path(__file__).parents[2] / "docs" / "keeping.md"


def test_every_command_of_the_page(treadwatch: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TREADWATCH_WINDOW_LENGTH_S", str(make.LENGTH // make.SECOND))
    lines = re.findall(r"^ {4}treadwatch ([^#\n]+?)(?: +#.*)?$", PAGE.read_text(), re.MULTILINE)
    commands = [shlex.split(line.replace("/srv/backup", str(tmp_path / "backup"))) for line in lines]
    assert [command[0] for command in commands] == ["backup", "restore", "db", "db", "db"]
    url = f"sqlite:///{tmp_path / 'data' / 'treadwatch.sqlite'}"
    upgrade(url)
    with closing(SqlStorage(database_engine(url), tmp_path / "data")) as storage:
        make.populate(storage)
        fill(storage)
        before = contents(storage)
    for command in commands:
        if command[0] == "restore":
            (tmp_path / "data").rename(tmp_path / "lost")
        done = treadwatch(*command, data_dir=str(tmp_path / "data"))
        assert done.returncode == 0, (command, done.stdout, done.stderr)
    with closing(SqlStorage(database_engine(url), tmp_path / "data")) as storage:
        after = contents(storage)
    assert {name for name in before if before[name] != after[name]} <= {"feed_branches", "purges"}
    toml = re.findall(r"^```toml\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "retention.toml").write_text(toml[0])
    again = treadwatch("db", "purge", retention_file=str(tmp_path / "retention.toml"))
    assert (again.returncode, "superseded estimates" in again.stdout) == (0, False)

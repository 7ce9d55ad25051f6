"""The one command: what it loads, what it refuses, and in which words."""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from in_process_command import Done, Run

from api.cli import COMMANDS, Command
from api.factory import code_version
from api.settings import Settings, load_settings
from estimation.errors import ParameterError
from estimation.numerics_version import NUMERICS_VERSION
from fleet_db.migrate import upgrade

COMMAND = Path(sys.executable).with_name("treadwatch")


def refused(done: Done | subprocess.CompletedProcess[str]) -> str:
    """Return the one line in which a command says why it will not."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("treadwatch: ")
    return line


def test_the_installed_command_refuses_in_one_line(tmp_path: Path) -> None:
    environment = {"TREADWATCH_DATA_DIR": str(tmp_path), "PATH": ""}
    done = subprocess.run([COMMAND, "db", "check"], env=environment, capture_output=True, text=True, check=False)
    assert refused(done).endswith("run: treadwatch db upgrade")


def test_help_names_every_subcommand_and_loads_none(treadwatch: Run) -> None:
    done = treadwatch("--help")
    assert done.returncode == 0
    for command in COMMANDS:
        assert command.name in done.stdout


@pytest.mark.parametrize("words", [("-h",), ("recordings", "-h"), ("recordings", "reassign", "-h")])
def test_help_is_asked_for_in_one_letter_everywhere(treadwatch: Run, words: tuple[str, ...]) -> None:
    done = treadwatch(*words)
    assert done.returncode == 0
    assert "Usage: " in done.stdout


@pytest.mark.parametrize(("typed", "offered"), [("treadwatch reco", "recordings"), ("treadwatch db upg", "upgrade")])
def test_a_shell_completes_commands_and_their_commands(typed: str, offered: str) -> None:
    asked = {"_TREADWATCH_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    environment = os.environ | asked
    done = subprocess.run([COMMAND], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == [offered]


def test_a_port_that_is_taken_is_refused_in_one_line(treadwatch: Run, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = treadwatch("serve", port=str(port), data_dir=str(tmp_path))
    where = f"field 'TREADWATCH_PORT': nobody can listen on 127.0.0.1:{port}"
    assert refused(done) == f"treadwatch: {where}: another process listens there"


HEAVY = frozenset({
    "alembic", "apscheduler", "can", "cantools", "fastapi", "matplotlib", "numba", "scipy", "sqlalchemy",
    "structlog", "uvicorn",
})  # fmt: skip


def imported_by(*arguments: str, **settings: str) -> set[str]:
    """Return the packages that one run of the command imports, which must end without a refusal."""
    program = (
        "import sys\nfrom api import cli\nsys.argv = ['treadwatch', *sys.argv[1:]]\n"
        "try:\n    cli.main()\nexcept SystemExit as end:\n    assert not end.code\n"
        "print('imported:', *{name.partition('.')[0] for name in sys.modules})"
    )
    line = [sys.executable, "-c", program, *arguments]
    done = subprocess.run(line, env=os.environ | settings, capture_output=True, text=True, check=True)
    return set(done.stdout.rpartition("imported:")[2].split())


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_help_of_a_subcommand_does_not_import_what_the_subcommand_runs(command: Command) -> None:
    imported = imported_by(command.name, "--help")
    assert "typer" in imported
    assert imported & HEAVY == set()


def test_help_imports_neither_numerics_nor_tables_for_the_terminal() -> None:
    assert imported_by("--help") & (HEAVY | {"numpy", "rich"}) == set()
    assert imported_by("serve", "--help") & {"numpy", "rich"} == set()


RUNNING = {"max_speed_km_h": 120.0, "axle_offsets_m": [2.0, 4.5]}
REGISTRY = {
    "format": "treadwatch-registry-1",
    "fleets": [{"code": "F", "name": "F"}],
    "vehicles": [{"code": "V", "fleet": "F", "vehicle_class": "paper", "axles": 2, **RUNNING}],
    "wheelsets": [{"serial": "W", "fleet": "F", "wheel_profile": "P8", "nominal_radius_mm": 450.0}],
    "mountings": [
        {
            "wheelset": "W",
            "vehicle": "V",
            "axle": 1,
            "from": "2024-01-08T05:30:00Z",
            "vehicle_odometer_km": 1000.0,
            "wheelset_mileage_km": 1000.0,
        }
    ],
}
WEIGHTY = {"numba", "scipy", "fastapi", "alembic", "rich", "structlog", "apscheduler", "can", "cantools", "httpx"}


@pytest.mark.parametrize("line", ["keys list", "recordings list", "registry check registry.json"])
def test_lists_and_a_check_of_the_registry_wait_for_no_numerics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    upgrade(load_settings(data_dir=tmp_path).url)
    Path("registry.json").write_text(json.dumps(REGISTRY), encoding="utf-8")
    assert imported_by(*line.split(), TREADWATCH_DATA_DIR=str(tmp_path)) & WEIGHTY == set()


def test_an_unknown_subcommand_is_refused(treadwatch: Run) -> None:
    done = treadwatch("derail")
    assert done.returncode == 2
    assert "derail" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("command", ["serve", "schedule", "estimate"])
def test_a_database_that_was_never_migrated_is_refused(treadwatch: Run, command: str, tmp_path: Path) -> None:
    line = refused(treadwatch(command, data_dir=str(tmp_path)))
    assert line.endswith("run: treadwatch db upgrade")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", [["serve"], ["estimate"], ["db", "check"], ["db", "upgrade"]])
def test_a_database_of_another_version_is_refused(treadwatch: Run, command: list[str], tmp_path: Path) -> None:
    file = tmp_path / "treadwatch.sqlite"
    upgrade(f"sqlite:///{file}")
    with sqlite3.connect(file) as connection:
        connection.execute("UPDATE alembic_version SET version_num = 'from-the-future'")
    connection.close()
    assert "from-the-future" in refused(treadwatch(*command, data_dir=str(tmp_path)))


ON_THE_DATABASE = (
    ("serve",),
    ("schedule",),
    ("worker", "--dask-scheduler", "tcp://127.0.0.1:1"),
    ("estimate",),
    ("estimate", "--reasons"),
    ("ingest", "log.blf", "--vehicle", "V-1"),
    ("ingest", "--interface", "virtual", "--channel", "1", "--vehicle", "V-1"),
    ("chunk", "drop", "folder"),
    ("chunk", "work"),
    ("chunk", "consume"),
    ("chunk", "scrub"),
    ("recordings", "list"),
    ("quarantine", "list"),
    ("reassemble", "--vehicle", "V-1"),
    ("registry", "load", "registry.json"),
    ("registry", "check", "registry.json"),
    ("registry", "export", "out.json"),
    ("registry", "history"),
    ("rules", "replay", "--from", "2026-01-01"),
    ("keys", "list"),
    ("webhooks", "list"),
    ("db", "upgrade"),
    ("db", "check"),
    ("db", "check", "--deep"),
    ("db", "stats"),
    ("db", "purge"),
    ("backup", "kept"),
)


@pytest.mark.parametrize("command", ON_THE_DATABASE, ids="-".join)
def test_every_command_refuses_a_database_from_before_the_first_release(
    treadwatch: Run, command: tuple[str, ...], tmp_path: Path
) -> None:
    with closing(sqlite3.connect(tmp_path / "treadwatch.sqlite")) as connection, connection:
        connection.execute("CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL)")
        connection.execute("INSERT INTO alembic_version VALUES ('0049')")
    (tmp_path / "registry.json").write_text("{}")
    (tmp_path / "log.blf").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    environment = {"data_dir": str(tmp_path), "kafka_servers": "127.0.0.1:1", "retention_file": ""}
    done = treadwatch(*command, **environment)
    assert (done.returncode, done.stdout) == (2, "")
    line = done.stderr.strip().splitlines()[-1]  # a live bus says before that it listens
    assert line.startswith("treadwatch: the database is at migration 0049")
    assert line.endswith("name a new database, enter the registry and ingest the recordings again")


@pytest.mark.parametrize(
    ("environment", "named"),
    [
        ({"port": "eighty"}, "TREADWATCH_PORT"),
        ({"database_url": "mysql://user:hunter2@host/db"}, "TREADWATCH_DATABASE_URL"),
        ({"window_length_s": "-1"}, "TREADWATCH_WINDOW_LENGTH_S"),
        ({"log_level": "loud"}, "TREADWATCH_LOG_LEVEL"),
    ],
)
def test_a_wrong_setting_is_named_and_its_value_is_not_repeated(
    treadwatch: Run, environment: dict[str, str], named: str, tmp_path: Path
) -> None:
    line = refused(treadwatch("serve", data_dir=str(tmp_path), **environment))
    assert named in line
    assert "hunter2" not in line


def test_an_unreachable_database_is_one_line_without_its_password(treadwatch: Run, tmp_path: Path) -> None:
    url = f"postgresql://user:hunter2@/db?host={tmp_path}"
    line = refused(treadwatch("estimate", database_url=url, data_dir=str(tmp_path)))
    assert "hunter2" not in line


def test_wrong_rules_are_refused_and_named(treadwatch: Run, tmp_path: Path) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text("[conicity_limit]\nlimt = 3\n")
    assert treadwatch("db", "upgrade", data_dir=str(tmp_path)).returncode == 0
    line = refused(treadwatch("estimate", data_dir=str(tmp_path), rules_file=str(rules)))
    assert str(rules) in line
    assert "limt" in line


def test_estimate_runs_every_job_in_order_and_says_what_it_did(treadwatch: Run, tmp_path: Path) -> None:
    upgrade(f"sqlite:///{tmp_path / 'treadwatch.sqlite'}")
    done = treadwatch("estimate", data_dir=str(tmp_path))
    assert done.returncode == 0, done.stderr
    places = [done.stdout.index(f" {name} ") for name in ("assemble_windows", "estimate_windows", "evaluate_alerts")]
    assert places == sorted(places)
    assert done.stdout.count("succeeded") == 10
    assert "there are" in refused(treadwatch("estimate", "--job", "none", data_dir=str(tmp_path)))


def test_settings_come_from_the_environment_and_empty_means_not_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TREADWATCH_RULES_FILE", "")
    monkeypatch.setenv("TREADWATCH_JOBS_EVERY_S", "")
    monkeypatch.setenv("TREADWATCH_DATABASE_URL", "postgresql://user:secret@host/db")
    settings = load_settings(port=1234, host=None)
    assert (settings.rules_file, settings.jobs_every_s) == (None, None)
    assert (settings.port, settings.host) == (1234, "127.0.0.1")
    assert "secret" not in repr(settings)
    with pytest.raises(ParameterError, match="TREADWATCH_PORT"):
        load_settings(port=70000)


def test_the_embedded_database_is_in_the_data_directory(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, _env_file=None)
    assert settings.url == f"sqlite:///{tmp_path}/treadwatch.sqlite"
    assert settings.receiving_dir.parent == tmp_path


def test_the_code_version_is_that_of_the_numerics() -> None:
    assert code_version() == f"numerics {NUMERICS_VERSION}"

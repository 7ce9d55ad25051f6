"""``treadwatch ingest``, as a person starts it: files, folders, a live bus."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from multicast import GROUP, multicast_problem
from typer.testing import CliRunner
from vehicle_bus import SECOND_NS, START_NS, VEHICLE, Run, register

from api.cli import build
from estimation.errors import InputError, ParameterError
from fleet_db.migrate import upgrade
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.live.listening import open_bus, send
from ingest.logs import write_blf

STORED_WITHIN_S = 60.0


@pytest.fixture
def deployment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sqlite_url: str) -> SqlStorage:
    """Point the settings at a migrated database that knows the vehicle."""
    monkeypatch.setenv("TREADWATCH_DATABASE_URL", sqlite_url)
    monkeypatch.setenv("TREADWATCH_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("TREADWATCH_WINDOW_LENGTH_S", "10")
    storage = SqlStorage(database_engine(sqlite_url), tmp_path / "data")
    with storage.write() as unit:
        register(unit)
    storage.close()
    return storage


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(build(["ingest"]), ["ingest", *arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def recordings(folder: Path) -> Path:
    folder.mkdir()
    for hour in range(2):
        batch = Run(seconds=12.0, start_ns=START_NS + 3600 * SECOND_NS * hour).frames()
        write_blf(folder / f"{VEHICLE}__{hour}.blf", batch)
    return folder


def test_a_folder_is_received_once(deployment: SqlStorage, tmp_path: Path) -> None:
    folder = recordings(tmp_path / "in")
    code, said = run(str(folder))
    assert code == 0, said
    assert VEHICLE in said
    assert "windows: 8 pending " in said
    with deployment.read() as unit:
        assert unit.windows.counts()["pending"] == 8
    code, said = run(str(folder))
    assert code == 0, said
    with deployment.read() as unit:
        assert unit.windows.counts()["pending"] == 8


def test_a_bad_recording_is_named_and_the_others_go_on(deployment: SqlStorage, tmp_path: Path) -> None:
    folder = recordings(tmp_path / "in")
    (folder / f"{VEHICLE}__00.blf").write_bytes(b"LOGG but not really")
    code, said = run(str(folder))
    assert code == 1
    assert f"{VEHICLE}__00.blf" in said
    with deployment.read() as unit:
        assert unit.windows.counts()["pending"] == 8


def test_a_file_without_a_vehicle_and_a_broken_link_in_a_folder_leave_the_others(
    deployment: SqlStorage, tmp_path: Path
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    write_blf(folder / f"{VEHICLE}__00.blf", Run(seconds=12.0).frames())
    (folder / "notes.log").write_text("(nothing)")
    (folder / f"{VEHICLE}__01.blf").symlink_to(tmp_path / "nowhere.blf")
    (folder / f"{VEHICLE}__02.blf.gz").write_bytes(b"packed")
    code, said = run(str(folder))
    assert code == 1
    assert ".gz: 1" in said
    assert "notes.log: does not name its vehicle" in said
    assert f"rejected {folder / VEHICLE}__01.blf" in said
    with deployment.read() as unit:
        assert len(unit.chunks.with_state(ChunkState.DECODED)) == 1


@pytest.mark.usefixtures("deployment")
def test_what_cannot_be_meant_is_refused(tmp_path: Path) -> None:
    unnamed = tmp_path / "recording.blf"
    write_blf(unnamed, Run(seconds=1.0).frames())
    with pytest.raises(InputError, match=r"recording\.blf: does not name its vehicle"):
        run(str(unnamed))
    with pytest.raises(InputError, match="does not exist"):
        run(str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="holds no recording"):
        run(str(Path(__file__).parent))
    with pytest.raises(ParameterError, match="give recordings"):
        run()
    with pytest.raises(ParameterError, match="--channel and --vehicle"):
        run("--interface", "udp_multicast")


@pytest.mark.slow
@pytest.mark.usefixtures("live_bus")
def test_a_live_bus_is_received_until_a_stop_is_requested(
    deployment: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = multicast_problem()
    if problem:
        pytest.skip(problem)
    monkeypatch.setenv("TREADWATCH_WINDOW_LENGTH_S", "4")
    before: list[ChunkRecord] = []
    for _ in range(3):
        code, said, now_ns, sent = live(deployment, before)
        everything = chunks_around(deployment, now_ns)
        chunks = [chunk for chunk in everything if chunk not in before]
        if code == 0 and sum(chunk.frames for chunk in chunks) == sent:
            break
        before = list(everything)  # a machine held up for half a second loses datagrams or stamps them late: once more
    assert code == 0, said
    assert "0 dropped" in said
    assert sum(chunk.frames for chunk in chunks) == sent
    # a machine that is held up for more than 100 ms stamps a TIME frame so late that its second is not accepted
    assert 1000 <= sum(chunk.counts.get("samples", 0) for chunk in chunks) <= 3000
    with deployment.read() as unit:
        assert unit.windows.counts()["pending"] >= 2


def chunks_around(deployment: SqlStorage, now_ns: int) -> list[ChunkRecord]:
    with deployment.read() as unit:
        return list(unit.chunks.overlapping(VEHICLE, now_ns - 600 * SECOND_NS, now_ns + 600 * SECOND_NS))


def live(deployment: SqlStorage, before: list[ChunkRecord]) -> tuple[int, str, int, int]:
    """Send six seconds to the command and wait until they are stored, or too long for what was lost on the way.

    Returns how the command ended, what it said, when the run began, ns, and how many frames were sent.
    """
    command = [sys.executable, "-c", "from api.cli import main; main()", "ingest", "--interface", "udp_multicast"]
    command += ["--channel", GROUP, "--vehicle", VEHICLE, "--chunk-seconds", "2"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as listening:
        assert listening.stderr is not None
        watchdog = threading.Timer(240.0, listening.kill)
        watchdog.start()
        assert "listening to udp_multicast" in listening.stderr.readline()
        with open_bus("udp_multicast", GROUP) as bus:
            now_ns = time.time_ns() // SECOND_NS * SECOND_NS
            sent = send(bus, Run(seconds=6.0, start_ns=now_ns).frames())
        until = time.monotonic() + STORED_WITHIN_S
        while time.monotonic() < until:
            new = [chunk for chunk in chunks_around(deployment, now_ns) if chunk not in before]
            if sum(chunk.frames for chunk in new) == sent:
                break
            time.sleep(0.1)
        listening.send_signal(signal.SIGTERM)
        _, said = listening.communicate()
        watchdog.cancel()
    return listening.returncode, said, now_ns, sent


def test_migrations_are_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TREADWATCH_DATA_DIR", str(tmp_path / "new"))
    monkeypatch.delenv("TREADWATCH_DATABASE_URL", raising=False)
    folder = recordings(tmp_path / "in")
    with pytest.raises(Exception, match="treadwatch db upgrade"):
        run(str(folder))
    upgrade(f"sqlite:///{tmp_path / 'new' / 'treadwatch.sqlite'}")
    code, said = run(str(folder))
    assert code == 1, "the recordings are kept, but the vehicle is not registered"
    assert f"no vehicle '{VEHICLE}'" in said

"""The command that receives from a live bus, killed and started again."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from live_listening import eventually
from multicast import GROUP, multicast_problem
from test_live_receiver import PAGE, get
from vehicle_bus import VEHICLE, Run, register

from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.frames import OVERFLOW_ID, concatenate, count_dropped, merge
from ingest.live.listening import open_bus, send
from ingest.logs import read_log


@contextmanager
def command(folder: Path, database: str, port: int) -> Iterator[subprocess.Popen[str]]:
    """Run the command of the page, on the multicast bus; the process is killed at the end."""
    (line,) = re.findall(r"^ {4}treadwatch (.+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    here = {"socketcan": "udp_multicast", "can0": GROUP, "L-1": VEHICLE, "8001": str(port)}
    arguments = [here.get(word, word) for word in line.split()]
    assert {"udp_multicast", GROUP, VEHICLE, str(port)} <= {*arguments}
    environment = os.environ | {"TREADWATCH_DATABASE_URL": database, "TREADWATCH_DATA_DIR": str(folder)}
    process = subprocess.Popen(
        [sys.executable, "-c", "from api.cli import main; main()", *arguments],
        env=environment,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    watchdog = threading.Timer(200.0, process.kill)
    watchdog.start()
    try:
        yield process
    finally:
        process.kill()
        process.communicate()
        watchdog.cancel()


@pytest.mark.slow
@pytest.mark.usefixtures("live_bus")
def test_a_killed_receiver_leaves_what_the_next_one_stores(sqlite_url: str, tmp_path: Path) -> None:
    problem = multicast_problem()
    if problem:
        pytest.skip(problem)
    folder = tmp_path / "data"
    with closing(SqlStorage(database_engine(sqlite_url), folder)) as storage:
        with storage.write() as unit:
            register(unit)
        with socket.create_server(("127.0.0.1", 0)) as probe:
            port = probe.getsockname()[1]
        with command(folder, sqlite_url, port) as process:
            until_said(process, "listening to udp_multicast")
            with open_bus("udp_multicast", GROUP) as bus:
                sent = send(bus, Run(seconds=1.0).frames())
            eventually(lambda: arrived(port) == sent)
            received = int(measure(port, "frames_received_total"))
            eventually(lambda: measure(port, "frames_spooled_total") == received)
            os.kill(process.pid, signal.SIGKILL)
            process.wait(60.0)
        with command(folder, sqlite_url, port) as process:
            until_said(process, "frames stored")
            process.send_signal(signal.SIGTERM)
            assert process.wait(60.0) == 0
        with storage.read() as unit:
            records = [r for state in ChunkState for r in unit.chunks.with_state(state)]
        raw = FileRawStore(folder / "raw")
        batches = [read_log(raw.path(record.digest, record.suffix)) for record in records]
    assert len(records) == 1
    stored = concatenate(batches)
    assert len(stored) - np.count_nonzero(stored.arbitration_id == OVERFLOW_ID) == received > 0
    assert len(merge(batches)) == len(stored), "nothing doubled"
    assert count_dropped(stored) + received == sent


def until_said(process: subprocess.Popen[str], text: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if text in line:
            return
    raise AssertionError(text)


def arrived(port: int) -> int:
    """Return how many frames this process received, and all of them dropped: by a machine that was held up."""
    return int(measure(port, "frames_received_total") + measure(port, "frames_dropped_total"))


def measure(port: int, name: str) -> float:
    lines = get(port, "/metrics")[1].splitlines()
    return next(float(line.split()[-1]) for line in lines if line.startswith(f"treadwatch_live_{name}{{"))

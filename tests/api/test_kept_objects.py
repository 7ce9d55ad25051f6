"""A process that serves: its garbage collector, and its linear algebra."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from api.settings import Settings
from fleet_db.migrate import upgrade

SERVED = """
import gc, sys
{how}
print(gc.get_freeze_count())
"""
AS_WORKER = "from api.asgi import app; app()"
AS_COMMAND = """
import uvicorn
uvicorn.Server.run = lambda self, sockets=None: None
from threading import Event
from api.serving import serve
from api.settings import load_settings
serve(load_settings(), Event())
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", [AS_WORKER, AS_COMMAND])
def test_what_a_server_has_loaded_is_not_collected_through_again(tmp_path: Path, how: str) -> None:
    environment = {**os.environ, "TREADWATCH_DATA_DIR": str(tmp_path), "TREADWATCH_PORT": "0"}
    upgrade(Settings(data_dir=tmp_path, _env_file=None).url)
    command = [sys.executable, "-c", SERVED.format(how=how)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert int(ran.stdout.splitlines()[-1]) > 100_000


ALGEBRA = """
import os, sys
threads = lambda: len(os.listdir("/proc/self/task"))
from api.asgi import app
before = "numpy" in sys.modules
app()
begun = threads()
import numpy
numpy.ones((1000, 1000)) @ numpy.ones((1000, 1000))
print(before, os.environ["OPENBLAS_NUM_THREADS"], threads() - begun)
"""


@pytest.mark.slow
def test_linear_algebra_of_a_worker_of_the_server_runs_on_one_thread(tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    upgrade(Settings(data_dir=tmp_path, _env_file=None).url)
    command = [sys.executable, "-c", ALGEBRA]
    environment["TREADWATCH_DATA_DIR"] = str(tmp_path)
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.splitlines()[-1] == "False 1 0"

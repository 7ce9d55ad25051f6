"""The garbage collector of a process that serves."""

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
from api.factory import serve
from api.settings import load_settings
serve(load_settings(), Event())
"""


@pytest.mark.parametrize("how", [AS_WORKER, AS_COMMAND])
def test_what_a_server_has_loaded_is_not_collected_through_again(tmp_path: Path, how: str) -> None:
    environment = {**os.environ, "TREADWATCH_DATA_DIR": str(tmp_path), "TREADWATCH_PORT": "0"}
    upgrade(Settings(data_dir=tmp_path, _env_file=None).url)
    command = [sys.executable, "-c", SERVED.format(how=how)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert int(ran.stdout.splitlines()[-1]) > 100_000

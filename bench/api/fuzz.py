"""Schemathesis against the running service: all checks, for a time; what it finds is printed as it prints it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from api.factory import open_store
from api.settings import Settings
from bench.api.servers import new_key, served
from fleet_db.migrate import upgrade
from tests.api import api_fleet

CONFIGURATION = Path(__file__).with_name("schemathesis.toml")


def fuzz(seconds: int, seed: int, report: Path) -> int:
    """Ask whatever the document allows and forbids; return how schemathesis ended, 0 where it found nothing.

    Args:
        report: Folder of its report, for what it has found.
    """
    with _service() as (url, key):
        command = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(CONFIGURATION)]
        command += ["run", f"{url}/openapi.json", "--checks", "all"]
        command += ["--max-time", str(seconds), "--seed", str(seed), "--continue-on-failure"]
        command += ["--report", "junit", "--report-dir", str(report), "--suppress-health-check", "all"]
        return subprocess.run(command, check=False, env=_environment(key)).returncode  # noqa: S603 - our own command


def _environment(key: str) -> Mapping[str, str]:
    """Return the environment of schemathesis: its configuration reads the key there, and its libraries warn."""
    return {**os.environ, "PYTHONWARNINGS": "ignore", "TREADWATCH_KEY": key.removeprefix("Authorization: Bearer ")}


@contextmanager
def _service() -> Iterator[tuple[str, str]]:
    with tempfile.TemporaryDirectory(prefix="treadwatch-fuzz-") as name:
        folder = Path(name)
        settings = Settings(data_dir=folder, _env_file=None)
        upgrade(settings.url)
        storage = open_store(settings)
        api_fleet.populate(storage)
        key = new_key(storage)
        storage.close()
        with served(folder, None, workers=1) as url:
            yield url, key

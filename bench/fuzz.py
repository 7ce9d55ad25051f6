"""Schemathesis against the running service, all checks: what it finds is printed as it prints it."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from api.factory import open_store
from api.settings import Settings
from bench.served import SEED, new_key, served
from fleet_db.migrate import upgrade
from tests.api import populated_fleet

SCHEMATHESIS = Path(__file__).with_name("schemathesis.toml")


def main(arguments: Sequence[str]) -> int:
    """Ask whatever the document allows and forbids; return how schemathesis ended, 0 where it found nothing."""
    parser = argparse.ArgumentParser(prog="python -m bench fuzz", description=__doc__)
    parser.add_argument("--seconds", type=int, default=600, help="how long it asks")
    parser.add_argument("--report", default="schemathesis-report", help="folder of its report")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="treadwatch-fuzz-") as name:
        settings = Settings(data_dir=Path(name), _env_file=None)
        upgrade(settings.url)
        with closing(open_store(settings)) as storage:
            populated_fleet.populate(storage)
            key = new_key(storage)
        with served(Path(name), None, workers=1) as url:
            command = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(SCHEMATHESIS)]
            command += ["run", f"{url}/openapi.json", "--checks", "all"]
            command += ["--max-time", str(options.seconds), "--seed", str(SEED), "--continue-on-failure"]
            command += ["--report", "junit", "--report-dir", options.report, "--suppress-health-check", "all"]
            # its configuration reads the key there, and its libraries warn
            own = {"PYTHONWARNINGS": "ignore", "TREADWATCH_KEY": key.removeprefix("Authorization: Bearer ")}
            return subprocess.run(command, check=False, env={**os.environ, **own}).returncode  # noqa: S603 - ours

"""Short forms of the parts of the chaos run that kill processes, take disks and databases away, and ingest at once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def test_the_short_forms_reach_what_the_long_ones_are_to_reach() -> None:
    command = [sys.executable, "-m", "bench", "chaos", "kills", "ingests", "outages", "--short"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(f"\n{part}: " in f"\n{done.stdout}" for part in ("kills", "ingests", "outages"))

"""Short forms of the parts of the chaos run that kill processes, take disks and databases away, and ingest at once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("part", ["kills", "ingests", "outages"])
def test_the_short_form_reaches_what_the_long_one_is_to_reach(part: str) -> None:
    command = [sys.executable, "-m", "bench", "chaos", part, "--short"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr

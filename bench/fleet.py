"""Every measurement of what a fleet costs, one after the other: ``python -m bench fleet``; of more than an hour."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence

PARTS = (
    ("logs", "new_window", "stored", "idle"),
    ("pipeline",),
    ("section_runs",),
    ("workers",),
    ("chunks",),
    ("sustained",),
    ("fleet_sizes",),
)
"""Names of benches that run together, for what is printed as one table."""


def main(arguments: Sequence[str]) -> int:
    """Run all, whatever falls short; return 1 where something does."""
    parser = argparse.ArgumentParser(prog="python -m bench fleet", description=__doc__)
    parser.parse_args(arguments)
    ended = [subprocess.run([sys.executable, "-m", "bench", *names], check=False).returncode for names in PARTS]  # noqa: S603 - this program
    return 1 if any(ended) else 0

"""CPU seconds of a first start: nothing compiled yet, nothing that can be written, and compiled before.

A copy of the packages that nobody may write runs ``treadwatch contact`` and ``treadwatch compile``.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.report import BenchRow

ROOT = Path(__file__).parents[1]
PACKAGES = ("api", "ingest", "fleet_db", "estimation")
WITHOUT_PRIVILEGE = ("setpriv", "--bounding-set=-dac_override") if os.geteuid() == 0 else ()
WARM_REACH_S = 3.0
LINE = "import sys\nfrom api.cli import main\nsys.argv = ['treadwatch', *sys.argv[1:]]\nmain()"


def rows() -> Iterator[BenchRow]:
    """Yield the CPU seconds of each kind of start."""
    with tempfile.TemporaryDirectory() as folder:
        installed, kept = Path(folder, "installed"), Path(folder, "kept")
        _install(installed)
        try:
            nowhere, warned = _cpu_s(installed, installed / "none", "contact")
            yield BenchRow(
                "read-only install, nothing can be written: contact",
                f"{nowhere:.1f} s, {warned} warning",
                "runs",
                met=True,
            )
            all_s, _ = _cpu_s(installed, kept, "compile")
            size_mb = sum(path.stat().st_size for path in kept.rglob("*.compiled")) / 1e6
            yield BenchRow("treadwatch compile: every kernel", f"{all_s:.1f} s, {size_mb:.1f} MB", "", met=True)
            kept.joinpath("compiled").chmod(0o555)
            warm, warned = _cpu_s(installed, kept, "contact")
            yield BenchRow(
                "read-only install and read-only compiled code: contact",
                f"{warm:.1f} s, {warned} warnings",
                f"<= {WARM_REACH_S:g} s, 0",
                warm <= WARM_REACH_S and not warned,
            )
        finally:
            for path in [installed, *installed.rglob("*"), *kept.glob("*")]:
                path.chmod(0o755)


def _install(folder: Path) -> None:
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-m", "compileall", "-q", str(folder)]
    subprocess.run(command, check=True)  # noqa: S603 - as pip does
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)


def _cpu_s(installed: Path, kept: Path, command: str) -> tuple[float, int]:
    """Return the CPU seconds of one command, and how often it warned that compiled code cannot be kept."""
    others = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_C", "XDG_"))}
    environment = others | {
        "PYTHONPATH": str(installed),
        "HOME": str(installed / "none"),
        "TREADWATCH_COMPILED_DIR": str(kept),
        "TREADWATCH_COMPILED_CPU": "portable",
    }
    before = _children_s()
    line = [*WITHOUT_PRIVILEGE, sys.executable, "-c", LINE, command]
    done = subprocess.run(line, env=environment, cwd=installed, capture_output=True, text=True, check=True)  # noqa: S603
    return _children_s() - before, done.stderr.count("compiled code cannot be kept")


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

"""The rules of docs/operations, checked and tried by Prometheus' own promtool."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from compose_file import ROOT

OPERATIONS = ROOT / "docs" / "operations"
PATIENCE_S = 300.0


@pytest.fixture(scope="module")
def promtool() -> str:
    """Return promtool: the installed one, or that of Debian's package, unpacked without its service."""
    installed = shutil.which("promtool")
    if installed is not None:
        return installed
    folder = Path(tempfile.gettempdir()) / "treadwatch-promtool"
    found = folder / "usr" / "bin" / "promtool"
    if not found.exists():
        folder.mkdir(exist_ok=True)
        try:
            for command in (["apt-get", "update", "-qq"], ["apt-get", "download", "-qq", "prometheus"]):
                subprocess.run(
                    command, cwd=folder, capture_output=True, timeout=PATIENCE_S, check=command[1] != "update"
                )
            (package,) = folder.glob("prometheus_*.deb")
            subprocess.run(["dpkg", "-x", package, folder], check=True, timeout=PATIENCE_S)
        except (OSError, subprocess.SubprocessError) as error:
            raise RuntimeError("promtool is not installed: sudo apt-get install prometheus") from error
    return str(found)


@pytest.mark.parametrize(
    "arguments",
    [("check", "config", "prometheus.yml"), ("check", "rules", "rules.yml"), ("test", "rules", "rules-test.yml")],
)
def test_promtool_finds_no_fault(promtool: str, arguments: tuple[str, ...]) -> None:
    done = subprocess.run(
        [promtool, *arguments], cwd=OPERATIONS, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "SUCCESS" in done.stdout + done.stderr

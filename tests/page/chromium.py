"""Debian's Chromium for the tests of the page: found, or installed where we may; never skipped."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
PATIENCE_S = 600.0


def chromium() -> str:
    """Return the path of the browser; install Debian's package where there is none and we are root.

    Raises:
        RuntimeError: There is none; gives the command to install it.
    """
    found = _found()
    if found is None and os.geteuid() == 0 and Path("/etc/debian_version").exists():
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for command in (["apt-get", "update", "-qq"], ["apt-get", "install", "-y", "-qq", "chromium"]):
            subprocess.run(command, env=environment, check=True, capture_output=True, timeout=PATIENCE_S)
        found = _found()
    if found is None:
        raise RuntimeError("the page is tested in Chromium, which is not installed: sudo apt-get install chromium")
    return found


def _found() -> str | None:
    return next((path for name in NAMES if (path := shutil.which(name)) is not None), None)

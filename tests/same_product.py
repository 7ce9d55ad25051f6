"""Processes that tests start run the product that is tested, also where another one is installed."""

from __future__ import annotations

import os
from pathlib import Path

_GIVEN = os.environ.get("PYTHONPATH")

os.environ["PYTHONPATH"] = os.pathsep.join((str(Path(__file__).parent.parent), *([_GIVEN] if _GIVEN else [])))

"""The services of the tests are on loopback and need no key, except where access itself is tested."""

from __future__ import annotations

import os

os.environ["TREADWATCH_ACCESS"] = "open"

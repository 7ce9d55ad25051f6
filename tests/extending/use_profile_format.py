"""A wheel in the profile format of the page is read as the same wheel in two columns."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import ingest
from estimation.contact.profiles import wheel_profile
from ingest.profiles.files import read_profile

folder = Path(sys.argv[1])
wheel = wheel_profile("S1002")
rows = [(1e3 * y, 1e3 * z) for y, z in zip(wheel.y, wheel.z, strict=True)]
(folder / "wheel.txt").write_text("\n".join(f"{y:.6f} {z:.6f}" for y, z in rows), encoding="utf-8")
(folder / "wheel.ssv").write_text("\n".join(f"{y:.6f};{z:.6f}" for y, z in rows).replace(".", ","), encoding="utf-8")
read, expected = (read_profile(folder / name, "wheel") for name in ("wheel.ssv", "wheel.txt"))
assert np.array_equal(read.y, expected.y)
assert np.array_equal(read.z, expected.z)
print(ingest.__file__)  # noqa: T201 - for the test: which copy ran

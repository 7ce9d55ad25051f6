"""Units of the file, in SI units."""

from __future__ import annotations

MM = 1e-3
KM = 1e3
KM_PER_HOUR = 1.0 / 3.6
MICRO_G = 9.80665e-6

"""Where a vehicle's GNSS receiver puts it, against the line of the section that it reports."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.track import SectionLine

LIMIT_M = 50.0
"""From the line: a receiver in a train is right within 5-10 m (one std), a line on a map within 5 m, and the chord of
a radius of 300 m leaves the rail by 17 m over the 200 m that two points may be apart; three std and the chord are
50 m."""

ALONG_M = 200.0
"""The line is looked for this far on both sides of the reported distance: odometry between balises may be off by 5 m
and 5 % (ETCS, SUBSET-041), which is 200 m after 3.9 km; a fix that is a second old is 80 m behind at most."""

FEWEST_FIXES = 3
"""Of a window. The median counts: fewer than half may be outliers."""

SEMI_MAJOR_M, ECCENTRICITY2 = 6_378_137.0, 6.694_379_990_14e-3
"""Of WGS84 (NIMA TR8350.2)."""


def off_line_m(line: SectionLine, distance: FloatArray, fixes: FloatArray) -> float:
    """Return how far from a section's line the vehicle was, m; 0 where it was on it within the limit, or nobody knows.

    Args:
        distance: (n,) m along it, as the vehicle reports them; NaN where it does not.
        fixes: (n, 2) latitude and longitude, deg; NaN without a fix. Receivers also send 0, 0 then.
    """
    points = np.array(line, dtype=np.float64)
    points[:, 2] = np.unwrap(points[:, 2], period=360.0)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(fixes).all(axis=1) & (fixes != 0.0).any(axis=1)
        known &= (distance >= points[0, 0]) & (distance <= points[-1, 0])
    if np.count_nonzero(known) < FEWEST_FIXES:
        return 0.0
    pairs = zip(distance[known].tolist(), fixes[known], strict=True)
    median = float(np.median([_from_line(points, at, fix) for at, fix in pairs]))
    return median if median > LIMIT_M else 0.0


def steps_m(line: SectionLine) -> FloatArray:
    """Return the straight distances (n - 1,) between the points of a line, m."""
    points = np.array(line, dtype=np.float64)
    return np.array([float(np.hypot(*_local(points[i + 1 : i + 2], points[i, 1:])[0])) for i in range(len(points) - 1)])


def _local(points: FloatArray, origin: FloatArray) -> FloatArray:
    """Return points (n, 2) east and north of a place, m: exact nearby, of the right order of magnitude afar."""
    latitude = np.deg2rad(0.5 * (points[:, 1] + origin[0]))
    bent = 1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2
    across = SEMI_MAJOR_M / np.sqrt(bent)
    along = across * (1.0 - ECCENTRICITY2) / bent
    east = (points[:, 2] - origin[1] + 180.0) % 360.0 - 180.0
    north = points[:, 1] - origin[0]
    return np.column_stack([np.deg2rad(east) * across * np.cos(latitude), np.deg2rad(north) * along])


def _from_line(points: FloatArray, at: float, fix: FloatArray) -> float:
    first, last = max(at - ALONG_M, points[0, 0]), min(at + ALONG_M, points[-1, 0])
    low, high = np.searchsorted(points[:, 0], [first, last], side="right")
    ends = np.array([[s, *(np.interp(s, points[:, 0], points[:, k]) for k in (1, 2))] for s in (first, last)])
    flat = _local(np.vstack([ends[:1], points[low:high], ends[1:]]), fix)
    begin, step = flat[:-1], np.diff(flat, axis=0)
    length2 = np.maximum((step**2).sum(axis=1), 1e-12)
    share = np.clip(-(begin * step).sum(axis=1) / length2, 0.0, 1.0)
    return float(np.hypot(*(begin + share[:, None] * step).T).min())

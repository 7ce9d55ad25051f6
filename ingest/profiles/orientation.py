"""From the axes of a file to those of a profile: z down, y to the field side, one height per lateral position.

What a file leaves open (SIMPACK leaves only the gauge side) is decided from the shape:

- z is turned over if the point that must lie inside the profile (the crown of a rail, the tip of a flange) comes out
  in the first or last tenth (rails) or twentieth (wheels) of the points.
- A wheel's flange is brought to the side of negative y. If its tip is then within 25 mm of zero, zero is the flange
  back and y is moved to the tread datum. Zero of z is the tread at the datum.
- A rail whose positive side alone reaches 14 mm below the crown is mirrored, because the gauge is measured there.
  Zero of z is the crown; y stays, because a rail is placed in the track by its gauge.
- Points that overhang (flange back, underside of a head) are left out.
"""

from __future__ import annotations

import numpy as np

from estimation.contact.profiles import TREAD_DATUM, Profile, ProfileKind, profile_from_points
from estimation.contact.surface import GAUGE_DEPTH
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray
from ingest.profiles.points import FilePoints

_MILLIMETRE = 1e-3
_RAIL_MARGIN = 0.10
_WHEEL_MARGIN = 0.05
_FLANGE_BACK_WITHIN = 25.0  # mm from the tip of the flange
_CLOSEST = 1e-3  # mm, nearer neighbours are one point
_LEAST_KEPT = 0.4  # share of points that a usable order keeps
_LARGEST_GAP = 10.0  # mm between neighbours


def oriented(points: FilePoints, kind: ProfileKind, name: str) -> Profile:
    """Return the profile that the points of a file describe, in the axes of :class:`Profile`.

    Parameters
    ----------
    points
        Points in mm in the order of the file, and whether the file fixes their axes.
    kind
        ``"wheel"`` or ``"rail"``.
    name
        Name of the profile.

    Raises
    ------
    ProfileError
        The points are not in order along the profile, leave a gap of more than 10 mm, or a wheel does not reach from
        its flange to the tread datum.
    """
    y, z = points.y, points.z if points.axes_known else _upright(points.z, kind)
    if y[-1] < y[0]:
        y, z = y[::-1], z[::-1]
    if kind == "wheel":
        y, z = (y, z) if points.axes_known else _from_datum(y, z)
    else:
        y, z = _gauge_side_negative(y, z - z.min())
    y, z = _single_valued(y, z, int(np.argmax(z) if kind == "wheel" else np.argmin(z)), points)
    profile = profile_from_points(kind, name, y * _MILLIMETRE, z * _MILLIMETRE)
    return _zeroed_at_datum(profile, points.file) if kind == "wheel" else profile


def _upright(z: FloatArray, kind: ProfileKind) -> FloatArray:
    peak = int(np.argmin(z) if kind == "rail" else np.argmax(z))
    margin = (_RAIL_MARGIN if kind == "rail" else _WHEEL_MARGIN) * len(z)
    return -z if peak < margin or peak >= len(z) - margin else z


def _from_datum(y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    tip = float(y[np.argmax(z)])
    if abs(tip - y[0]) > abs(y[-1] - tip):
        y, z, tip = -y[::-1], z[::-1], -tip
    return (y - TREAD_DATUM / _MILLIMETRE, z) if abs(tip) <= _FLANGE_BACK_WITHIN else (y, z)


def _gauge_side_negative(y: FloatArray, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
    crown = int(np.argmin(depth))
    enough = GAUGE_DEPTH / _MILLIMETRE
    if depth[: crown + 1].max() < enough <= depth[crown:].max():
        return -y[::-1], depth[::-1]
    return y, depth


def _single_valued(y: FloatArray, z: FloatArray, peak: int, points: FilePoints) -> tuple[FloatArray, FloatArray]:
    """Return the points that advance, seen from the peak outwards to both sides."""
    right = _advancing(y[peak:])
    left = _advancing(-y[peak::-1])
    keep = np.concatenate([peak - left[:0:-1], peak + right])
    gap = float(np.diff(y[keep]).max(initial=0.0))
    if len(keep) < _LEAST_KEPT * len(y) or gap > _LARGEST_GAP:
        backwards = np.flatnonzero(np.diff(points.y) * np.sign(points.y[-1] - points.y[0]) < 0)
        line = points.lines[int(backwards[0]) + 1] if len(backwards) else points.lines[0]
        raise ProfileError(
            f"points are not in order along the profile ({len(keep)} of {len(y)} advance, largest gap {gap:.1f} mm)",
            file=points.file,
            line=line,
            field="y",
        )
    return y[keep], z[keep]


def _advancing(y: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the indices of the points that lie beyond all points before them."""
    kept = [0]
    for i in range(1, len(y)):
        if y[i] > y[kept[-1]] + _CLOSEST:
            kept.append(i)
    return np.array(kept, dtype=np.intp)


def _zeroed_at_datum(wheel: Profile, file: str) -> Profile:
    level = float(wheel.height(np.zeros(1))[0])
    if not np.isfinite(level):
        raise ProfileError("the wheel does not reach the tread datum, 70 mm from the flange back", file=file, field="y")
    return Profile("wheel", wheel.name, wheel.y, wheel.z - level, wheel.slope)

"""Surfaces of wheel and rail that can touch, on the uniform grid that the search for contact points takes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile
from estimation.errors import ContactError
from estimation.values.arrays import FloatArray, FrozenArrays, runs


@dataclass(frozen=True, slots=True)
class Surface(FrozenArrays):
    """A height over a lateral axis on a uniform grid; between grid points the cubic through heights and slopes."""

    start: float  # m
    step: float  # m
    height: Annotated[FloatArray, "n"]  # m, down
    slope: Annotated[FloatArray, "n"]


def wheel_surface(wheel: Profile) -> Surface:
    """Return the part of a wheel that can touch: from the flange face, 2 mm above its tip, to the outer end.

    The lateral axis is the profile's own. A wheel that touches with the tip or its inner side has derailed. Of a
    wheel without a flange (a plain cone) everything can touch.

    Raises:
        ContactError: Nothing of it can touch: it ends in its flange.
    """
    margin = PROFILES.tip_height if np.ptp(wheel.z) > PROFILES.least_flange_height else 0.0
    start = int(np.flatnonzero(wheel.z >= wheel.z.max() - margin)[-1])
    face = int(np.searchsorted(wheel.y, PROFILES.flange_face_end))  # a worn flange face may be as steep as it likes
    keep = slice(start, _run(wheel.slope, wheel.z, min(max(start, face), len(wheel.y) - 1), 1) + 1)
    if keep.stop - keep.start < PROFILES.fewest_gridded:
        raise ContactError(f"wheel {wheel.name!r} ends in its flange: it has no tread that can touch", field="wheel")
    return _gridded(wheel.y[keep], wheel.z[keep], wheel.slope[keep])


def rail_surface(rail: Profile, inclination: float, gauge: float) -> Surface:
    """Return a rail placed in the track: lateral distance from the track centre, height below the top of the rail.

    Args:
        rail: Uninclined, or in track axes if ``inclination`` is 0.
        inclination: Tangent of the angle by which the rail leans towards the track centre.
        gauge: Distance between the rails, m: the smallest within 14 mm below their tops.

    Raises:
        ContactError: The rail ends on the gauge side less than 14 mm below its top, and not in a steep face.
    """
    angle = math.atan(inclination)
    y = rail.y * math.cos(angle) + rail.z * math.sin(angle)
    z = rail.z * math.cos(angle) - rail.y * math.sin(angle)
    forward = math.cos(angle) + rail.slope * math.sin(angle)
    rise = rail.slope * math.cos(angle) - math.sin(angle)
    slope = np.divide(rise, forward, out=np.full_like(rise, np.inf), where=forward > 1.0 / PROFILES.steepest_slope)
    top = int(np.argmin(z))
    edge = _gauge_edge(
        rail.name, y[: top + 1], z[: top + 1] - z[top], wall=bool(forward[0] * PROFILES.wall_slope < abs(rise[0]))
    )
    first, last = _run(slope, z, top, -1), _run(slope, z, top, 1)
    outwards = (
        np.maximum.accumulate(y[top : last + 1]),
        np.minimum.accumulate(y[top : first - 1 if first else None : -1]),
    )
    beyond = top + np.flatnonzero(np.diff(outwards[0], prepend=-np.inf) > 0)
    before = top - np.flatnonzero(np.diff(outwards[1], prepend=np.inf) < 0)
    keep = np.concatenate([before[:0:-1], beyond])
    steepest = PROFILES.steepest_slope
    return _gridded(y[keep] - edge + gauge / 2.0, z[keep] - z[top], np.clip(slope[keep], -steepest, steepest))


def _gauge_edge(name: str, y: FloatArray, depth: FloatArray, *, wall: bool) -> float:
    """Return the smallest y within `PROFILES.gauge_depth` below the top; the last point of the arrays is the top."""
    # `wall`: the rail ends in a face so steep that its last point stands for what is below
    below = np.flatnonzero(depth > PROFILES.gauge_depth)
    if len(below) == 0 and wall:
        return float(y.min())
    if len(below) == 0:
        raise ContactError(
            f"rail {name!r} ends {depth.max() * 1e3:.2f} mm below its top on the gauge side; the gauge is measured "
            f"{PROFILES.gauge_depth * 1e3:.0f} mm below",
            field="rail",
        )
    last = int(below[-1])
    share = (PROFILES.gauge_depth - depth[last]) / (depth[last + 1] - depth[last])
    crossing = y[last] + share * (y[last + 1] - y[last])
    return float(min(crossing, y[last + 1 :].min()))


def _run(slope: FloatArray, z: FloatArray, start: int, direction: int) -> int:
    """Return the last index from ``start`` in ``direction`` (+1, -1) up to which the surface can be touched."""
    # it ends where the surface is too steep over more than a notch of height; a point or two of noise do not end it
    steep = np.abs(slope[start::direction]) >= PROFILES.steepest_slope
    height = z[start::direction]
    for first, behind in runs(steep):
        before, after = max(first - 1, 0), min(behind, len(steep) - 1)
        if abs(height[after] - height[before]) > PROFILES.notch_height or behind == len(steep):
            return start + direction * int(before)
    return start + direction * (len(steep) - 1)


def _gridded(y: FloatArray, z: FloatArray, slope: FloatArray) -> Surface:
    curve = CubicHermiteSpline(y, z, slope)
    grid = y[0] + PROFILES.grid_step * np.arange(int((y[-1] - y[0]) / PROFILES.grid_step) + 1)
    return Surface(float(y[0]), PROFILES.grid_step, curve(grid), curve(grid, nu=1))

"""The design that a measured profile comes from: a curve along its arc, moved to where the measured points are.

A new wheel or rail is its design. The corners and joints of arcs that noise hides in its points are known from it.
Which design it is, and where, is found by the rigid movement that brings the points nearest; it is used only where the
points differ from it by no more than their noise, because wear removes corners.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import cKDTree

from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import HEIGHTS, THICKNESSES, ProfileKind, rail_profile, wheel_profile
from estimation.contact.wheel_definitions import RAIL_DEFINITIONS, WHEEL_DEFINITIONS, Segment
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.units import MILLIMETRE

_TREADS = ("S1002", "1/40")

_Movement = tuple[float, float, float]  # shift across and down (mm) after a turn about the origin (rad)


@dataclass(frozen=True, slots=True)
class DesignCurve(FrozenArrays):
    """A design profile over its arc, in the axes of the points; mm."""

    name: str
    arc: Annotated[FloatArray, "m"]  # mm
    points: Annotated[FloatArray, "m", 2]  # mm
    tangent: Annotated[FloatArray, "m", 2]  # of length 1
    inner: tuple[float, float]  # arc of what is or may be in contact, mm
    turn: float = 0.0  # rad, by which the points are turned against the design

    def at(self, arc: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points and derivatives (n, 2) at arc (n,), mm; beyond the ends straight on."""
        inside = np.clip(arc, self.arc[0], self.arc[-1])
        curve = CubicHermiteSpline(self.arc, self.points, self.tangent)
        derivative = np.asarray(curve(inside, nu=1))
        return np.asarray(curve(inside)) + (arc - inside)[:, np.newaxis] * derivative, derivative

    def foot(self, points: FloatArray) -> FloatArray:
        """Return the arc (n,) of the nearest point of the curve to each of the points (n, 2), mm."""
        return _foot(self, cKDTree(self.points), points)[0]


def nearest_design(kind: ProfileKind, points: FloatArray) -> DesignCurve | None:
    """Return the design nearest to measured points (n, 2), mm, moved to them; None if they are of no known one."""
    shown = points[np.unique(np.linspace(0, len(points) - 1, PROFILES.placing_points).astype(np.int64))]
    found = []
    for name in _names(kind, shown):
        start = _start(_design(kind, name)[0], shown) if kind == "rail" else (0.0, 0.0, 0.0)
        movement = _moved(kind, name, start, shown, PROFILES.search_reaches[:1])
        found.append((_distance(kind, name, movement, shown), name, movement))
    best, reaches = sorted(found)[: PROFILES.finalist_designs], PROFILES.search_reaches[1:]
    finals = [(name, _moved(kind, name, start, shown, reaches)) for _, name, start in best]
    name, movement = min(finals, key=lambda final: _distance(kind, final[0], final[1], shown))
    design = _design(kind, name)[0]
    if float(np.median(np.abs(_across(kind, name, movement, shown)[0]))) > PROFILES.most_design_distance:
        return None
    turn = _rotation(movement[2])
    return DesignCurve(
        name, design.arc, design.points @ turn + movement[:2], design.tangent @ turn, design.inner, movement[2]
    )


def explains(design: DesignCurve, points: FloatArray, noise: FloatArray, length: float) -> bool:
    """Return whether points (n, 2), mm, differ from a design by no more than their noise (n,), mm, where wheels touch.

    ``length`` is the arc over which neighbours share noise, mm.
    """
    arc = design.foot(points)
    at, tangent = design.at(arc)
    across = ((points - at) * np.column_stack([-tangent[:, 1], tangent[:, 0]])).sum(axis=1)
    inside = (arc >= design.inner[0]) & (arc <= design.inner[1])
    if np.count_nonzero(inside) < PROFILES.fewest_design_points:
        return False
    across = across[inside] / noise[inside]
    spacing = float(np.median(np.diff(np.sort(arc[inside]))))
    alike = math.exp(-spacing / length) if length > 0.0 else 0.0
    for window in PROFILES.averaging_lengths:
        count = max(1, round(window / spacing))
        if count >= len(across):
            break
        mean = np.convolve(across, np.full(count, 1.0 / count), "valid")
        std = math.sqrt((1.0 + alike) / (1.0 - alike) / count)
        if float(np.abs(mean).max()) > PROFILES.significant_stds * std:
            return False
    return True


def _names(kind: ProfileKind, points: FloatArray) -> list[str]:
    if kind == "rail":
        return _different(RAIL_DEFINITIONS)
    height = min(
        np.arange(HEIGHTS[0], HEIGHTS[1] + 0.1, 2.0), key=lambda value: abs(float(value) - float(points[:, 1].max()))
    )
    thicknesses = np.arange(THICKNESSES[0], THICKNESSES[1] + 0.1, PROFILES.thickness_step)
    family = [f"EN13715-{tread}/h{height:g}/e{thickness:g}" for tread in _TREADS for thickness in thicknesses]
    return [*(name for name in _different(WHEEL_DEFINITIONS) if name != "S1002"), *family]  # S1002 is of the family


def _different(definitions: Mapping[str, tuple[Segment, ...]]) -> list[str]:
    return list({segments: name for name, segments in reversed(list(definitions.items()))}.values())


@cache
def _design(kind: ProfileKind, name: str) -> tuple[DesignCurve, cKDTree]:
    profile = wheel_profile(name) if kind == "wheel" else rail_profile(name)
    points = np.column_stack([profile.y, profile.z]) / MILLIMETRE
    tangent = np.column_stack([np.ones(len(profile.y)), profile.slope]) / np.hypot(1.0, profile.slope)[:, np.newaxis]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    y, z = points.T
    begin, end = PROFILES.design_wheel_range
    inside = (y >= begin) & (y <= end) if kind == "wheel" else z - z.min() <= PROFILES.design_rail_depth
    inner = float(arc[inside][0]), float(arc[inside][-1])
    return DesignCurve(name, arc, points, tangent, inner), cKDTree(points)


def _start(design: DesignCurve, points: FloatArray) -> _Movement:
    middles = []
    for head in (design.points, points):
        upper = head[head[:, 1] < head[:, 1].min() + PROFILES.head_depth, 0]
        middles.append(0.5 * float(upper.min() + upper.max()))
    return middles[1] - middles[0], float(points[:, 1].min() - design.points[:, 1].min()), 0.0


def _moved(
    kind: ProfileKind, name: str, movement: _Movement, points: FloatArray, reaches: tuple[float, ...]
) -> _Movement:
    for reach in reaches:
        for _ in range(PROFILES.search_rounds):
            across, at, normal = _across(kind, name, movement, points)
            # a small turn moves the foot at right angles to its arm
            matrix = np.column_stack([normal, at[:, 0] * normal[:, 1] - at[:, 1] * normal[:, 0]])
            weight = 1.0 / (1.0 + (across / reach) ** 2) ** 2
            step = np.linalg.lstsq(matrix * weight[:, np.newaxis], across * weight, rcond=None)[0]
            shift = np.array(movement[:2]) @ _rotation(float(step[2])) + step[:2]
            movement = float(shift[0]), float(shift[1]), movement[2] + float(step[2])
    return movement


def _rotation(turn: float) -> FloatArray:
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([[cos, sin], [-sin, cos]])


def _across(
    kind: ProfileKind, name: str, movement: _Movement, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the distance (n,) of each point across the moved design, the foot of each, and the normal there (n, 2)."""
    design, tree = _design(kind, name)
    turn = _rotation(movement[2])
    arc, nearest = _foot(design, tree, (points - movement[:2]) @ turn.T)
    tangent = design.tangent[nearest] @ turn
    at = design.points[nearest] @ turn + movement[:2] + (arc - design.arc[nearest])[:, np.newaxis] * tangent
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    return ((points - at) * normal).sum(axis=1), at, normal


def _foot(design: DesignCurve, tree: cKDTree, points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the arc (n,) of the foot of each point, and the index of the point of the design nearest to it."""
    nearest = np.asarray(tree.query(points)[1], dtype=np.int64)
    along = ((points - design.points[nearest]) * design.tangent[nearest]).sum(axis=1)
    step = float(np.diff(design.arc).max())
    inner = (nearest > 0) & (nearest < len(design.arc) - 1)
    return np.asarray(design.arc[nearest] + np.where(inner, np.clip(along, -step, step), along)), nearest


def _distance(kind: ProfileKind, name: str, movement: _Movement, points: FloatArray) -> float:
    across = np.abs(_across(kind, name, movement, points)[0])
    return float(np.minimum(across, PROFILES.search_reaches[-1]).mean())

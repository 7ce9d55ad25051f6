"""Pieces that analytic profiles are made of: arcs, straight lines, polynomials. Millimetres, as in the standards."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimation.values.arrays import FloatArray

_SAME_POINT = 1e-9  # mm, joints are points of both neighbours
_VERTICAL = 100.0  # slope from which a surface counts as vertical


@dataclass(frozen=True, slots=True)
class Arc:
    """``z = centre_z + side * sqrt(radius^2 - (y - centre_y)^2)`` for start <= y <= end; mm, z down.

    ``side`` is -1 where the surface is above the centre (rail heads, hollow treads), +1 below it (flange tips).
    """

    start: float
    end: float
    centre_y: float
    centre_z: float
    radius: float
    side: int

    def height(self, y: FloatArray) -> FloatArray:
        """Return z (n,) at y (n,), mm."""
        return np.asarray(self.centre_z + self.side * np.sqrt(self.radius**2 - (y - self.centre_y) ** 2))

    def slope(self, y: FloatArray) -> FloatArray:
        """Return dz/dy (n,) at y (n,)."""
        offset = y - self.centre_y
        with np.errstate(divide="ignore"):
            return np.asarray(-self.side * offset / np.sqrt(self.radius**2 - offset**2))

    def knots(self, step: float) -> FloatArray:
        """Return y (n,) from start to end, at most ``step`` apart along the arc, mm."""
        first = math.asin((self.start - self.centre_y) / self.radius)
        last = math.asin((self.end - self.centre_y) / self.radius)
        count = 2 + int((last - first) * self.radius / step)
        y = self.centre_y + self.radius * np.sin(np.linspace(first, last, count))
        y[0], y[-1] = self.start, self.end
        return y


@dataclass(frozen=True, slots=True)
class Line:
    """``z = reference_z + gradient * (y - reference_y)`` for start <= y <= end; mm, z down."""

    start: float
    end: float
    reference_y: float
    reference_z: float
    gradient: float

    def height(self, y: FloatArray) -> FloatArray:
        """Return z (n,) at y (n,), mm."""
        return self.reference_z + self.gradient * (y - self.reference_y)

    def slope(self, y: FloatArray) -> FloatArray:
        """Return dz/dy (n,) at y (n,)."""
        return np.full_like(y, self.gradient)

    def knots(self, step: float) -> FloatArray:
        """Return y (n,) from start to end, at most ``step`` apart along the line, mm."""
        length = (self.end - self.start) * math.hypot(1.0, self.gradient)
        return np.linspace(self.start, self.end, 2 + int(length / step))


@dataclass(frozen=True, slots=True)
class Polynomial:
    """``z = sum of coefficients[i] y^i`` for start <= y <= end; mm, z down."""

    start: float
    end: float
    coefficients: tuple[float, ...]

    def height(self, y: FloatArray) -> FloatArray:
        """Return z (n,) at y (n,), mm."""
        return np.asarray(np.polynomial.Polynomial(self.coefficients)(y))

    def slope(self, y: FloatArray) -> FloatArray:
        """Return dz/dy (n,) at y (n,)."""
        return np.asarray(np.polynomial.Polynomial(self.coefficients).deriv()(y))

    def knots(self, step: float) -> FloatArray:
        """Return y (n,) from start to end, at most ``step`` apart across, mm."""
        return np.linspace(self.start, self.end, 2 + int((self.end - self.start) / step))


Segment = Arc | Line | Polynomial


def evaluate(segments: Sequence[Segment], y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return height and slope of adjoining segments at y; NaN outside all of them.

    Args:
        segments: In increasing y, each beginning where the one before ends.
        y: (n,) mm. A joint belongs to the segment that ends there.
    """
    height = np.full(len(y), np.nan)
    slope = np.full(len(y), np.nan)
    for segment in reversed(segments):
        inside = (y >= segment.start) & (y <= segment.end)
        height[inside] = segment.height(y[inside])
        slope[inside] = segment.slope(y[inside])
    return height, slope


def sample(segments: Sequence[Segment], step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return y, z and dz/dy (n,) along adjoining segments, every joint included, without vertical ends; mm.

    Printed coefficients leave steps of up to 8e-4 mm at joints. They are closed by raising or lowering the segments
    away from y = 0: a step of 5e-5 mm, smeared over one sample, would move a contact on near-conformal arcs by 0.05 mm.

    Args:
        segments: In increasing y, each beginning where the one before ends; mm.
        step: Largest distance between points along the surface, mm.
    """
    y = np.unique(np.concatenate([segment.knots(step) for segment in segments]))
    y = y[np.concatenate([[True], np.diff(y) > _SAME_POINT])]
    height, slope = evaluate(segments, y)
    for before, after in pairwise(segments):
        joint = np.array([before.end])
        rise = float(after.height(joint)[0] - before.height(joint)[0])
        if before.end <= 0.0:
            height[y <= before.end] += rise
        else:
            height[y > before.end] -= rise
    usable = np.abs(slope) < _VERTICAL
    return y[usable], height[usable], slope[usable]

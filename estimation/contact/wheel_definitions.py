"""Wheel profiles and rail heads by their standards. Millimetres; y to the field side, z down.

y of a wheel is from its tread datum, 70 mm from the flange back. Sources: EN 15302:2021 Annex I (wheels A, B, C, H, I;
wheel C is the BR P8 profile; rail A in track axes, inclined 1:20 already, y = 0 at 750 mm from the track centre at a
gauge of 1435.16 mm), UIC 510-2 / EN 13715 Annex C (S1002, flange height 28 mm, thickness 32.5 mm), EN 13674-1:2017
(radii, widths between the joints of arcs, inclination of the sides), UIC 861-3 (the older UIC60 head).

The heads of EN 13674-1 are here whose dimensions agree with each other: their arcs end where the head is a whole
number of millimetres wide, to 0.001 mm (56E1: 69.85 mm; 46E3: where its sides meet the top). The transcribed 54E2,
54E5 and 54E6 do not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

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
    """Return height and slope of adjoining segments at y (n,), mm, NaN outside; a joint is of the one ending there."""
    height = np.full(len(y), np.nan)
    slope = np.full(len(y), np.nan)
    for segment in reversed(segments):
        inside = (y >= segment.start) & (y <= segment.end)
        height[inside] = segment.height(y[inside])
        slope[inside] = segment.slope(y[inside])
    return height, slope


def sample(segments: Sequence[Segment], step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return y, z and dz/dy (n,) along adjoining segments, every joint included, without vertical ends; mm.

    Points are at most ``step`` apart along the surface. Printed coefficients leave steps of up to 8e-4 mm at joints.
    They are closed by raising or lowering the segments away from y = 0: a step of 5e-5 mm, smeared over one sample,
    would move a contact on near-conformal arcs by 0.05 mm.
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


S1002_THROAT = (
    -4.320221063e3,
    -1.038384026e3,
    -1.065501873e2,
    -6.051367875,
    -2.054332446e-1,
    -4.169739389e-3,
    -4.687195829e-5,
    -2.252755540e-7,
)
S1002_TREAD = (
    0.0,
    -3.358537058e-2,
    1.565681624e-3,
    -2.810427944e-5,
    5.844240864e-8,
    -1.562379023e-8,
    5.309217349e-15,
    -5.957839843e-12,
    2.646656573e-13,
)
"""Coefficients of the S1002 between -35 and -26 mm, and from there to 32.158 mm."""


def _flange(face_end: float, centre_shift: tuple[float, float] = (0.0, 0.0), face_z: float = -93.5767) -> list[Segment]:
    tip, outer = centre_shift
    return [
        Arc(-70.0, -62.7647, -49.5, 9.5193, 20.5, 1),
        Arc(-62.7647, -49.6625, -55.0, 16.0 + tip, 12.0, 1),
        Arc(-49.6625, -39.7645, -58.5583, 8.8349 + outer, 20.0, 1),
        Line(-39.7645, face_end, 0.0, face_z, -2.7475),
    ]


_WHEEL_A = (
    *_flange(-38.7372, (0.00065, 0.00066), -93.57685),
    Arc(-38.7372, -29.4591, -25.5816, 17.64215, 14.0, -1),
    Arc(-29.4591, -10.8749, -2.6594, 97.16493, 96.76055, -1),
    Arc(-10.8749, 18.4173, 18.4173, 344.50806, 345.0, -1),
    Line(18.4173, 30.0, 30.0, -0.49194, 0.0),
    Line(30.0, 60.0, 0.0, 1.50804, -0.066666),
    Line(60.0, 65.0, 0.0, 57.50808, -1.0),
)

_WHEEL_B = (
    *_flange(-38.7879),
    Arc(-38.7879, -29.3505, -25.6322, 17.7814, 14.0, -1),
    Arc(-29.3505, -0.4787, 2.5204, 119.9745, 120.0, -1),
    Line(-0.4787, 30.0, 0.0, 0.0, -0.025),
    Line(30.0, 60.0, 0.0, 0.75, -0.05),
    Line(60.0, 65.0, 0.0, 57.75, -1.0),
)

_WHEEL_C = (
    Line(-70.0, -69.4027, -69.40268, 21.39173, 7.11537),
    Arc(-69.4027, -59.5, -59.5, 20.00006, 10.0, 1),
    Arc(-59.5, -43.8048, -60.4941, 12.02753, 18.0, 1),
    Line(-43.8048, -41.0534, -41.05339, 11.96051, -2.47508685),
    Arc(-41.0534, -32.3621, -29.0, 16.830365, 13.0, -1),
    Arc(-32.3621, -17.587, -6.5, 100.870534, 100.0, -1),
    Arc(-17.587, 19.0, 19.0, 329.45258, 330.0, -1),
    Line(19.0, 29.0, 29.0, -0.54742374, 0.0),
    Line(29.0, 59.0, 29.0, -0.54742374, -0.1),
    Line(59.0, 65.0, 59.0, -3.54742374, -1.0),
)

_WHEEL_H = (
    *_flange(-38.722),
    Arc(-38.722, -28.3119, -25.5663, 17.6003, 14.0, -1),
    Line(-28.3119, -10.2297, 0.0, -1.7902, -0.2),
    Line(-10.2297, 30.0, 0.0, 0.0, -0.025),
    Line(30.0, 60.0, 0.0, 1.251, -0.0667),
    Line(60.0, 65.0, 0.0, 57.249, -1.0),
)

_WHEEL_I = (
    *_flange(-39.0486, (0.00054, 0.00055)),
    Arc(-39.0486, -29.9231, -25.8929, 18.49733, 14.0, -1),
    Arc(-29.9231, 5.0, 5.0, 119.895788082818, 120.0, -1),
    Line(5.0, 30.0, 5.0, -0.104211917182, 0.0),
    Line(30.0, 60.0, 0.0, 1.89679, -0.0667),
    Line(60.0, 65.0, 0.0, 57.89479, -1.0),
)

_S1002 = (
    Arc(-70.0, -62.764705882, -49.5, 9.519259302, 20.5, 1),
    Arc(-62.764705882, -49.662510381, -55.0, 16.0, 12.0, 1),
    Arc(-49.662510381, -39.764473993, -58.558326413, 8.834924130, 20.0, 1),
    Line(-39.764473993, -38.426669071, 0.0, -93.576667419, -2.747477419),
    Arc(-38.426669071, -35.0, -26.210665, 16.446, 13.0, -1),
    Polynomial(-35.0, -26.0, S1002_THROAT),
    Polynomial(-26.0, 32.15796, S1002_TREAD),
    Line(32.15796, 60.0, 0.0, 1.364323640, -0.066666667),
)


WHEEL_DEFINITIONS: Mapping[str, tuple[Segment, ...]] = MappingProxyType(
    {
        "P8": _WHEEL_C,
        "S1002": _S1002,
        "EN15302-A": _WHEEL_A,
        "EN15302-B": _WHEEL_B,
        "EN15302-C": _WHEEL_C,
        "EN15302-H": _WHEEL_H,
        "EN15302-I": _WHEEL_I,
    }
)


_UPRIGHT = 99.0  # slope of vertical sides; profiles are heights over y

_SIDE_DEPTH = 8.0


def _head(radii: tuple[float, ...], widths: tuple[float, ...], side: float = 20.0) -> tuple[Segment, ...]:
    """Return a symmetric head: tangent arcs of ``radii``, their joints ``widths`` apart, then sides of that slope."""
    half: list[Arc] = []
    centre_y, centre_z, start = 0.0, radii[0], 0.0
    for radius, width, following in zip(radii, widths, radii[1:], strict=False):
        end = 0.5 * width
        half.append(Arc(start, end, centre_y, centre_z, radius, -1))
        joint_z = centre_z - math.sqrt(radius**2 - (end - centre_y) ** 2)
        centre_y = end + (centre_y - end) * following / radius
        centre_z = joint_z + (centre_z - joint_z) * following / radius
        start = end
    edge_y = centre_y + radii[-1] * side / math.hypot(1.0, side)
    edge_z = centre_z - math.sqrt(radii[-1] ** 2 - (edge_y - centre_y) ** 2)
    half.append(Arc(start, edge_y, centre_y, centre_z, radii[-1], -1))
    foot_y = edge_y + _SIDE_DEPTH / side
    crown = Arc(-half[0].end, half[0].end, 0.0, radii[0], radii[0], -1)
    left = [Arc(-arc.end, -arc.start, -arc.centre_y, arc.centre_z, arc.radius, -1) for arc in reversed(half[1:])]
    return (
        Line(-foot_y, -edge_y, -edge_y, edge_z, -side),
        *left,
        crown,
        *half[1:],
        Line(edge_y, foot_y, edge_y, edge_z, side),
    )


_RAIL_A = (
    Arc(-32.6340, -23.2401, -19.63949, 15.899044, 13.0, -1),
    Arc(-23.2401, -7.8749, -1.08250, 80.277908, 80.0, -1),
    Arc(-7.8749, 13.0989, 17.59660, 299.483490, 300.0, -1),
    Arc(13.0989, 28.6709, 14.29829, 79.508225, 80.0, -1),
    Arc(28.6709, 39.2705, 26.33535, 13.598369, 13.0, -1),
)


_56E1 = _head((305.0, 80.0, 12.7), (11.787, 51.235))
_46E2 = _head((200.0, 60.0, 13.0), (27.946, 40.588))
_49E1 = _head((300.0, 80.0, 13.0), (15.267, 46.835), 17.2)
_49E2 = _head((400.0, 14.0), (40.471,), 16.0)
_49E5 = _head((115.0, 16.5, 15.5, 7.64), (41.342, 62.98, 66.0), 17.2)
_50E1 = _head((200.0, 60.0, 13.0), (30.942, 43.838))
_60E1 = _head((300.0, 80.0, 13.0), (20.456, 52.053))

RAIL_DEFINITIONS: Mapping[str, tuple[Segment, ...]] = MappingProxyType(
    {
        "56E1": _56E1,
        "BS113A": _56E1,
        "113A": _56E1,
        "60E1": _60E1,
        "60E2": _head((200.0, 70.0, 16.0, 8.0), (23.778, 48.913, 70.774)),
        "54E1": _head((300.0, 80.0, 13.0), (20.024, 49.727)),
        "46E1": _head((300.0, 80.0, 13.0), (18.881, 43.881), _UPRIGHT),
        "46E2": _46E2,
        "46E3": _head((300.0, 80.0, 13.0), (23.015, 53.761), 16.5),
        "46E4": _head((400.0, 14.0), (38.378,)),
        "49E1": _49E1,
        "49E2": _49E2,
        "49E5": _49E5,
        "50E1": _50E1,
        "50E2": _60E1,
        "50E3": _head((300.0, 80.0, 13.0), (18.233, 49.982)),
        "50E4": _head((300.0, 80.0, 13.0), (20.025, 49.727)),
        "50E5": _49E2,
        "50E6": _50E1,
        "52E1": _head((350.0, 12.0), (42.456,), _UPRIGHT),
        "54E3": _49E1,
        "54E4": _49E5,
        "55E1": _46E2,
        "UIC60": _head((300.0, 80.0, 13.0), (21.0, 51.98)),
        "EN15302-A": _RAIL_A,
    }
)

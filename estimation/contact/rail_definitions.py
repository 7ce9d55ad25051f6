"""Rail heads as their standards define them. Millimetres; y to the field side, z down.

Sources: EN 13674-1:2017 (radii, widths between the joints of arcs, inclination of the sides; each arc is tangent to the
one before), UIC 861-3 (the older UIC60 head), EN 15302:2021 Annex I.7 (rail A, given in track axes: inclined
1:20 already, y = 0 at 750 mm from the track centre at a gauge of 1435.16 mm).

The heads of EN 13674-1 are here whose dimensions agree with each other: their arcs end where the head is a whole
number of millimetres wide, to 0.001 mm (56E1: 69.85 mm; 46E3: where its sides meet the top). The transcribed 54E2,
54E5 and 54E6 do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

from estimation.contact.segments import Arc, Line, Segment

_UPRIGHT = 99.0
"""Slope of vertical sides; profiles are heights over y."""

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


def _rail_a() -> tuple[Segment, ...]:
    return (
        Arc(-32.6340, -23.2401, -19.63949, 15.899044, 13.0, -1),
        Arc(-23.2401, -7.8749, -1.08250, 80.277908, 80.0, -1),
        Arc(-7.8749, 13.0989, 17.59660, 299.483490, 300.0, -1),
        Arc(13.0989, 28.6709, 14.29829, 79.508225, 80.0, -1),
        Arc(28.6709, 39.2705, 26.33535, 13.598369, 13.0, -1),
    )


_56E1 = partial(_head, (305.0, 80.0, 12.7), (11.787, 51.235))
_46E2 = partial(_head, (200.0, 60.0, 13.0), (27.946, 40.588))
_49E1 = partial(_head, (300.0, 80.0, 13.0), (15.267, 46.835), 17.2)
_49E2 = partial(_head, (400.0, 14.0), (40.471,), 16.0)
_49E5 = partial(_head, (115.0, 16.5, 15.5, 7.64), (41.342, 62.98, 66.0), 17.2)
_50E1 = partial(_head, (200.0, 60.0, 13.0), (30.942, 43.838))
_60E1 = partial(_head, (300.0, 80.0, 13.0), (20.456, 52.053))

RAIL_DEFINITIONS: Mapping[str, Callable[[], tuple[Segment, ...]]] = MappingProxyType(
    {
        "56E1": _56E1,
        "BS113A": _56E1,
        "113A": _56E1,
        "60E1": _60E1,
        "60E2": partial(_head, (200.0, 70.0, 16.0, 8.0), (23.778, 48.913, 70.774)),
        "54E1": partial(_head, (300.0, 80.0, 13.0), (20.024, 49.727)),
        "46E1": partial(_head, (300.0, 80.0, 13.0), (18.881, 43.881), _UPRIGHT),
        "46E2": _46E2,
        "46E3": partial(_head, (300.0, 80.0, 13.0), (23.015, 53.761), 16.5),
        "46E4": partial(_head, (400.0, 14.0), (38.378,)),
        "49E1": _49E1,
        "49E2": _49E2,
        "49E5": _49E5,
        "50E1": _50E1,
        "50E2": _60E1,
        "50E3": partial(_head, (300.0, 80.0, 13.0), (18.233, 49.982)),
        "50E4": partial(_head, (300.0, 80.0, 13.0), (20.025, 49.727)),
        "50E5": _49E2,
        "50E6": _50E1,
        "52E1": partial(_head, (350.0, 12.0), (42.456,), _UPRIGHT),
        "54E3": _49E1,
        "54E4": _49E5,
        "55E1": _46E2,
        "UIC60": partial(_head, (300.0, 80.0, 13.0), (21.0, 51.98)),
        "EN15302-A": _rail_a,
    }
)

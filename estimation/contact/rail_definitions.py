"""Rail heads as their standards define them. Millimetres; y to the field side, z down.

Sources: EN 13674-1:2017 (56E1 = BS 113A, 60E1, 60E2, 54E1: radii and joint widths, each arc tangent to the one
before, sides 1:20), UIC 861-3 (the older UIC60 head), EN 15302:2021 Annex I.7 (rail A, given in track axes: inclined
1:20 already, y = 0 at 750 mm from the track centre at a gauge of 1435.16 mm).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from estimation.contact.segments import Arc, Line, Segment

_SIDE_GRADIENT = 20.0
_SIDE_DEPTH = 8.0


def _head(radii: tuple[float, ...], joints: tuple[float, ...]) -> tuple[Segment, ...]:
    """Return a symmetric head: tangent arcs of ``radii`` that meet at ``joints`` (one fewer), then the 1:20 side."""
    half: list[Arc] = []
    centre_y, centre_z, start = 0.0, radii[0], 0.0
    steepest = _SIDE_GRADIENT / math.hypot(1.0, _SIDE_GRADIENT)
    for index, radius in enumerate(radii):
        end = joints[index] if index < len(joints) else centre_y + radius * steepest
        half.append(Arc(start, end, centre_y, centre_z, radius, -1))
        if index < len(joints):
            joint_z = centre_z - math.sqrt(radius**2 - (end - centre_y) ** 2)
            ratio = radii[index + 1] / radius
            centre_y = end + (centre_y - end) * ratio
            centre_z = joint_z + (centre_z - joint_z) * ratio
            start = end
    edge_y = half[-1].end
    edge_z = centre_z - math.sqrt(radii[-1] ** 2 - (edge_y - centre_y) ** 2)
    foot_y = edge_y + _SIDE_DEPTH / _SIDE_GRADIENT
    crown = Arc(-half[0].end, half[0].end, 0.0, radii[0], radii[0], -1)
    left = [Arc(-arc.end, -arc.start, -arc.centre_y, arc.centre_z, arc.radius, -1) for arc in reversed(half[1:])]
    return (
        Line(-foot_y, -edge_y, -edge_y, edge_z, -_SIDE_GRADIENT),
        *left,
        crown,
        *half[1:],
        Line(edge_y, foot_y, edge_y, edge_z, _SIDE_GRADIENT),
    )


def _rail_a() -> tuple[Segment, ...]:
    return (
        Arc(-32.6340, -23.2401, -19.63949, 15.899044, 13.0, -1),
        Arc(-23.2401, -7.8749, -1.08250, 80.277908, 80.0, -1),
        Arc(-7.8749, 13.0989, 17.59660, 299.483490, 300.0, -1),
        Arc(13.0989, 28.6709, 14.29829, 79.508225, 80.0, -1),
        Arc(28.6709, 39.2705, 26.33535, 13.598369, 13.0, -1),
    )


def _rail_56e1() -> tuple[Segment, ...]:
    return _head((305.0, 80.0, 12.7), (5.8935, 25.6175))


def _rail_60e1() -> tuple[Segment, ...]:
    return _head((300.0, 80.0, 13.0), (10.228, 26.0265))


def _rail_60e2() -> tuple[Segment, ...]:
    return _head((200.0, 70.0, 16.0, 8.0), (11.889, 24.4565, 35.387))


def _rail_54e1() -> tuple[Segment, ...]:
    return _head((300.0, 80.0, 13.0), (10.012, 24.8635))


def _rail_uic60() -> tuple[Segment, ...]:
    return _head((300.0, 80.0, 13.0), (10.5, 25.99))


RAIL_DEFINITIONS: Mapping[str, Callable[[], tuple[Segment, ...]]] = MappingProxyType(
    {
        "56E1": _rail_56e1,
        "BS113A": _rail_56e1,
        "113A": _rail_56e1,
        "60E1": _rail_60e1,
        "60E2": _rail_60e2,
        "54E1": _rail_54e1,
        "UIC60": _rail_uic60,
        "EN15302-A": _rail_a,
    }
)

"""Wheel profiles of EN 13715:2020 by their designation: tread, flange height h, flange thickness e, outer slope.

Millimetres; y to the field side from the tread datum, z down. Of the treads S1002 and 1/40 all coordinates are known;
EPS is not here, because the table of its transition zone is not (its tread on another flange is P8, EN 15302 wheel C).
The arc between the tip and the face of the flange is computed from being tangent to both, which gives the printed
centres for h = 28, 30 and 32 mm. A thinner flange moves with its root and throat up to T1, half a millimetre inside
the tread datum; a straight line joins T1 and the datum, as it is printed for 1/40.
"""

from __future__ import annotations

import math
import re

from estimation.contact.wheel_definitions import S1002_THROAT, S1002_TREAD, Arc, Line, Polynomial, Segment
from estimation.errors import ProfileError

NAMES = "EN13715-S1002/h28/e32.5, EN13715-1/40/h28/e32.5 (h 28 to 32, e 28.5 to 32.5, outer slope as /6.7%)"
"""How the designations are written, for messages."""

HEIGHTS, THICKNESSES, SLOPES = (28.0, 32.0), (28.5, 32.5), (6.6, 15.0)
_DESIGNATION = re.compile(
    r"^(?:en\s*13715\W*)?(?P<tread>s1002|1[/:]40)\W+h\s*(?P<h>\d+(?:\.\d+)?)\W+e\s*(?P<e>\d+(?:\.\d+)?)"
    r"(?:\W+(?P<slope>\d+(?:\.\d+)?)\s*%?)?$",
    re.IGNORECASE,
)
_FACE = 2.747477419  # tan 70 degrees
_FACE_END = (-38.426669071, 12.0)  # E1
_ROOT = (-26.210665, 16.446, 13.0)
_TIP_RADIUS = 12.0
_TREAD_INSIDE = -0.5  # T1
_RIM = 60.0  # wheel width 135 mm
_USUAL_SLOPE = 100.0 / 15.0


def en13715_wheel(name: str) -> tuple[Segment, ...] | None:
    """Return the profile of a designation as ``EN13715-S1002/h30/e31.5/6.7%``; None if the name is no designation.

    ``EN13715``, the outer slope (per cent, by default 1:15) and punctuation are free.

    Raises:
        ProfileError: A dimension outside the standard's range.
    """
    found = _DESIGNATION.match(name.strip())
    if found is None:
        return None
    height, thickness = float(found["h"]), float(found["e"])
    slope = float(found["slope"]) if found["slope"] else _USUAL_SLOPE
    ranges = (("h", height, HEIGHTS), ("e", thickness, THICKNESSES), ("slope", slope, SLOPES))
    for field, value, (low, high) in ranges:
        if not low <= value <= high:
            raise ProfileError(f"{name!r}: {field} = {value:g} is outside {low:g} to {high:g}", field="wheel")
    thinner = 32.5 - thickness
    tread = _s1002_tread(thinner) if found["tread"].lower() == "s1002" else _cone_tread(thinner)
    segments = [*_flange(height - 28.0, thinner), *tread]
    last = segments[-1]
    rim = last.end
    z = float(_height_at_end(last))
    return (*segments, Line(rim, _RIM, rim, z, -slope / 100.0))


def _height_at_end(segment: Segment) -> float:
    if isinstance(segment, Line):
        return segment.reference_z + segment.gradient * (segment.end - segment.reference_y)
    if isinstance(segment, Polynomial):
        return math.fsum(c * segment.end**power for power, c in enumerate(segment.coefficients))
    return segment.centre_z + segment.side * math.sqrt(segment.radius**2 - (segment.end - segment.centre_y) ** 2)


def _flange(higher: float, thinner: float) -> list[Segment]:
    """Return the flange from its back to E1; it is ``higher`` than 28 mm and ``thinner`` than 32.5 mm."""
    tip_y, tip_z = -55.0 - thinner, 16.0 + higher
    radius = 20.0 + 0.75 * higher
    face_y = _FACE_END[0] - thinner
    length = math.hypot(1.0, _FACE)
    normal = (-_FACE / length, -1.0 / length)  # from the face into the flange
    foot = (face_y + radius * normal[0], _FACE_END[1] + radius * normal[1])
    along = (1.0 / length, -_FACE / length)  # down the face, towards the tread
    # the centre is on the parallel of the face at the radius, and radius - 12 from the centre of the tip
    ahead = (tip_y - foot[0]) * along[0] + (tip_z - foot[1]) * along[1]
    across = (tip_y - foot[0]) * normal[0] + (tip_z - foot[1]) * normal[1]
    back = ahead - math.sqrt((radius - _TIP_RADIUS) ** 2 - across**2)
    forth = 2.0 * ahead - back
    t = min((back, forth), key=lambda value: abs(_below(foot, along, value) - (8.8349 + 1.86 * higher)))
    centre = (foot[0] + t * along[0], foot[1] + t * along[1])
    start_face = (centre[0] - radius * normal[0], centre[1] - radius * normal[1])
    share = _TIP_RADIUS / (radius - _TIP_RADIUS)
    joint = tip_y + share * (tip_y - centre[0])
    top = -55.0 - thinner / 2.0
    segments: list[Segment] = [
        Arc(-70.0, -62.764705882, -49.5, 9.519259302 + higher, 20.5, 1),
        Arc(-62.764705882, top, -55.0, tip_z, _TIP_RADIUS, 1),
        Arc(top, joint, tip_y, tip_z, _TIP_RADIUS, 1),
        Arc(joint, start_face[0], centre[0], centre[1], radius, 1),
        Line(start_face[0], face_y, face_y, _FACE_END[1], -_FACE),
    ]
    return segments


def _below(foot: tuple[float, float], along: tuple[float, float], t: float) -> float:
    return foot[1] + t * along[1]


def _s1002_tread(thinner: float) -> list[Segment]:
    y, z, radius = _ROOT
    inside = _TREAD_INSIDE - thinner
    throat: list[Segment] = [
        Arc(_FACE_END[0] - thinner, -35.0 - thinner, y - thinner, z, radius, -1),
        _moved(Polynomial(-35.0, -26.0, S1002_THROAT), -thinner),
    ]
    outside = Polynomial(0.0, 32.15796, S1002_TREAD)
    if thinner == 0.0:
        return [*throat, Polynomial(-26.0, 32.15796, S1002_TREAD)]
    tread = _moved(Polynomial(-26.0, _TREAD_INSIDE, S1002_TREAD), -thinner)
    joint = _height_at_end(Polynomial(-26.0, _TREAD_INSIDE, S1002_TREAD))
    return [*throat, tread, Line(inside, 0.0, 0.0, 0.0, joint / inside), outside]


def _moved(segment: Polynomial, shift: float) -> Polynomial:
    """Return the polynomial shifted along y, expanded by Taylor's theorem."""
    if shift == 0.0:
        return segment
    degree = len(segment.coefficients)
    shifted = tuple(
        math.fsum(segment.coefficients[m] * math.comb(m, k) * (-shift) ** (m - k) for m in range(k, degree))
        for k in range(degree)
    )
    return Polynomial(segment.start + shift, segment.end + shift, shifted)


def _cone_tread(thinner: float) -> list[Segment]:
    y, z, radius = _ROOT
    inside = _TREAD_INSIDE - thinner
    height = 0.025 * -_TREAD_INSIDE
    return [
        Arc(_FACE_END[0] - thinner, -32.696 - thinner, y - thinner, z, radius, -1),
        Arc(-32.696 - thinner, -15.640 - thinner, -14.740 - thinner, 36.380, 36.0, -1),
        Line(-15.640 - thinner, inside, inside, height, -0.025),
        Line(inside, 0.0, 0.0, 0.0, height / inside),
        Line(0.0, 35.0, 0.0, 0.0, -0.025),
    ]

"""Wheel and rail profiles: the value that readers, wear and contact geometry share, and the analytic ones.

Axes of a profile, wheel and rail alike, metres: y lateral and positive to the field side (away from the track centre),
z positive down. Origin of a wheel: its tread datum, 70 mm from the flange back. Origin of a rail: the centre of its
crown, not inclined; a rail in track axes keeps the origin it was given in.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from estimation.contact.parameters import PROFILES
from estimation.contact.wheel_definitions import (
    RAIL_DEFINITIONS,
    S1002_THROAT,
    S1002_TREAD,
    WHEEL_DEFINITIONS,
    Arc,
    Line,
    Polynomial,
    Segment,
    sample,
)
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.fields import Served
from estimation.values.units import IN_MM, MILLIMETRE

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

EN13715_NAMES = "EN13715-S1002/h28/e32.5, EN13715-1/40/h28/e32.5 (h 28 to 32, e 28.5 to 32.5, outer slope as /6.7%)"
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
    t = min((back, forth), key=lambda value: abs(foot[1] + value * along[1] - (8.8349 + 1.86 * higher)))
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


@dataclass(frozen=True, slots=True)
class MeasuredProfiles:
    """Profiles of both wheels of a wheelset, as measured by a profile gauge. Key: (wheelset, at_ns).

    ``left`` is the wheelset's own left wheel, whichever way round it is mounted. ``std`` is that of the lateral
    displacement at a given rolling radius difference which follows from them.
    """

    wheelset: Annotated[str, Served(example="WS-0001")]
    at_ns: Annotated[int, Served(name="measured_at")]
    mileage_km: Annotated[float, Served(example=151200.0)]  # of the wheelset since new
    left: Profile
    right: Profile
    std: Annotated[
        float,
        Served(
            "How well the lateral displacement at a rolling radius difference follows from them.", "std_mm", IN_MM, 0.1
        ),
    ]


ProfileKind = Literal["wheel", "rail"]


@dataclass(frozen=True, slots=True)
class Profile:
    """A wheel or rail profile as a smooth height over its lateral axis; metres, z down, y to the field side.

    Between its points the height is the cubic that has the height and the slope of both neighbours.
    """

    kind: ProfileKind
    name: str
    y: FloatArray  # (n,) m, strictly increasing
    z: FloatArray  # (n,) m
    slope: FloatArray  # (n,) dz/dy

    def __post_init__(self) -> None:
        n = len(self.y)
        for field in ("y", "z", "slope"):
            values = frozen_array(getattr(self, field), (n,), name=field)
            object.__setattr__(self, field, values)
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                raise ProfileError(f"profile {self.name!r}: point {bad[0] + 1} is not a finite number", field=field)
        if n < PROFILES.fewest_points:
            few = f"{n} points, at least {PROFILES.fewest_points} are needed"
            raise ProfileError(f"profile {self.name!r}: {few}", field="y")
        backwards = np.flatnonzero(np.diff(self.y) <= 0)
        if len(backwards):
            raise ProfileError(f"profile {self.name!r}: y does not increase at point {backwards[0] + 2}", field="y")

    def height(self, y: FloatArray) -> FloatArray:
        """Return z (k,) at y (k,), m; NaN outside the profile."""
        return np.asarray(self._curve()(y))

    def gradient(self, y: FloatArray) -> FloatArray:
        """Return dz/dy (k,) at y (k,); NaN outside the profile."""
        return np.asarray(self._curve()(y, nu=1))

    def _curve(self) -> CubicHermiteSpline:
        from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415 - who only reads a profile does without

        return CubicHermiteSpline(self.y, self.z, self.slope, extrapolate=False)


def wheel_profile(name: str) -> Profile:
    """Return the wheel profile of that name: P8, S1002, EN15302-A, -B, -C, -H or -I, or one of EN 13715.

    Case and punctuation are free; :func:`estimation.contact.profiles.en13715_wheel` lists the designations of EN 13715.
    """
    segments = en13715_wheel(name)
    return _sampled("wheel", name, segments) if segments else _named("wheel", name, WHEEL_DEFINITIONS)


def rail_profile(name: str) -> Profile:
    """Return the rail profile of that name: one of EN 13674-1 as 60E1 or 49E1, BS113A, UIC60, EN15302-A."""
    # Case and punctuation are free. EN15302-A is given in track axes (inclined already); all others are uninclined.
    return _named("rail", name, RAIL_DEFINITIONS)


def is_design(name: str) -> bool:
    """Return whether a wheel or rail profile of that name is built in."""
    return en13715_wheel(name) is not None or any(
        _plain(name) == _plain(known) for known in (*WHEEL_DEFINITIONS, *RAIL_DEFINITIONS)
    )


def _named(kind: ProfileKind, name: str, definitions: Mapping[str, tuple[Segment, ...]]) -> Profile:
    wanted = _plain(name)
    for known, segments in definitions.items():
        if _plain(known) == wanted:
            return _sampled(kind, known, segments)
    others = f", {EN13715_NAMES}" if kind == "wheel" else ""
    raise ProfileError(
        f"no {kind} profile named {name!r}; known: {', '.join(definitions)}{others}; give any other as a file",
        field=kind,
    )


def _sampled(kind: ProfileKind, name: str, segments: tuple[Segment, ...]) -> Profile:
    y, z, slope = sample(segments, PROFILES.sampling_step_mm)
    return Profile(kind, name, y * MILLIMETRE, z * MILLIMETRE, slope)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower()).replace("wheel", "").replace("rail", "")

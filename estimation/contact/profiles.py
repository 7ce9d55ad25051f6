"""Wheel and rail profiles: the value that readers, wear and contact geometry share, and the analytic ones.

Axes of a profile, wheel and rail alike, metres: y lateral and positive to the field side (away from the track centre),
z positive down. Origin of a wheel: its tread datum, 70 mm from the flange back. Origin of a rail: the centre of its
crown, not inclined; a rail in track axes keeps the origin it was given in.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from estimation.contact.en13715 import NAMES as EN13715_NAMES
from estimation.contact.en13715 import en13715_wheel
from estimation.contact.wheel_definitions import RAIL_DEFINITIONS, WHEEL_DEFINITIONS, Segment, sample
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.served import MM, Served


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
            "How well the lateral displacement at a rolling radius difference follows from them.", "std_mm", MM, 0.1
        ),
    ]


ProfileKind = Literal["wheel", "rail"]

TREAD_DATUM = 0.070  # distance of a wheel's tread datum from its flange back, m

SAMPLING_STEP_MM = 0.05  # distance between the points of an analytic profile, along its surface

_FEWEST_POINTS = 4
_MILLIMETRE = 1e-3


@dataclass(frozen=True, slots=True)
class Profile:
    """A wheel or rail profile as a smooth height over its lateral axis; metres, z down, y to the field side.

    Between its points the height is the cubic that has the height and the slope of both neighbours.

    Raises:
        ProfileError: Fewer than four points, a value that is not finite, or y that does not increase.
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
        if n < _FEWEST_POINTS:
            raise ProfileError(f"profile {self.name!r}: {n} points, at least {_FEWEST_POINTS} are needed", field="y")
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
        return CubicHermiteSpline(self.y, self.z, self.slope, extrapolate=False)


def profile_from_points(kind: ProfileKind, name: str, y: FloatArray, z: FloatArray) -> Profile:
    """Return the profile through points, its slopes those of the cubic spline through them.

    Args:
        y, z: (n,) m, y strictly increasing.

    Raises:
        ProfileError: As `Profile`.
    """
    checked = Profile(kind, name, y, z, np.zeros(len(y)))
    return Profile(kind, name, checked.y, checked.z, CubicSpline(checked.y, checked.z)(checked.y, nu=1))


def wheel_profile(name: str) -> Profile:
    """Return the wheel profile of that name: P8, S1002, EN15302-A, -B, -C, -H or -I, or one of EN 13715.

    Case and punctuation are free; :func:`estimation.contact.en13715.en13715_wheel` lists the designations of EN 13715.

    Raises:
        ProfileError: No such wheel; the message lists those there are.
    """
    segments = en13715_wheel(name)
    return _sampled("wheel", name, segments) if segments else _named("wheel", name, WHEEL_DEFINITIONS)


def rail_profile(name: str) -> Profile:
    """Return the rail profile of that name: one of EN 13674-1 as 60E1 or 49E1, BS113A, UIC60, EN15302-A.

    Case and punctuation are free. EN15302-A is given in track axes (inclined already); all others are uninclined.

    Raises:
        ProfileError: No such rail; the message lists those there are.
    """
    return _named("rail", name, RAIL_DEFINITIONS)


def is_design(name: str) -> bool:
    """Return whether a wheel or rail profile of that name is built in."""
    return en13715_wheel(name) is not None or any(
        _plain(name) == _plain(known) for known in (*WHEEL_DEFINITIONS, *RAIL_DEFINITIONS)
    )


def _named(kind: ProfileKind, name: str, definitions: Mapping[str, Callable[[], tuple[Segment, ...]]]) -> Profile:
    wanted = _plain(name)
    for known, define in definitions.items():
        if _plain(known) == wanted:
            return _sampled(kind, known, define())
    others = f", {EN13715_NAMES}" if kind == "wheel" else ""
    raise ProfileError(
        f"no {kind} profile named {name!r}; known: {', '.join(definitions)}{others}; give any other as a file",
        field=kind,
    )


def _sampled(kind: ProfileKind, name: str, segments: tuple[Segment, ...]) -> Profile:
    y, z, slope = sample(segments, SAMPLING_STEP_MM)
    return Profile(kind, name, y * _MILLIMETRE, z * _MILLIMETRE, slope)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower()).replace("wheel", "").replace("rail", "")

"""Wear of wheels and rail heads, smooth so that it adds no corner to the contact, and what depots measure of it.

A tread or head loses ``depth * (1 - u^2)^3`` of height, u the distance from the centre of the hollow over its half
width (``docs/decisions/contact-wear-form.md``). The flange face is moved towards the flange back by ``flange_wear``,
blended in over the root and out over the tip.

Flange height Sh, thickness Sd and gradient qR are those of EN 15313:2016: with the tread datum 70 mm from the flange
back, Sh is the height of the flange tip over the tread there, Sd the distance of the flange face from the flange back
10 mm beyond the tread, and qR the lateral distance of that point from the face 2 mm short of the tip. The hollow is the
depth of the tread below the highest point farther out, which is what a straight edge from the field side finds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np

from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile
from estimation.errors import ParameterError, ProfileError
from estimation.values.arrays import FloatArray
from estimation.values.fields import in_mm


@dataclass(frozen=True, slots=True)
class TreadWear:
    """Material that a wheel has lost; metres on the profile's lateral axis."""

    depth: float  # at the centre of the hollow
    centre: float = 0.0  # lateral, from the tread datum, positive to the field side
    half_width: float = 0.040  # from the centre to where the hollow ends
    flange_wear: float = 0.0  # reduction of the flange thickness

    def __post_init__(self) -> None:
        _within("depth", self.depth, PROFILES.deepest_hollow)
        _within("flange_wear", self.flange_wear, PROFILES.most_flange_wear)
        _check_band(self)


class WearFamily(StrEnum):
    """Pairs of wheel and rail for which a course of wear is laid down."""

    P8_ON_56E1 = "P8 on 56E1 1:20"
    S1002_ON_60E1 = "S1002 on 60E1 1:40"


def wear_course(family: WearFamily, depth: float) -> TreadWear:
    """Return the wear of a wheel of that family when its tread has lost ``depth`` metres at its centre."""
    # The hollow is where the pair's contact patches are; the flange loses as much as the tread. On the pair's new rail
    # at 1435 mm equivalent conicity at 3 mm (EN 15302) grows steadily with depth: P8 on 56E1 from 0.195 to 0.44 at 2.2
    # mm, S1002 on 60E1 from 0.174 to 0.42 at 1.3 mm; beyond, P8 grows on and S1002 levels off near 0.46.
    centre, half_width = HOLLOWS["P8" if family is WearFamily.P8_ON_56E1 else "S1002"]
    return TreadWear(depth, centre, half_width, depth)


def worn(wheel: Profile, wear: TreadWear) -> Profile:
    """Return the wheel profile after it has lost that material; the new profile is not touched."""
    if wheel.kind != "wheel":
        raise ProfileError(f"{wheel.name!r} is a rail; wear is applied to wheels", field="kind")
    (root, root_rate), (tip, tip_rate) = (_blend(wheel.y, *PROFILES.root_range), _blend(wheel.y, *PROFILES.tip_range))
    moved = wear.flange_wear * (1.0 - root) * tip  # from how far field-wards the surface at y came
    rate = wear.flange_wear * ((1.0 - root) * tip_rate - root_rate * tip)
    source = np.clip(wheel.y + moved, wheel.y[0], wheel.y[-1])
    loss, loss_slope = _hollow(source, wear)
    z = wheel.height(source) - loss
    slope = (wheel.gradient(source) - loss_slope) * (1.0 + rate)
    return Profile("wheel", f"{wheel.name} worn", wheel.y, z, slope)


def _hollow(y: FloatArray, wear: TreadWear | RailWear) -> tuple[FloatArray, FloatArray]:
    u = np.clip((y - wear.centre) / wear.half_width, -1.0, 1.0)
    rest = 1.0 - u * u
    return wear.depth * rest**3, -6.0 * wear.depth / wear.half_width * u * rest**2


def _blend(y: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    t = np.clip((y - low) / (high - low), 0.0, 1.0)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t * t), 30.0 * t * t * (1.0 - t) ** 2 / (high - low)


def _within(field: str, value: float, largest: float) -> None:
    if not 0.0 <= value <= largest:
        raise ParameterError(f"{value!r} m is outside 0 to {largest} m", field=field)


def _check_band(wear: TreadWear | RailWear) -> None:
    if not (math.isfinite(wear.half_width) and wear.half_width > 0.0):
        raise ParameterError(f"{wear.half_width!r} is not a positive length", field="half_width")
    if not math.isfinite(wear.centre):
        raise ParameterError(f"{wear.centre!r} is not a position", field="centre")


@dataclass(frozen=True, slots=True)
class WearMeasures:
    """Wear measures of a wheel profile, m."""

    flange_height: Annotated[
        float, in_mm("Sh: tip of the flange over the tread 70 mm from the flange back.", "flange_height_mm", 28.0)
    ]
    flange_thickness: Annotated[
        float, in_mm("Sd: flange face to flange back, 10 mm beyond the tread.", "flange_thickness_mm", 32.5)
    ]
    flange_gradient: Annotated[
        float,
        in_mm(
            "qR: lateral distance of the face 10 mm beyond the tread from that 2 mm short of the tip.",
            "flange_gradient_mm",
            10.8,
        ),
    ]
    hollow: Annotated[
        float, in_mm("Depth of the tread below the highest point farther out; 0 for a new wheel.", "hollow_mm", 0.0)
    ]


def wear_measures(wheel: Profile) -> WearMeasures:
    """Return the wear measures of a whole wheel whose origin is the tread datum, 70 mm from the flange back."""
    if wheel.kind != "wheel":
        raise ProfileError(f"{wheel.name!r} is a rail; wear measures are a wheel's", field="kind")
    if not wheel.y[0] < PROFILES.tread_begin or not wheel.y[-1] > 0.0:
        raise ProfileError(f"{wheel.name!r} does not reach from the flange to the tread datum", field="y")
    y = np.arange(wheel.y[0], wheel.y[-1], PROFILES.wear_step)
    z = wheel.height(y)
    tip = int(np.argmax(z))
    tread = float(wheel.height(np.zeros(1))[0])
    thick = _face(y[tip:], z[tip:], tread + PROFILES.face_depth)
    high = _face(y[tip:], z[tip:], float(z[tip]) - PROFILES.gradient_height)
    part = z[(y >= PROFILES.tread_begin) & (y <= y[-1] - PROFILES.rim_margin)]
    hollow = float((np.maximum.accumulate(part[::-1])[::-1] - part).max())  # below the highest point farther out
    return WearMeasures(float(z[tip]) - tread, thick + PROFILES.tread_datum, thick - high, hollow)


def _face(y: FloatArray, z: FloatArray, level: float) -> float:
    above = np.flatnonzero(z < level)
    if len(above) == 0 or above[0] == 0:
        raise ProfileError(f"the flange face does not cross a depth of {level * 1e3:.2f} mm", field="z")
    i = int(above[0])
    return float(y[i] - (y[i] - y[i - 1]) * (level - z[i]) / (z[i - 1] - z[i]))


@dataclass(frozen=True, slots=True)
class RailWear:
    """Material that a rail head has lost; metres on the profile's lateral axis."""

    depth: float  # at the middle of the band
    centre: float = 0.0  # lateral, from the middle of the head, negative to the gauge side
    half_width: float = 0.030  # from the middle to where the band ends

    def __post_init__(self) -> None:
        _within("depth", self.depth, PROFILES.deepest_band)
        _check_band(self)


def worn_rail(rail: Profile, wear: RailWear) -> Profile:
    """Return the rail profile after it has lost that material; the new profile is not touched."""
    if rail.kind != "rail":
        raise ProfileError(f"{rail.name!r} is a wheel; a band is worn into rails", field="kind")
    if wear.depth == 0.0:
        return rail
    loss, slope = _hollow(rail.y, wear)
    return Profile("rail", f"{rail.name} worn", rail.y, rail.z + loss, rail.slope + slope)


# Centre and half width of the hollow of each design wheel, m: data of the wear form, chosen where its contact patches
# are (docs/decisions/contact-wear-form.md). The worn family is made from them (`bench worn_family`).
HOLLOWS: Mapping[str, tuple[float, float]] = {
    "P8": (3e-3, 44e-3),
    "S1002": (4e-3, 33e-3),
    "EN13715-1/40/h28/e32.5": (3e-3, 38e-3),
    "EN13715-S1002/h30/e29": (4e-3, 36e-3),
    "EN15302-A": (3e-3, 40e-3),
    "EN15302-B": (3e-3, 40e-3),
    "EN15302-H": (3e-3, 40e-3),
    "EN15302-I": (3e-3, 40e-3),
}

"""Worn wheelsets of profile classes that the extrapolation does not hold.

Four classes: a wheel of EN 15302 that no member of the family has, worn hollow; treads worn to an arc; hollow wheels on
worn rails; wheels worn by contact that run on worn rails. Rails, gauges, depths and widths are drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bench.worn_family import DISPLACEMENT, Running, worn_by_contact
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import profile_from_points
from estimation.contact.wear import RailWear, TreadWear, worn, worn_rail
from estimation.errors import ContactError, ParameterError, ProfileError
from estimation.values.arrays import FloatArray

RAILS = (("56E1", 20), ("60E1", 40), ("60E1", 20), ("54E1", 20), ("60E2", 40), ("49E5", 40))
STANDARDS = (  # with centre and half width of the hollow, m: where contact is
    ("P8", 3e-3, 44e-3),
    ("S1002", 4e-3, 33e-3),
    ("EN13715-1/40/h28/e32.5", 3e-3, 38e-3),
)
OTHER_WHEELS = (("EN13715-1/40/h30/e29", 3e-3, 38e-3), ("EN13715-S1002/h28/e31.5", 4e-3, 35e-3))
GAUGE_OFFSETS = np.array([-1.2e-3, -0.6e-3, 0.0, 0.6e-3, 1.2e-3])  # m about the mean gauge of a line
GAUGE_SHARES = np.array([0.1, 0.25, 0.3, 0.25, 0.1])
MEAN_GAUGES = (-0.5e-3, 3e-3)  # m, deviation
GRID = 0.25e-3  # m

_Draw = Callable[[np.random.Generator], tuple[Profile, Profile, int]]  # wheel, rail, 1 : inclination


def curve_of(kind: str, random: np.random.Generator) -> FloatArray | None:
    """Return the rolling radius difference (n,), m, at ``DISPLACEMENT`` of a worn wheelset; None where none runs.

    Args:
        kind: One of ``CLASSES``.
    """
    try:
        wheel, rail, inclination = CLASSES[kind](random)
        gauge = random.uniform(*MEAN_GAUGES) + GAUGE_OFFSETS
        on_track = WheelsetOnTrack.symmetric(wheel, rail, 1.0 / inclination, 1.435)
        table = contact_table(on_track, DISPLACEMENT, gauge, method=ContactMethod.EN15302, outside="hold")
    except (ContactError, ProfileError, ParameterError):
        return None
    return np.asarray(table.rolling_radius_difference @ GAUGE_SHARES)


def _rail(random: np.random.Generator, deepest: float = 0.0) -> tuple[Profile, int]:
    name, inclination = RAILS[random.integers(len(RAILS))]
    band = RailWear(random.uniform(0.0, deepest), random.uniform(-20e-3, 10e-3), random.uniform(20e-3, 30e-3))
    return worn_rail(rail_profile(name), band), inclination


def _hollow(wheels: Sequence[tuple[str, float, float]], random: np.random.Generator, off: float = 4e-3) -> Profile:
    """Return one of the wheels, hollow, the hollow at most so far off its usual place (m)."""
    name, centre, half_width = wheels[int(random.integers(len(wheels)))]
    depth = random.uniform(0.3e-3, 2.2e-3)
    place, width = centre + random.uniform(-off, off), half_width * random.uniform(0.75, 1.1)
    return worn(wheel_profile(name), TreadWear(depth, place, width, random.uniform(0.3, 1.2) * depth))


def _standard(random: np.random.Generator) -> Profile:
    return wheel_profile(STANDARDS[random.integers(len(STANDARDS))][0])


def _other_wheel(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    return _hollow(OTHER_WHEELS, random), *_rail(random)


def _on_worn_rail(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    return _hollow(STANDARDS, random), *_rail(random, 1e-3)


def _by_contact(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    running = Running(random.uniform(1.8e-3, 4e-3), random.uniform(5e-3, 10e-3), random.uniform(0.0, 0.4))
    rail, inclination = _rail(random)
    depth = 0.2e-3 * random.integers(2, 10)
    wheel = next(iter(worn_by_contact(_standard(random), rail, 1.0 / inclination, running, (depth,))))
    return wheel, *_rail(random, 1e-3)


def _arc(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    """Return a tread that is a concave arc for a part, rounded at its ends."""
    wheel = _standard(random)
    y = np.arange(wheel.y[0], wheel.y[-1], GRID)
    centre, radius, depth = random.uniform(-10e-3, 8e-3), random.uniform(0.31, 0.6), random.uniform(0.3e-3, 2e-3)
    at = np.array([centre])
    tilt = random.uniform(0.8, 1.3) * float(wheel.gradient(at)[0])
    arc = float(wheel.height(at)[0]) - depth + tilt * (y - centre) + (y - centre) ** 2 / (2.0 * radius)
    lost = np.where(y < -36e-3, 0.0, np.clip(wheel.height(y) - arc, 0.0, 3e-3))
    rounding = np.exp(-0.5 * (GRID * np.arange(-24, 25) / random.uniform(1e-3, 3e-3)) ** 2)
    lost = np.convolve(lost, rounding / rounding.sum(), "same")
    return profile_from_points("wheel", "arc", y, wheel.height(y) - lost), *_rail(random)


CLASSES: dict[str, _Draw] = {
    "another wheel, hollow": _other_wheel,
    "arc worn": _arc,
    "hollow on worn rails": _on_worn_rail,
    "worn by contact, worn rails": _by_contact,
}

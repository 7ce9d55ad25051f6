"""Wear where contact is: a wheel that runs on a rail loses material in proportion to how often it is touched there.

The wheelset's lateral displacement is normal, with a share of curving in which the flange root of the outer wheel
touches. Each step takes a small depth off the profile, spread over the width of a contact patch, and finds the contact
points again (Archard's law at constant load). The tread becomes hollow and conforms to the rail, as in service; the
form follows from wheel, rail and motion and not from a formula.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import Profile, profile_from_points
from estimation.contact.table import ContactMethod
from estimation.values.arrays import FloatArray

STEP = 0.2e-3  # m of depth between two searches for contact
SERVICE_DISPLACEMENT = np.arange(-45, 46) * 0.2e-3  # m
CURVING_FROM = 4e-3  # m of displacement, of curves
SERVICE_GAUGES = (-1e-3, 0.0, 1e-3, 3e-3)  # m, deviation from 1435 mm
SERVICE_GAUGE_SHARES = np.array([0.2, 0.4, 0.25, 0.15])


@dataclass(frozen=True, slots=True)
class Running:
    """How a wheelset runs while its wheels wear."""

    spread: float  # m, standard deviation of the lateral displacement
    patch: float  # m, half the width over which a contact wears
    curving: float  # share of running in curves


def worn_by_contact(
    wheel: Profile, rail: Profile, inclination: float, running: Running, depths: tuple[float, ...]
) -> Iterator[Profile]:
    """Yield the wheel at each depth of wear.

    Args:
        wheel, rail: New profiles; both wheels and both rails are alike.
        depths: Greatest depths, m, increasing multiples of ``STEP``.

    Raises:
        ContactError: The profiles never touch.
    """
    shares = np.exp(-0.5 * (SERVICE_DISPLACEMENT / running.spread) ** 2)
    curving = SERVICE_DISPLACEMENT > CURVING_FROM
    shares = shares / shares.sum() + running.curving * curving / curving.sum()
    done = 0
    for depth in depths:
        while done < round(depth / STEP):
            wheel, done = _one_step(wheel, rail, inclination, running.patch, shares), done + 1
        yield wheel


def _one_step(wheel: Profile, rail: Profile, inclination: float, patch: float, shares: FloatArray) -> Profile:
    """Return the wheel after it has lost ``STEP`` where it is touched most; shares (n,) of displacements."""
    on_track = WheelsetOnTrack.symmetric(wheel, rail, inclination, 1.435)
    table = contact_table(on_track, SERVICE_DISPLACEMENT, SERVICE_GAUGES, method=ContactMethod.EN15302, outside="hold")
    share = (np.outer(shares, SERVICE_GAUGE_SHARES) * table.exists).ravel()
    apart = (wheel.y[:, np.newaxis] - table.contact_position_left.ravel()) / patch
    touched = np.where(np.abs(apart) < 1.0, (1.0 - apart**2) ** 2, 0.0) @ share
    return profile_from_points("wheel", f"{wheel.name} worn", wheel.y, wheel.z - STEP * touched / touched.max())

"""The gravitational stiffness of a wheelset from its measured rolling radius difference and the profiles on file.

The load stands on inclined contacts: gravity pushes a wheelset back by W (D/2 + phi), D = dL - dR. Where profiles have
contact jumps D is a staircase of the displacement, so that a tenth of a millimetre of y - d decides over kilonewtons.
The rolling radius difference R, though, is measured sample by sample by the yaw moment, and jumps at the same places.
So D is looked up by R: in the contact geometry of the wheel profile on file, worn as far as the wheelset's estimated
R(y - d) is best met.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np

from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import is_design, rail_profile, wheel_profile
from estimation.contact.wear import HOLLOWS, TreadWear, worn
from estimation.errors import ContactError, ProfileError
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackSectionRecord

DISPLACEMENT = np.arange(-140, 141) * 0.05e-3  # m
DEPTHS = np.arange(9) * 0.25e-3  # m, of wear
USUAL_HOLLOW = (3e-3, 40e-3)  # m, centre and half width, of wheels that are in no family
MOST_MISFIT = 0.15e-3  # m, rms of rL - rR between estimate and the best profile
FEWEST_NODES = 5
KEPT = 64


@dataclass(frozen=True, slots=True)
class ContactAngles(FrozenArrays):
    """Contact angles over R of one wheelset on one rail; linear between."""

    difference: Annotated[FloatArray, "n"]  # rL - rR, m, increasing
    angle_difference: Annotated[FloatArray, "n"]  # dL - dR, rad
    angle_sum: Annotated[FloatArray, "n"]  # dL + dR, rad
    misfit: float  # m, rms of rL - rR against the estimate

    def difference_at(self, difference: FloatArray) -> FloatArray:
        """Return dL - dR (n,), rad, at rL - rR (n,), m; beyond the table its last values."""
        return np.asarray(np.interp(difference, self.difference, self.angle_difference))

    def sum_at(self, difference: FloatArray) -> FloatArray:
        """Return dL + dR (n,), rad, at rL - rR (n,), m; beyond the table its last values."""
        return np.asarray(np.interp(difference, self.difference, self.angle_sum))


def contact_angles(
    displacement: FloatArray, difference: FloatArray, wheel: str, section: TrackSectionRecord, radius: float
) -> ContactAngles | Reason:
    """Return the angles over R of the wear that meets an estimated curve best, or why the profiles on file do not.

    Args:
        displacement, difference: (b,) y - d and rL - rR there, m; NaN where it is not estimated.
    """
    known = np.isfinite(difference)
    if known.sum() < FEWEST_NODES:
        return Reason(ReasonCode.NO_CREEP_CURVE, f"rL - rR is known at {known.sum()} displacements")
    rail = (section.rail_profile, section.rail_inclination, section.nominal_gauge_m)
    if not (is_design(wheel) and is_design(section.rail_profile)):
        return Reason(ReasonCode.PROFILES_UNKNOWN, f"{wheel} on {section.rail_profile} are no profiles with a shape")
    family = _family(wheel, *rail, round(radius, 4))
    if family is None:
        return Reason(ReasonCode.PROFILES_UNKNOWN, f"{wheel} on {section.rail_profile} have no contact geometry")
    curves, differences, sums = family
    expected = np.stack([np.interp(displacement[known], DISPLACEMENT, curve) for curve in curves])
    left = expected - difference[known]
    misfit = np.sqrt(((left - left.mean(axis=1, keepdims=True)) ** 2).mean(axis=1))  # a diameter difference is no wear
    best = int(np.argmin(misfit))
    if misfit[best] > MOST_MISFIT:
        return Reason(
            ReasonCode.PROFILES_UNKNOWN,
            f"{wheel} on {section.rail_profile}, however worn, miss the estimated rL - rR by"
            f" {1e3 * misfit[best]:.2f} mm, at most {1e3 * MOST_MISFIT:.2f} mm are wear",
        )
    order = np.argsort(curves[best], kind="stable")
    return ContactAngles(curves[best][order], differences[best][order], sums[best][order], float(misfit[best]))


@lru_cache(maxsize=KEPT)
def _family(
    wheel: str, rail: str, inclination: float, gauge: float, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return R, D and dL + dR (9, n) of a wheel worn more and more; None where it never touches the rail."""
    centre, half_width = HOLLOWS.get(wheel, USUAL_HOLLOW)
    found = []
    try:
        on = rail_profile(rail)
        for depth in DEPTHS:
            worn_wheel = worn(wheel_profile(wheel), TreadWear(float(depth), centre, half_width, float(depth)))
            pair = WheelsetOnTrack.symmetric(worn_wheel, on, inclination, gauge, radius=radius)
            table = contact_table(pair, DISPLACEMENT, method=ContactMethod.EN15302, outside="hold")
            left, right = table.contact_angle_left[:, 0], table.contact_angle_right[:, 0]
            found.append((table.rolling_radius_difference[:, 0], left - right, left + right))
    except (ContactError, ProfileError):
        return None
    curves, differences, sums = np.moveaxis(np.array(found), 1, 0)
    return curves, differences, sums

"""Contact geometry and equivalent conicity that follow from known wheel profiles, on the rails a wheelset runs on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.accuracy.parameters import ACCURACY
from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.contact.geometry import (
    ContactTable,
    RadiusDifferenceCurve,
    WheelsetOnTrack,
    contact_table,
    refined_curve,
)
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile
from estimation.errors import ContactError, ParameterError, ProfileError
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackSectionRecord
from estimation.values.units import IN_MM, NORMAL_95

AMPLITUDES: FloatArray = np.array(ACCURACY.amplitudes)


@dataclass(frozen=True, slots=True)
class RailShare:
    """Rails as they are laid on some of the track, and the share of the running on them."""

    rail: Annotated[str, Served(name="rail_profile", example="60E1")]  # name of the profile
    inclination: Annotated[float, Served(name="rail_inclination_1", example=0.025)]  # tangent
    gauge: Annotated[float, Served(name="nominal_gauge_mm", scale=IN_MM, example=1435.0)]  # m, nominal
    share: Annotated[float, Served("Share of the running on them.", "share_1", example=1.0)]

    @classmethod
    def of(cls, section: TrackSectionRecord) -> RailShare:
        """Return the rails of a section, for a wheelset that runs on no others."""
        return cls(section.rail_profile, section.rail_inclination, section.nominal_gauge_m, 1.0)


@dataclass(frozen=True, slots=True)
class WheelPair:
    """The profiles of both wheels of a wheelset, and how well they are known."""

    left: Profile
    right: Profile
    nominal_radius: float  # m, at the tread datum
    std: float = 0.0  # m, of the lateral displacement at a rolling radius difference; 0 for a drawing


@dataclass(frozen=True, slots=True)
class WheelContact(FrozenArrays):
    """What profiles give: NaN, or an unknown conicity, where both wheels have no contact.

    The wheelset does not roll, as in EN 15302. On rails of several kinds the radii are the means over them, weighted
    by the running on each: so is what is estimated from that running.
    """

    rails: tuple[RailShare, ...]
    displacement: Annotated[FloatArray, "n"]  # m, uniform, positive to the left
    radius_sum: Annotated[FloatArray, "n"]  # rL + rR, m
    radius_difference: Annotated[FloatArray, "n"]  # rL - rR, m
    radius_difference_std: Annotated[FloatArray, "n"]  # m
    amplitude: Annotated[FloatArray, "k"]  # m
    conicity: Annotated[tuple[Estimate, ...], "k"]
    zero_crossing: float  # m; NaN where there is none


def wheel_contact(wheels: WheelPair, rails: Sequence[RailShare]) -> WheelContact | Reason:
    """Return the contact geometry of two wheels on rails, or why there is none."""
    if not rails:
        return Reason(ReasonCode.SECTION_UNKNOWN, "no section is on file on whose rails the wheels could be looked at")
    try:
        found = [_on_rails(wheels, rail) for rail in rails]
    except (ContactError, ProfileError, ParameterError) as error:
        return Reason(ReasonCode.CONTACT_IMPOSSIBLE, str(error))
    share = np.array([rail.share for rail in rails]) / sum(rail.share for rail in rails)
    table = found[0][0]
    sums, differences = (
        np.array([np.where(one.exists[:, 0], getattr(one, name)[:, 0], np.nan) for one, _ in found])
        for name in ("rolling_radius_sum", "rolling_radius_difference")
    )
    x = np.array(table.lateral_displacement)
    curve_x, curve = _mean_curve([curve for _, curve in found], share)
    # by how much rL - rR changes where the displacement is a standard deviation off
    middle, below, above = (np.interp(x + shift, curve_x, curve) for shift in (0.0, -wheels.std, wheels.std))
    return WheelContact(
        tuple(rails),
        x,
        share @ sums,
        share @ differences,
        np.maximum(np.abs(above - middle), np.abs(below - middle)),
        AMPLITUDES,
        conicity_of(curve_x, curve, AMPLITUDES, wheels.std),
        zero_crossing(curve_x, curve),
    )


def conicity_of(x: FloatArray, curve: FloatArray, amplitude: FloatArray, std: float) -> tuple[Estimate, ...]:
    """Return the equivalent conicity of a curve at each amplitude, with what an error of the displacement makes of it.

    The error is a stretch of the displacement by ``std``, m, at the amplitude: both turning points err alike. It counts
    by the largest change per standard deviation within a 95 % interval, for a contact jump may be passed far out only.
    """
    here = equivalent_conicity(x, curve, amplitude)
    changes = np.zeros((4, len(amplitude)))
    for row, share in enumerate((-NORMAL_95, -1.0, 1.0, NORMAL_95)):
        factor = 1.0 + share * std / amplitude
        possible = factor > 0.0
        factor = np.where(possible, factor, 1.0)
        stretched = equivalent_conicity(x, curve, amplitude / factor) / factor
        changes[row] = np.where(possible, np.abs(stretched - here) / abs(share), np.inf)
    widest = np.where(np.isnan(changes), 0.0, changes).max(axis=0)
    return tuple(_estimate(*row) for row in zip(here, widest, amplitude, strict=True))


def _estimate(value: float, std: float, amplitude: float) -> Estimate:
    if not np.isfinite(value):
        text = f"the wheels have no contact as far out as an amplitude of {1e3 * amplitude:g} mm needs"
        return Estimate.unknown(Reason(ReasonCode.AMPLITUDE_NOT_COVERED, text))
    if not np.isfinite(std):
        text = f"the measurement leaves the conicity at {1e3 * amplitude:g} mm open"
        return Estimate.unknown(Reason(ReasonCode.CONICITY_OPEN, text))
    if std == 0.0:
        return Estimate(float(value), 0.0, float(value), float(value), 0.0, Status.ESTIMATED)
    return with_interval(float(value), float(std), count=0.0)


def _on_rails(wheels: WheelPair, one: RailShare) -> tuple[ContactTable, RadiusDifferenceCurve]:
    rail = rail_profile(one.rail)
    wheelset = WheelsetOnTrack(
        wheels.left, wheels.right, rail, rail, one.inclination, one.gauge, wheels.nominal_radius, wheels.nominal_radius
    )
    x = ACCURACY.displacement()
    table = contact_table(wheelset, x, method=ContactMethod.EN15302, outside="hold")
    return table, refined_curve(wheelset, table, 0)


def _mean_curve(curves: Sequence[RadiusDifferenceCurve], share: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(curves) == 1:
        return curves[0].displacement, curves[0].difference
    low = max(float(curve.displacement[0]) for curve in curves)
    high = min(float(curve.displacement[-1]) for curve in curves)
    x = np.unique(np.concatenate([curve.displacement for curve in curves]))
    x = x[(x >= low) & (x <= high)]
    return x, share @ np.array([np.interp(x, curve.displacement, curve.difference) for curve in curves])

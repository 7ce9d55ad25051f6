"""When wheel and rail are parted, and what is known of them beforehand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from estimation.accuracy.wheel_contact import REACH, STEP, RailShare, WheelPair, conicity_of
from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.profiles import is_design, rail_profile, wheel_profile
from estimation.errors import ContactError, ParameterError, ProfileError
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.opinions import KnownWheel, RailKey
from estimation.values.reasons import Reason, ReasonCode

DIFFER = (ReasonCode.KNOWN_RAILS_DIFFER, ReasonCode.MEASURED_WHEELS_DIFFER)


@dataclass(frozen=True, slots=True)
class RailsParameters:
    """Parameters of the mixed model."""

    slope_std: float = 0.3  # known beforehand, of what rails add to a wheel whose conicity is higher by 1
    interaction: float = 0.005  # std of what neither wheel nor rail explains of a conicity, known beforehand
    interaction_weight: float = 4.0  # how many degrees of freedom that knowledge counts
    farthest: float = 0.03  # by how much the wheel as designed may be outside the wheels that run on a section
    steepest: float = 0.03  # most that its conicity may change within 0.25 mm of amplitude, where it is published
    known_apart: float = 1.7  # half intervals apart contradict each other; 1.7 of 95 % are 1 of 99.9 %
    confirmed_within: float = 0.02  # std to which the others must know a measured wheel, so that they confirm it
    uneven_slope: float = 0.6  # relative, of the rise with the wheels, beside most sections; twice ``slope_std``
    spread_open: float = 0.1  # relative std of how far wheels are spread, beyond which known rails say little of it
    most_interaction: float = 0.01  # std that neither wheel nor rail explains, at a published amplitude
    least_wheelsets: int = 2  # different wheelsets that must connect a section to its reference
    period_days: float = 180.0  # length of a period, in which rails hardly wear
    known_days: float = 365.0  # how long rails that are as on file on a day are taken to be so
    least_periods: int = 3  # fewest periods of a trend
    limit: float = 0.05  # on the excess of the reference wheel's conicity
    limit_amplitude: float = 3.0e-3  # m, at which the limit is looked at, or the largest amplitude below that is known


@dataclass(frozen=True, slots=True)
class ReferenceWheel(FrozenArrays):
    """The wheel as designed: what its conicity is, from its drawing and those of rails."""

    profile: str  # name
    on_reference: Annotated[FloatArray, "n"]  # on the rails that all are compared with
    on_file: Mapping[str, FloatArray] = field(default_factory=dict)  # (k,) by section, on its rails as on file

    def of(self, section: str) -> FloatArray:
        """Return its conicity (k,) on the rails of a section as on file; NaN where it has none."""
        return self.on_file.get(section, np.full(len(self.on_reference), np.nan))


@dataclass(frozen=True, slots=True)
class Anchors:
    """What holds the level, and what the wheel as designed is."""

    wheel: ReferenceWheel
    known_rails: frozenset[RailKey] = frozenset()  # rails that are as on file, and alike
    known_wheels: tuple[KnownWheel, ...] = ()
    tonnage: Mapping[str, float] = field(default_factory=dict)  # by section, million gross tonnes a year
    refused: Mapping[str, Reason] = field(default_factory=dict)  # why sections named as known hold no level
    refused_wheels: Mapping[str, Reason] = field(default_factory=dict)  # why measured wheelsets hold none, by serial
    missing: tuple[str, ...] = ()  # sections named as known that are not on file

    @property
    def level_open(self) -> Reason:
        """Why nothing holds the level, where nothing does."""
        nothing = "no section with known rails and no measured wheelset holds the level"
        refused = [*sorted(self.refused.items()), *sorted(self.refused_wheels.items())]
        why = "".join(f"; {name}: {reason.text}" for name, reason in refused)
        why += "".join(f"; {code} is named as known, but not on file" for code in self.missing)
        differ = (one.code for _, one in refused if one.code in DIFFER)
        code = next(differ, ReasonCode.RAILS_LEVEL_OPEN)
        return Reason(code, f"{nothing}: only differences of sections are known{why}")

    def without(self, sections: Mapping[str, Reason], wheelsets: Mapping[str, Reason]) -> Anchors:
        """Return the anchors without some sections and measured wheelsets, and why."""
        return replace(
            self,
            known_rails=frozenset(key for key in self.known_rails if key.section not in sections),
            known_wheels=tuple(one for one in self.known_wheels if one.wheel.wheelset not in wheelsets),
            refused={**self.refused, **sections},
            refused_wheels={**self.refused_wheels, **wheelsets},
        )


def conicity_on_rails(wheels: WheelPair, rails: RailShare, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the conicity (k,) of wheels on rails and its standard deviation; NaN where they have none."""
    nothing = np.full(len(amplitude), np.nan)
    try:
        rail = rail_profile(rails.rail)
        radius = wheels.nominal_radius
        wheelset = WheelsetOnTrack(
            wheels.left, wheels.right, rail, rail, rails.inclination, rails.gauge, radius, radius
        )
        x = STEP * np.arange(-round(REACH / STEP), round(REACH / STEP) + 1)
        curve = radius_difference_curve(wheelset, x)
    except (ContactError, ProfileError, ParameterError):
        return nothing, nothing
    found = conicity_of(curve.displacement, curve.difference, amplitude, wheels.std)
    value = np.array([np.nan if one.value is None else one.value for one in found])
    return value, np.array([np.nan if one.std is None else one.std for one in found])


def designed_wheel(profile: str, nominal_radius: float) -> WheelPair | None:
    """Return the wheels of a profile as designed; None where no such profile is built in."""
    if not is_design(profile):
        return None
    try:
        wheel = wheel_profile(profile)
    except ProfileError:  # it is a rail
        return None
    return WheelPair(wheel, wheel, nominal_radius)

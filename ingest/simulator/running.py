"""How the vehicles of a scenario run: creep and friction, wheels, traction, and what the track adds to its line.

Every law of creep takes Kalker's linear forces of a wheel and multiplies them by one factor, a function of their
resultant F over the bound mu N (N the wheel's normal force). The linear law has the factor 1. Vermeulen and Johnson
(1964) have, with u = F/(mu N),

    1 - u/3 + u^2/27  for u <= 3,     1/u  beyond

and Polach (2005), with e = pi u/4, the formula for long contact and two reduction factors kA (area of adhesion) and
kS (area of slip), kS <= kA <= 1, and a friction that falls with the slip velocity w:

    (2/pi) (kA e/(1 + (kA e)^2) + atan(kS e)) / u,     mu = mu0 ((1 - A) exp(-B w) + A)

Spin enters through the linear lateral force; the spin moment has the same factor (Shen, Hedrick and Elkins, 1983).
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Annotated, NamedTuple, Self

import numpy as np
from annotated_types import Interval

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray
from estimation.values.fields import MM, PERCENT, FileDefault, Key, M
from ingest.file_value import Counted, between, written
from ingest.input_file import NotNegative, Positive, Text, field_error
from ingest.simulator.motion import WheelsetMotion


class CreepLaw(IntEnum):
    """How friction bounds the creep forces."""

    LINEAR = 0
    VERMEULEN_JOHNSON = 1
    POLACH = 2


VERMEULEN_JOHNSON = int(CreepLaw.VERMEULEN_JOHNSON)  # as the compiled code takes it
TINY = 1e-9  # in place of no creep


class CreepConstants(NamedTuple):
    """A law and its constants, as the compiled code takes them."""

    law: int
    friction: float  # mu0
    adhesion: float  # kA
    slip: float  # kS
    residual: float  # A, friction at large slip velocity over mu0
    decay: float  # B, s/m


Share = Annotated[float, Interval(gt=0.0, le=1.0)]
_LAWS = {law.name.lower(): law for law in CreepLaw}


def _law(text: str) -> CreepLaw:
    if text not in _LAWS:
        raise field_error(f"{text!r} is none of {', '.join(_LAWS)}")
    return _LAWS[text]


@dataclass(frozen=True, slots=True)
class Creep:
    """The force law of all wheels. Friction may vary along the track beside."""

    law: Annotated[CreepLaw, written(Text, _law)] = CreepLaw.LINEAR
    friction: Share = 0.4  # mu0
    adhesion: Annotated[Share, Key("adhesion_factor")] = 1.0  # kA
    slip: Annotated[Share, Key("slip_factor")] = 1.0  # kS
    residual: Annotated[Share, Key("sliding_friction_share")] = 1.0  # A
    decay: Annotated[NotNegative, Key("sliding_decay_s_m")] = 0.0  # B, s/m

    def constants(self) -> CreepConstants:
        """Return the law as the compiled loop takes it."""
        return CreepConstants(int(self.law), self.friction, self.adhesion, self.slip, self.residual, self.decay)


@compiled(nogil=True, error_model="numpy")
def share_of_linear(c: CreepConstants, linear: float, bound: float, slip_velocity: float) -> float:
    """Return by what factor (0 to 1) a law, not the linear one, multiplies the linear creep forces of one wheel.

    ``linear`` is the resultant of the linear longitudinal and lateral force, ``bound`` mu0 N, both N.
    """
    if c.law == VERMEULEN_JOHNSON:
        u = linear / bound
        return 1.0 - u / 3.0 + u * u / 27.0 if u < 3.0 else 1.0 / u  # noqa: PLR2004 - full slip, see the module
    bound *= (1.0 - c.residual) * math.exp(-c.decay * slip_velocity) + c.residual
    u = linear / bound + TINY
    e = 0.25 * math.pi * u
    adhesion = c.adhesion * e
    return 2.0 / math.pi * (adhesion / (1.0 + adhesion * adhesion) + math.atan(c.slip * e)) / u


PUSH, REBOUND = 8, 24  # steps of motion that each lasts
SPEED = 20.0  # m/s, at which the sizes are given
OF_LEFT_WHEEL = np.array([-1.0, 0.5, 0.7, 0.0])  # m/s2 and rad/s2 in the order of ACCELERATIONS, by the lateral size


def _wheel(text: str) -> bool:
    if text not in {"left", "right"}:
        raise field_error(f"{text!r} is neither left nor right")
    return text == "left"


Blow = Annotated[float, Interval(gt=0.0, le=500.0), Key("blow_m_s2")]


@dataclass(frozen=True, slots=True)
class WheelFlat:
    """A flat on the tread of a wheel, from campaign ``from_campaign`` (counted from 1) on."""

    wheelset: Text  # serial
    left: Annotated[bool, written(Text, _wheel), Key("wheel"), FileDefault(value=True)]  # that of the left end
    size: Blow  # m/s2, of the lateral blow at 20 m/s
    from_campaign: Counted = 1


@dataclass(frozen=True, slots=True)
class TrackBlows:
    """Joints or switches that strike every wheelset."""

    every: Annotated[float, between(5.0, 1e5), M]  # along the section
    size: Blow  # m/s2, of the lateral blow at 20 m/s


def with_flat(motion: WheelsetMotion, flat: WheelFlat, radius: float, rng: np.random.Generator) -> WheelsetMotion:
    """Return the motion as sensors feel it on an axle with a flat."""
    turns = (motion.distance - motion.distance[0]) / (2.0 * np.pi * radius) + rng.uniform()
    return _struck(motion, turns, flat.size * (1.0 if flat.left else -1.0))


def with_track_blows(motion: WheelsetMotion, blows: TrackBlows) -> WheelsetMotion:
    """Return the motion as sensors feel it where joints or switches strike, every other one on the right rail."""
    return _struck(motion, motion.distance / blows.every, blows.size, alternating=True)


def _struck(motion: WheelsetMotion, turns: FloatArray, size: float, *, alternating: bool = False) -> WheelsetMotion:
    number = np.floor(turns)
    at = np.flatnonzero(np.diff(number) != 0.0) + 1
    sizes = size * motion.speed[at] / SPEED
    if alternating:
        sizes = sizes * np.where(np.maximum(number[at], number[at - 1]) % 2.0, -1.0, 1.0)
    impulses = np.zeros(len(motion))
    impulses[at] = sizes
    waves = np.outer(OF_LEFT_WHEEL, np.convolve(impulses, blow())[: len(motion)])
    before = 0.0 if motion.path_accelerations is None else motion.path_accelerations
    return replace(motion, path_accelerations=before + waves)


def blow() -> FloatArray:
    """Return a blow of size 1 every ``STEP`` s: half a sine, and a longer and weaker one back."""
    push, back = (np.sin(np.pi * (np.arange(steps) + 0.5) / steps) for steps in (PUSH, REBOUND))
    return np.concatenate([push, -back * push.sum() / back.sum()])


CONTACT_STEP = 0.05e-3  # m of lateral displacement between the points of a contact table


STRETCH_END = 5.0  # m at each end of a stretch over which friction changes to that of the stretch
SHORTEST_STRETCH = 2.0 * STRETCH_END  # m: its friction is reached somewhere


@dataclass(frozen=True, slots=True)
class FrictionStretch:
    """Rails of another friction between two distances from a campaign on: leaves that fell, a leaking lubricator."""

    begin: Annotated[NotNegative, Key("from_m")]  # m along the section
    end: Annotated[Positive, Key("to_m")]
    friction: Share  # coefficient, whatever that of other places and campaigns is
    from_campaign: Counted = 1

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse a stretch that is all ends."""
        if self.end < self.begin + SHORTEST_STRETCH:
            reason = f"{self.end:g} m must be {SHORTEST_STRETCH:g} m or more behind 'from_m', {self.begin:g} m"
            raise field_error(reason, "to_m")
        return self


@dataclass(frozen=True, slots=True)
class CreepPlan(Creep):
    """``[creep]``: the law, and how friction is drawn, smoothly between two limits and by campaign."""

    lowest_friction: Share | None = None
    highest_friction: Share | None = None
    correlation: Annotated[Positive, M] = 100.0  # along the section, over which friction changes
    campaign_std: Annotated[float, between(0.0, 100.0), PERCENT] = 0.0  # of the logarithm of a factor per campaign
    stretches: tuple[FrictionStretch, ...] = ()  # of another friction; where they overlap the last one holds

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse what has no effect; the friction of the law is the mean where it varies."""
        if self.law is CreepLaw.LINEAR and (needless := set(given) - {"law"}):
            raise field_error("has no effect with law = 'linear'", min(needless))
        low, high = self.lowest_friction, self.highest_friction
        if (low is None) != (high is None):
            raise field_error("is missing", "lowest_friction" if low is None else "highest_friction")
        if low is not None and high is not None:
            if "friction" in given:
                raise field_error("cannot be given beside its limits", "friction")
            if high < low:
                raise field_error(f"{high:g} is below 'lowest_friction', {low:g}", "highest_friction")
        only = {"adhesion_factor", "slip_factor", "sliding_friction_share", "sliding_decay_s_m"}
        if self.law is not CreepLaw.POLACH and (needless := only.intersection(given)):
            raise field_error("has no effect without law = 'polach'", min(needless))
        if self.slip > self.adhesion:
            raise field_error("is above 'adhesion_factor'", "slip_factor")
        return self if low is None or high is None else replace(self, friction=0.5 * (low + high))

    @property
    def varies(self) -> bool:
        """Whether friction is drawn along the section, or by campaign."""
        return self.lowest_friction is not None or self.campaign_std > 0.0

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest friction along the section."""
        return self.lowest_friction or self.friction, self.highest_friction or self.friction


@dataclass(frozen=True, slots=True)
class WheelsPlan:
    """``[wheels]``."""

    out_of_round: Annotated[float, between(0.0, 2.0), MM] = 0.0  # amplitude of every wheel; phases are drawn
    contact_half_width: Annotated[float, between(0.0, 5.0), MM] = 0.0
    """Of lateral displacement, over which the contact is averaged."""
    contact_step: Annotated[float, between(0.001, 0.2), MM] = CONTACT_STEP
    """Between points of a contact table: a contact jump is a ramp as wide."""
    flats: tuple[WheelFlat, ...] = ()


@dataclass(frozen=True, slots=True)
class TractionPlan:
    """``[traction]``: axles pull and brake as the speed changes."""

    driven_axles: tuple[Counted, ...] = ()  # from 1; empty: all

    def shares(self, axles: int) -> tuple[float, ...]:
        """Return the traction of each of ``axles`` axles over that of an even distribution."""
        driven = self.driven_axles or range(1, axles + 1)
        working = [axle in driven for axle in range(1, axles + 1)]
        return tuple(axles / sum(working) if works else 0.0 for works in working)

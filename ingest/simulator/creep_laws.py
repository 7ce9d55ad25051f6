"""Creep forces of one wheel: Kalker's linear ones, and how friction bounds them, compiled.

Every law takes the linear forces and multiplies them by one factor, a function of their resultant F over the bound
mu N (N the wheel's normal force). The linear law has the factor 1. Vermeulen and Johnson (1964)
have, with u = F/(mu N),

    1 - u/3 + u^2/27  for u <= 3,     1/u  beyond

and Polach (2005), with e = pi u/4, the formula for long contact and two reduction factors kA (area of adhesion) and
kS (area of slip), kS <= kA <= 1, and a friction that falls with the slip velocity w:

    (2/pi) (kA e/(1 + (kA e)^2) + atan(kS e)) / u,     mu = mu0 ((1 - A) exp(-B w) + A)

Spin enters through the linear lateral force; the spin moment has the same factor (Shen, Hedrick and Elkins, 1983).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, NamedTuple

from annotated_types import Interval

from estimation.errors import ParameterError
from estimation.values.fields import Key
from ingest.file_value import written
from ingest.input_file import NotNegative, Text, field_error
from ingest.simulator.rates import stepped


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
    free_rolling: bool = False  # whether the angular velocity of the wheels is a state, or V/r0


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

    def __post_init__(self) -> None:
        positive = (("friction", self.friction), ("adhesion", self.adhesion), ("slip", self.slip))
        for name, value in (*positive, ("residual", self.residual)):
            if not (math.isfinite(value) and 0.0 < value <= 1.0):
                raise ParameterError(f"{value!r} is not above 0 and at most 1", field=name)
        if self.slip > self.adhesion:
            raise ParameterError(f"{self.slip:g} is above that of adhesion, {self.adhesion:g}", field="slip")
        if not (math.isfinite(self.decay) and self.decay >= 0.0):
            raise ParameterError(f"{self.decay!r} is not a possible value", field="decay")

    def constants(self) -> CreepConstants:
        """Return the law as the compiled loop takes it."""
        return CreepConstants(int(self.law), self.friction, self.adhesion, self.slip, self.residual, self.decay)


@stepped
def share_of_linear(c: CreepConstants, linear: float, bound: float, slip_velocity: float) -> float:
    """Return by what factor (0 to 1) a law, not the linear one, multiplies the linear creep forces of one wheel.

    Args:
        linear: Resultant of the linear longitudinal and lateral force, N, not negative.
        bound: mu0 N, N, positive.
        slip_velocity: Of the contact, m/s, not negative.
    """
    if c.law == VERMEULEN_JOHNSON:
        u = linear / bound
        return 1.0 - u / 3.0 + u * u / 27.0 if u < 3.0 else 1.0 / u  # noqa: PLR2004 - full slip, see the module
    bound *= (1.0 - c.residual) * math.exp(-c.decay * slip_velocity) + c.residual
    u = linear / bound + TINY
    e = 0.25 * math.pi * u
    adhesion = c.adhesion * e
    return 2.0 / math.pi * (adhesion / (1.0 + adhesion * adhesion) + math.atan(c.slip * e)) / u

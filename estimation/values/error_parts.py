"""What the error of a conicity is made of: sampling, and parts that several numbers have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from estimation.values.arrays import FloatArray


class CommonTo(StrEnum):
    """Numbers that err alike, and whose differences an error therefore cancels in."""

    NOTHING = "nothing"  # each interval errs by itself
    WEATHER = "weather"  # all wheelsets there, at that time
    CLASS = "class"  # all wheelsets of a vehicle class, all intervals
    WHEELSET = "wheelset"  # all intervals of a wheelset
    SECTION = "section"  # all wheelsets on a section, by one version of its alignment


class ErrorSource(StrEnum):
    """Where a part of the error comes from."""

    SAMPLING = "sampling"
    CREEP = "creep"
    STIFFNESS = "stiffness"
    INERTIA = "inertia"
    FRICTION = "friction"
    SCALE = "scale"  # of the difference as a whole: radius, distance of the contacts, yaw sensor
    SENSORS = "sensors"  # scales and angle of those in a bogie
    ALIGNMENT = "alignment"  # its noise, which makes the displacement too large
    BLUR = "blur"
    STRETCH = "stretch"  # of the displacement: lateral sensor, alignment, gauge
    JUMP_PLACE = "jump_place"
    EVEN_PART = "even_part"  # what the high-pass takes of it
    DIAMETERS = "diameters"

    @property
    def common_to(self) -> CommonTo:
        """The numbers that err alike by it."""
        return _COMMON.get(self, CommonTo.WHEELSET)


_COMMON = {
    ErrorSource.SAMPLING: CommonTo.NOTHING,
    ErrorSource.FRICTION: CommonTo.WEATHER,
    ErrorSource.CREEP: CommonTo.CLASS,
    ErrorSource.STIFFNESS: CommonTo.CLASS,
    ErrorSource.INERTIA: CommonTo.CLASS,
    ErrorSource.ALIGNMENT: CommonTo.SECTION,
    ErrorSource.STRETCH: CommonTo.SECTION,
}


@dataclass(frozen=True, slots=True)
class VaryingParameters:
    """Of the std of a part, how much differs from interval to interval."""

    sampling: float = 1.0
    friction: float = 0.5  # it is as the weather of a day


VARYING = VaryingParameters()


def error_effects(sources: Sequence[ErrorSource], effects: FloatArray) -> tuple[tuple[ErrorSource, ...], FloatArray]:
    """Return each source once, and its effects (p, n) from those (k, n) of ``sources`` (k,).

    Several of one source are independent; together they have the sign of the largest.
    """
    each_once = tuple(dict.fromkeys(sources))
    together = np.empty((len(each_once), effects.shape[1]))
    for place, source in enumerate(each_once):
        rows = effects[[at == source for at in sources]]
        largest = np.take_along_axis(rows, np.abs(np.nan_to_num(rows)).argmax(axis=0)[None], axis=0)[0]
        together[place] = np.copysign(np.sqrt((rows**2).sum(axis=0)), largest)
    return each_once, together


def varying_stds(sources: Sequence[ErrorSource], amplitude: FloatArray, effects: FloatArray) -> Mapping[float, float]:
    """Return by amplitude (n,), m, the std of what differs from interval to interval, of effects (p, n)."""
    if not sources:
        return {}
    shares = {CommonTo.NOTHING: VARYING.sampling, CommonTo.WEATHER: VARYING.friction}
    varying = np.array([shares.get(source.common_to, 0.0) for source in sources])
    return dict(zip(amplitude.tolist(), np.linalg.norm(varying[:, None] * effects, axis=0).tolist(), strict=True))

"""Blows on axle boxes: of wheels with a flat, once a turn, and of joints and switches, once a passage.

A blow pushes the box for some ms, which comes back: the wheelset is no faster behind it. That on the left wheel lifts
the left box, throws the wheelset to the right and turns its front to the left; that on the right wheel is its mirror
image, one of the track comes from either side. Blows grow in proportion to the speed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval

from estimation.values.arrays import FloatArray
from estimation.values.fields import FileDefault, Key, M
from ingest.file_value import Counted, between, written
from ingest.input_file import Text, field_error
from ingest.simulator.motion import WheelsetMotion

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
    """Return the motion as sensors feel it on an axle with a flat.

    Args:
        radius: Of the wheel, m.
    """
    turns = (motion.distance - motion.distance[0]) / (2.0 * np.pi * radius) + rng.uniform()
    return _struck(motion, turns, flat.size * (1.0 if flat.left else -1.0))


def with_track_blows(motion: WheelsetMotion, blows: TrackBlows) -> WheelsetMotion:
    """Return the motion as sensors feel it where joints or switches strike.

    Args:
        blows: Of the track; every other one is on the right rail.
    """
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

"""Isolated irregularities of a track: defects, switches and joints, at given places or drawn at a rate."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Self

import numpy as np
from annotated_types import Interval

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray
from estimation.values.fields import MM, FileUnit, Key, M
from ingest.file_value import As, IncreasingPlaces, between
from ingest.input_file import field_error

FEWEST_INTERVALS = 8  # of the grid over an isolated irregularity
DRAWN_SHARE = (0.5, 1.5)  # of the size, of one that is drawn


class IsolatedKind(StrEnum):
    """What it is; this decides its shapes over its length."""

    DEFECT = "defect"  # alignment and gauge rise and fall as one wave of a cosine
    SWITCH = "switch"  # alignment has a kink in the middle; gauge stays off over the middle half
    JOINT = "joint"  # alignment has a kink in the middle; gauge as of a defect


@dataclass(frozen=True, slots=True)
class Isolated:
    """Isolated irregularities of one kind and size; m.

    Where they are drawn, their number is Poisson distributed, their sizes vary by ``DRAWN_SHARE``, and their alignment
    is to either side.
    """

    kind: Annotated[IsolatedKind, Key(None)]
    length: Annotated[float, Interval(gt=0.0, le=200.0), M]  # from begin to end
    alignment: Annotated[float, between(-30.0, 30.0), MM] = 0.0  # in the middle, positive to the left
    gauge: Annotated[float, between(-30.0, 30.0), MM] = 0.0  # in the middle, positive is wide
    at: Annotated[IncreasingPlaces, Key("at_m")] = ()  # middles, distance along the section
    per_metre: Annotated[float, between(0.0, 200.0), FileUnit("", divisor=1e3), Key("per_km")] = 0.0  # drawn beside

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse what is nowhere, or changes nothing."""
        if not self.at and self.per_metre == 0.0:
            raise field_error("is missing; give the middles, or 'per_km' to draw them", "at_m")
        if self.alignment == 0.0 and self.gauge == 0.0:
            raise field_error("is missing, and 'gauge_mm' too: it changes nothing", "alignment_mm")
        return self


def _usual(kind: IsolatedKind, length: float, alignment_mm: float = 0.0, gauge_mm: float = 0.0) -> As:
    """Return what a file need not say of a kind."""
    sizes = (("alignment", 1e-3 * alignment_mm), ("gauge", 1e-3 * gauge_mm))
    return As(Isolated, (("kind", kind), ("length", length), *sizes))


@dataclass(frozen=True, slots=True)
class IsolatedTables:
    """``[[section.defects]]``, ``[[section.switches]]``, ``[[section.joints]]``."""

    defects: tuple[Annotated[Isolated, _usual(IsolatedKind.DEFECT, 10.0)], ...] = ()
    switches: tuple[Annotated[Isolated, _usual(IsolatedKind.SWITCH, 20.0, 2.0, -3.0)], ...] = ()
    joints: tuple[Annotated[Isolated, _usual(IsolatedKind.JOINT, 4.0, 0.8, -0.5)], ...] = ()

    def plan(self) -> tuple[Isolated, ...]:
        """Return them all."""
        return (*self.defects, *self.switches, *self.joints)


def isolated(items: Sequence[Isolated], s: FloatArray, rngs: Sequence[np.random.Generator]) -> FloatArray:
    """Return what isolated irregularities add to alignment and gauge deviation (2, n), m.

    Args:
        s: (n,) m, uniform.

    Raises:
        ParameterError: One is shorter than the grid carries, or is not on the track.
    """
    added = np.zeros((2, len(s)))
    for item, rng in zip(items, rngs, strict=True):
        _check(item, s)
        for at in item.at:
            added += _shape(item, s, at)
        for _ in range(rng.poisson(item.per_metre * float(s[-1] - s[0]))):
            at, share = rng.uniform(float(s[0]), float(s[-1])), rng.uniform(*DRAWN_SHARE)
            side = rng.choice((-1.0, 1.0))
            added += share * np.array([[side], [1.0]]) * _shape(item, s, at)
    return added


def _check(item: Isolated, s: FloatArray) -> None:
    interval = float(s[1] - s[0])
    if item.length < FEWEST_INTERVALS * interval:
        raise ParameterError(
            f"a {item.kind} of {item.length:g} m is too short for a grid of {interval:g} m", field="length_m"
        )
    for at in item.at:
        if not s[0] <= at <= s[-1]:
            raise ParameterError(f"{at:g} m is not on the track, {s[0]:g} to {s[-1]:g} m", field="at_m")


def _shape(item: Isolated, s: FloatArray, at: float) -> FloatArray:
    """Return alignment and gauge (2, n) of one irregularity; 0 outside its length."""
    u = np.clip((s - at) / item.length, -0.5, 0.5)
    wave = 0.5 * (1.0 + np.cos(2.0 * np.pi * u))
    kink = (1.0 - 2.0 * np.abs(u)) ** 2
    plateau = 0.5 * (1.0 + np.cos(2.0 * np.pi * np.clip(2.0 * np.abs(u) - 0.5, 0.0, 0.5)))
    line = wave if item.kind is IsolatedKind.DEFECT else kink
    wide = plateau if item.kind is IsolatedKind.SWITCH else wave
    return np.stack([item.alignment * line, item.gauge * wide])

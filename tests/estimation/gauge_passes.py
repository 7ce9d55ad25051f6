"""Passes over a section whose gauge varies, made from radius functions of single wheels, not by a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.track.passes import Pass, ProfileLife
from estimation.values.arrays import FloatArray

LENGTH = 2000.0  # m
STEP = 0.5  # m


@dataclass(frozen=True, slots=True)
class Wheels:
    """Radii over the lateral position towards the flange, steeper there, up to a constant; right unlike left."""

    cone: float

    def left(self, u: FloatArray) -> FloatArray:
        return np.asarray(self.cone * u + 9 * u**2 + 900 * u**3)

    def right(self, u: FloatArray) -> FloatArray:
        return np.asarray((self.cone + 0.02) * u + 6 * u**2 + 700 * u**3)

    def difference(self, x: FloatArray, gauge: FloatArray) -> FloatArray:
        """Return R at displacement x and gauge deviation e: each wheel against its own rail."""
        return self.left(x - gauge / 2) - self.right(-x - gauge / 2)


def wave(rng: np.random.Generator, short: float, long: float, std: float, points: int) -> FloatArray:
    """Return noise (points,) of wavelengths from ``short`` to ``long``, m, on a grid of STEP."""
    spectrum = np.fft.rfft(rng.standard_normal(points))
    frequency = np.fft.rfftfreq(points, STEP)
    spectrum[(frequency < 1 / long) | (frequency > 1 / short)] = 0.0
    values = np.fft.irfft(spectrum, points)
    return np.asarray(std * values / values.std())


@dataclass(frozen=True, slots=True)
class Section:
    """A true section on a grid of STEP."""

    s: FloatArray
    alignment: FloatArray
    gauge: FloatArray


def section(gauge_std: float, *, seed: int = 1, longest: float = 25.0) -> Section:
    """Return a section of alignment 2 mm SD; the gauge varies over 12 m and more."""
    rng = np.random.default_rng(seed)
    s = np.arange(round(LENGTH / STEP) + 1) * STEP
    gauge = wave(rng, 12.0, 200.0, gauge_std, len(s)) if gauge_std else np.zeros(len(s))
    return Section(s, wave(rng, 6.0, longest, 2e-3, len(s)), gauge)


def passes(
    place: Section,
    cones: Mapping[str, float] | Mapping[ProfileLife, float],
    times: int,
    *,
    noise: float = 0.02e-3,
    seed: int = 2,
) -> list[Pass]:
    """Return ``times`` passes of each wheelset, each on a course of its own."""
    rng = np.random.default_rng(seed)
    found = []
    for number, (name, cone) in enumerate(cones.items()):
        for turn in range(times):
            n = len(place.s)
            x = wave(rng, 10.0, 60.0, 2e-3, n)
            y = place.alignment + x + noise * rng.standard_normal(n)
            difference = Wheels(cone).difference(x, place.gauge)
            start_ns = (10 * turn + number) * 86_400 * 10**9
            life = name if isinstance(name, ProfileLife) else ProfileLife(name)
            found.append(Pass(life, f"V{number}", start_ns, place.s, y, difference))
    return found

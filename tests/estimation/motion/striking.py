"""Signals of an axle box that something strikes, at 250 Hz."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray

INTERVAL = 0.004  # s
BLOW = np.array([0.4, 1.0, 0.5, -0.4, -0.3, -0.1])


@dataclass(frozen=True)
class Struck:
    """Lateral and roll acceleration (n,), what they are without blows, and the speed."""

    lateral: FloatArray
    roll: FloatArray
    calm: FloatArray
    speed: FloatArray


def struck_at(places: FloatArray, size: float, speed: float, noise: float = 0.3, seconds: float = 60.0) -> Struck:
    """Return what sensors give where blows of some m/s2 come at some m run; to the right, the left box up."""
    n = round(seconds / INTERVAL)
    rng = np.random.default_rng(1)
    calm = 0.5 * np.sin(2.0 * np.pi * 1.7 * INTERVAL * np.arange(n))
    blows = np.zeros(n)
    at = np.interp(places, speed * INTERVAL * np.arange(n), np.arange(n), left=-1.0, right=-1.0)
    index = np.arange(len(BLOW))
    for place in at[(at >= 0) & (at < n - len(BLOW) - 2)]:
        first = int(place)
        grid = np.arange(first, first + len(BLOW) + 1)
        blows[grid] += size * np.interp(grid - place, index, BLOW, left=0.0, right=0.0)
    lateral = calm - blows + noise * rng.standard_normal(n)
    return Struck(lateral, 0.7 * blows + noise * rng.standard_normal(n), calm, np.full(n, speed))


def once_a_turn(turn: float, metres: float = 3000.0) -> FloatArray:
    """Return places of the blows of a flat, m run."""
    return np.arange(0.7, metres, turn)

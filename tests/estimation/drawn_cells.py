"""Cells of the tests of wheels and rails apart, drawn from the model with known truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.rails.cell import Anchors, ReferenceWheel
from estimation.values.arrays import FloatArray
from estimation.values.opinions import RailKey, SectionConicity, WheelKey

AMPLITUDE = np.array([2.0e-3, 3.0e-3])
DESIGN = 0.2  # conicity of the wheel as designed on the reference rails
DAY_NS = 86_400 * 10**9
YEAR_NS = 365.25 * DAY_NS
SECTIONS = ("A", "B", "C", "D")
PERIODS = 12  # in which known rails are known


def wheel(serial: str, interval: int = 0) -> WheelKey:
    return WheelKey(serial, 0, interval)


def cell(
    of: WheelKey,
    section: str,
    conicity: float,
    *,
    period: int = 0,
    std: float = 0.004,
    systematic: float = 0.0,
    scale_std: float = 0.0,
) -> SectionConicity:
    both = np.ones(2)
    from_ns = round(period * 0.5 * YEAR_NS)
    return SectionConicity(
        wheel=of,
        rail=RailKey(section, period),
        amplitude=AMPLITUDE,
        conicity=conicity * both,
        sampled=std * both,
        systematic=systematic * both,
        scale_std=scale_std,
        windows=6,
        from_ns=from_ns,
        to_ns=from_ns + DAY_NS,
    )


def anchors(*known: str) -> Anchors:
    both = np.ones(2)
    rails = frozenset(RailKey(section, period) for section in known for period in range(PERIODS))
    return Anchors(ReferenceWheel("P8", DESIGN * both, dict.fromkeys(SECTIONS, DESIGN * both)), rails)


@dataclass(frozen=True)
class Fleet:
    """Wheels on sections, with what is true of them."""

    cells: list[SectionConicity]
    wheels: FloatArray  # (w,)
    rails: FloatArray  # (s,) at the mean wheel
    slopes: FloatArray  # (s,)

    def reference_wheel(self) -> FloatArray:
        return np.asarray(DESIGN + self.rails + self.slopes * (DESIGN - 0.25))


def drawn_fleet(seed: int, wheels: int = 12, std: float = 0.004, interaction: float = 0.004) -> Fleet:
    """Return a fleet; rails of section A are known. Every wheel runs on A or D, and on one of B and C at least."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0.19, 0.31, wheels)
    rails = np.concatenate([[0.0], rng.uniform(-0.06, 0.15, len(SECTIONS) - 1)])
    slopes = np.concatenate([[0.0], rng.normal(0.0, 0.3, len(SECTIONS) - 1)])
    found = []
    for w in range(wheels):
        runs = [w % 2 * 3, 1 + w // 2 % 2, *([1 + (w // 2 + 1) % 2] if rng.uniform() < 0.5 else [])]
        for s in runs:
            value = theta[w] + rails[s] + slopes[s] * (theta[w] - 0.25)
            noisy = float(value + rng.normal(0.0, np.hypot(std, interaction)))
            found.append(cell(wheel(f"W{w:02d}"), SECTIONS[s], noisy, std=std))
    return Fleet(found, theta, rails, slopes)

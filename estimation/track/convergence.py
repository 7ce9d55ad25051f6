"""How an iteration ended."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Iterated(StrEnum):
    """What is iterated."""

    POSITIONS = "positions"
    STIFFNESS_RATIOS = "stiffness_ratios"
    GAUGE_STEP = "gauge_step"
    GAUGE = "gauge"


@dataclass(frozen=True, slots=True)
class Convergence:
    """How the iteration of one quantity ended."""

    of: Iterated
    converged: bool
    rounds: int
    change: float  # by the last round: m of positions and gauge, relative of stiffness ratios; NaN of a linear solve

"""What a window says of the rolling radius (``estimation.motion.rolling_sums``)."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.values.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class RollingSums:
    """Sums over pieces of a window, weighted by what the noise of the sensors leaves of the equation."""

    products: FloatArray  # (BANDS, TERMS, TERMS)
    noise: FloatArray  # (BANDS, TERMS, TERMS), of ``products``: what the noise on file makes of it on average


@dataclass(frozen=True, slots=True)
class WindowRollingSums:
    """What a window says of its rolling radius, part by part, and what that was made from."""

    wheelset: str
    start_ns: int
    window_digest: str  # of its content
    assumed: str  # digest of its class and parameters
    parts: tuple[RollingSums, ...]

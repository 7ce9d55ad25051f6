"""What an error of the lateral displacement does to a curve over it, and what of that remains unknown.

A measured displacement has an error (std e). A large measured displacement is too large on average, by the factor
1/(1 - e^2/var), which flattens the curve; and kinks are rounded over e.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray

SCALE_UNCERTAINTY = 0.003  # of a displacement that was integrated and projected
SCATTER = 2.5  # std over which samples scatter across a jump, in std of the error
ORIGIN = 0.005e-3  # m, std of the origin of band-limited motion: it is the mean of the observed displacements
ORIGIN_STD_SHARE = 0.25  # share of ``jump_position_std`` that is added to it
MOST_EXCESS = 0.2  # of the variance of the displacement that its error may make up


@dataclass(frozen=True, slots=True)
class DisplacementError:
    """Std of the error of y - d, by how much the measured displacement is too large, and what is off as a whole."""

    std: float  # m
    excess: float  # share
    scale: float  # share, std
    origin: float = 0.0  # m, std
    jump_position_std: float = 0.0  # m, std of where contact jumps are besides

    def resolution(self, width: float) -> float:
        """Return the length, m, over which bins of ``width`` (m) smooth a curve: error, half a bin, place of jumps."""
        return float(np.sqrt(self.std**2 + (0.4 * width) ** 2 + self.jump_position_std**2))

    @staticmethod
    def of(
        std: float,
        centre: FloatArray,
        samples: FloatArray,
        *,
        integrated: bool,
        scale: float = 0.0,
        jump_position_std: float = 0.0,
    ) -> DisplacementError:
        """Return the error for displacements distributed as ``samples`` (b,) over bins at ``centre`` (b,), m.

        ``scale`` is the relative std of a common scale error of y - d besides that of the integration,
        ``jump_position_std``, m, that of where contact jumps are.
        """
        variance = float(np.average(centre**2, weights=samples)) if samples.any() else 0.0
        excess = min(std**2 / variance, MOST_EXCESS) if variance > 0 else 0.0
        known = (0.0, 0.0) if not integrated else (SCALE_UNCERTAINTY, ORIGIN)
        return DisplacementError(std, excess, float(np.hypot(known[0], scale)), known[1], jump_position_std)

    def rounded(self, x: FloatArray, values: FloatArray) -> FloatArray:
        """Return the curve averaged over a normal error of x (three-point Gauss-Hermite); straight beyond its ends."""
        step = np.sqrt(3.0) * self.std
        line_low = (values[1] - values[0]) / (x[1] - x[0])
        line_high = (values[-1] - values[-2]) / (x[-1] - x[-2])
        before = np.interp(x - step, x, values) + line_low * np.minimum(x - step - x[0], 0.0)
        after = np.interp(x + step, x, values) + line_high * np.maximum(x + step - x[-1], 0.0)
        return np.asarray(before / 6 + 2 * values / 3 + after / 6)

    def std_of_bins(self, centre: FloatArray, values: FloatArray, smooth: BoolArray, observed: BoolArray) -> FloatArray:
        """Return what the error leaves unknown of a value per bin (b,): scale, origin, rounding.

        Parameters
        ----------
        centre
            (b,) m.
        values
            (b,) in any unit.
        smooth
            (b,) bins with a value of the curve; elsewhere the result is zero.
        observed
            (b,) bins with any value, those included that a contact jump crosses: no part of the curve's slope, but
            samples scatter from them into their neighbours.
        """
        left_unknown = np.zeros(len(centre))
        if smooth.sum() < 2:  # noqa: PLR2004 - no slope of one value
            return left_unknown
        x = centre[smooth]
        slope = np.gradient(values[smooth], x)
        above_centre = values[smooth] - np.interp(
            0.0, x, values[smooth]
        )  # jumps below are part of it, not of the slope
        scaled = np.maximum(np.abs(slope * x), np.abs(above_centre)) * np.hypot(self.excess, self.scale)
        shifted = np.hypot(scaled, slope * np.hypot(self.origin, ORIGIN_STD_SHARE * self.jump_position_std))
        scattered = np.zeros(len(centre))
        both = replace(self, std=float(np.hypot(SCATTER * self.std, self.jump_position_std)))
        scattered[observed] = both.rounded(centre[observed], values[observed]) - values[observed]
        left_unknown[smooth] = np.hypot(shifted, scattered[smooth])
        return left_unknown

"""The alignment down to long wavelengths, once the wheelsets' curves are known.

The curves come from short wavelengths, where sensors are quiet. With them every pass gives the alignment by itself,
d = y - h(R), through a longer filter; what is published is the mean over the passes, each with its weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.filters.local_cubic import high_pass, local_cubic_kernel, valid_support
from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel, unfiltered_residual
from estimation.track.panel.solution import PanelSolution
from estimation.values.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class LongWaveAlignment:
    """Mean of y - h(R) over the passes, high-passed at ``cutoff_wavelength`` only."""

    cutoff_wavelength: float  # m
    alignment: FloatArray  # (n,) m, zero where no pass
    pass_std: float  # m, of one pass, from the spread of the passes
    passes: FloatArray  # (n,) sum of their weights
    curves: FloatArray  # (n,) m, mean of h(R) over the passes, zero where no pass


def long_wave_alignment(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel, cutoff_wavelength: float
) -> LongWaveAlignment:
    """Return the alignment from ``passes`` with the curves of ``solution``.

    Args:
        cutoff_wavelength: Of the alignment that is returned, m.
    """
    weights = local_cubic_kernel(cutoff_wavelength, panel.grid.step)
    total, square, count, curves = np.zeros((4, panel.grid.points))
    for item in passes:
        curve = solution.curve_of(item.life)
        if item.empty or curve is None:
            continue
        rest = unfiltered_residual(item, curve, panel)
        pass_residual, y = high_pass(np.stack([rest, item.displacement]), weights)
        inside = valid_support(item.certain, weights) & panel.grid.contains(item.points)
        at = item.points[inside]
        weight = panel.known.weight_of(item.life)
        total[at] += weight * pass_residual[inside]
        square[at] += weight * pass_residual[inside] ** 2
        curves[at] += weight * (y - pass_residual)[inside]
        count[at] += weight
    shared = np.where(count > 0.0, count, 1.0)
    mean = total / shared
    several = count > 1
    spread = (square - count * mean**2)[several].sum() / max(float((count - 1)[several].sum()), 1.0)
    return LongWaveAlignment(cutoff_wavelength, mean, float(np.sqrt(max(spread, 0.0))), count, curves / shared)

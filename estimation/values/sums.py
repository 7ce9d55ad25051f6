"""Where sums of friction and of dampers are kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import frozen_array


@dataclass(frozen=True, slots=True)
class SumsParameters:
    """Places, coefficients of friction and shares of damping of the sums.

    Sums that are stored keep theirs: with others, the windows have to be looked at again.
    """

    cell_length: float = 50.0  # m, of the places whose friction is separated
    # coefficients of friction at which sums are kept; between them the sums are interpolated over the inverse
    frictions: tuple[float, ...] = (
        *(4.0, 1.5, 0.8, 0.6, 0.45, 0.35, 0.28, 0.22, 0.18, 0.15, 0.125, 0.1, 0.08, 0.065, 0.05, 0.035),
    )
    # particles: shares of the damping on file at which sums are kept; between them innovations are interpolated
    damping_shares: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.2, 1.5, 2.0)


SUMS = SumsParameters()
CELL_LENGTH, SHARES = SUMS.cell_length, SUMS.damping_shares
INVERSE = frozen_array(1.0 / np.array(SUMS.frictions), (len(SUMS.frictions),), name="INVERSE")  # (k,) 1/mu, increasing

"""Which lateral displacement the rolling radius difference is looked up by: that of EN 15302.

The wheelset of EN 15302 does not roll. One in motion rolls by phi_c where its contact moves. Turned about the centre of
curvature of the rail head under its contact, rho below the top of the rail, a wheel keeps its contact; so the contact
of a wheelset that rolls is that of one that does not, displaced by what it is displaced at *that* height:

    y_EN = x + (r0 + rho) phi_c        x of the axle relative to the track, r0 above the rails

Sensors are at the height of the axle. On a track that rolls by phi_t the axle stands r0 phi_t beside the middle of the
rails, to the low side, and the roll sensor measures phi = phi_t + phi_c, so that

    y_EN = (y - d) + r0 phi + rho phi_c

The first two terms are measured. The last is too where the track does not roll. Where it may, it is hidden behind the
roll of the track, and taken as a share of the displacement that most profiles have; ``geometry.rolling_line`` puts
what the curve says in its place. The equations of motion go on in the displacement of the axle.
"""

from __future__ import annotations

from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import RAIL_HEAD_RADIUS

HIDDEN_SHARE = 0.009  # rho phi_c over y - d + r0 phi, median of 157 pairs: 0.001 for cones at 1:40, 0.02 where worn


def standard_displacement(displacement: FloatArray, roll: FloatArray, radius: float, *, level: bool) -> FloatArray:
    """Return the displacement (n,), m, relative to the track, that EN 15302 means.

    Args:
        displacement: (n,) y - d, m, at the height of the axle.
        level: Whether gravity has been taken out of the lateral signals: the track may roll.
    """
    seen = observed_displacement(displacement, roll, radius, level=level)
    return seen * (1.0 + HIDDEN_SHARE) if level else seen


def observed_displacement(displacement: FloatArray, roll: FloatArray, radius: float, *, level: bool) -> FloatArray:
    """Return the same (n,), m, as far as it is measured; for a displacement from which no alignment is taken off."""
    height = radius if level else radius + RAIL_HEAD_RADIUS
    return displacement + height * roll

"""What the roll of the track does to the lateral displacement of a wheelset.

Sensors are at the height of the axle, r0 above the rails. On a track that rolls by phi_t the axle stands r0 phi_t
beside the middle of the rails, to the low side. The roll sensor measures phi = phi_t + phi_c, of track and contact, so
that the displacement x relative to the rails follows from that of the axle, y, and the alignment d by

    x = y - d + r0 phi_t = y - d + r0 phi - r0 phi_c(x).

The contact's roll is nearly in proportion to the displacement, and its part is small.
"""

from __future__ import annotations

from estimation.values.arrays import FloatArray

CONTACT_ROLL = 0.105  # rad/m, roll of the contact per displacement: P8 on 56E1 have 0.08 new and 0.13 worn, at 3 mm


def relative_displacement(displacement: FloatArray, roll: FloatArray, radius: float) -> FloatArray:
    """Return x (n,), m, of a wheelset on a track that may roll.

    Parameters
    ----------
    displacement
        (n,) y - d, m, at the height of the axle.
    roll
        (n,) phi as measured, rad.
    radius
        Nominal rolling radius, m.
    """
    return at_rail_level(displacement, roll, radius) / (1.0 + radius * CONTACT_ROLL)


def at_rail_level(displacement: FloatArray, roll: FloatArray, radius: float) -> FloatArray:
    """Return the lateral displacement (n,), m, of the point of the wheelset that is r0 below the axle.

    Parameters
    ----------
    displacement
        (n,) m, at the height of the axle.
    roll
        (n,) phi as measured, rad.
    radius
        Nominal rolling radius, m.
    """
    return displacement + radius * roll

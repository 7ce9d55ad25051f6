"""What an estimated curve says of the roll of its contact, and so of the displacement that EN 15302 means.

``motion.cross_level`` looks R up by the displacement at the centre of curvature of the rail head, 80 mm below its top.
Two things are open there, of which the curve itself knows.

Where the track may roll, phi_c is hidden. Wheels that roll much are steep: R without its rises is twice the contact
angle times the displacement, as far as wheels do not follow the head, and phi_c is the contact angle too.

Where R rises steeply, the wheel on the smaller radius passes the crown of its rail, or jumps over it. A wheel that
touches at two places turns about the point where the normals of both meet, which is deeper than the centre of the arc
beside the crown: the rise is further out than the rest of the curve says. A jump to the gauge corner comes where R has
been flat and the wheelset has hardly rolled: it stays.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from estimation.contact.conicity import zero_crossing
from estimation.geometry.sharpening import displaced, split_at_rises
from estimation.motion.cross_level import HIDDEN_SHARE
from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import RAIL_HEAD_RADIUS

ROLL_PER_DISPLACEMENT = 0.03  # rad/m, of phi_c, of any wheel
ROLL_PER_RADIUS = 0.3  # rad/m, of phi_c per R without its rises
CROWN_DEPTH = 0.16  # m, below the rail head: about where a wheel turns that passes its crown


class ContactRoll(StrEnum):
    """Whether the roll of the contact is part of the displacement that a curve is over."""

    SEEN = "seen"  # on level track: as measured
    HIDDEN = "hidden"  # behind the roll of the track: a share that is alike for all wheels


def standard_curve(x: FloatArray, curve: FloatArray, roll: ContactRoll) -> tuple[FloatArray, FloatArray]:
    """Return displacement and rolling radius difference (n,), m, as EN 15302 means them.

    Args:
        x, curve: (n,) m, strictly increasing displacement as ``motion.cross_level`` gives it, and R. Where R is nowhere
            zero it is left as it is.
        roll: Whether that displacement has measured the roll of the contact.
    """
    middle = zero_crossing(x, curve)
    if not np.isfinite(middle):
        return x, curve
    away = x - middle
    flat, rises = split_at_rises(x, curve, middle)
    phi = ROLL_PER_DISPLACEMENT * away + ROLL_PER_RADIUS * flat
    moved = curve - rises + displaced(x, rises, middle, (CROWN_DEPTH - RAIL_HEAD_RADIUS) * np.abs(phi))
    if roll is ContactRoll.SEEN:
        return x, moved
    taken = HIDDEN_SHARE / (1.0 + HIDDEN_SHARE) * away
    return x + RAIL_HEAD_RADIUS * phi - taken, moved

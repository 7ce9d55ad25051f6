"""What a depot measures on a wheel: flange height Sh, thickness Sd and gradient qR, and the hollow of the tread.

Sh, Sd and qR are those of EN 15313:2016 (and of profile gauges, which print them): with the tread datum 70 mm from the
flange back, Sh is the height of the flange tip over the tread there, Sd the distance of the flange face from the flange
back 10 mm beyond the tread, and qR the lateral distance of that point from the face 2 mm short of the tip. EN 15313
leaves the hollow to the operator; here it is the depth of the tread below the highest point farther out, which is what
a straight edge from the field side finds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.contact.profiles import TREAD_DATUM, Profile
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray

_FACE_BELOW_TREAD = 10e-3  # m, where the flange thickness is measured
_FACE_ABOVE_TIP = 2e-3  # m, upper point of the flange gradient
_TREAD_FROM = -0.030  # m, field side of the flange root
_RIM_MARGIN = 5e-3  # m, the outermost part belongs to the chamfer
_FINE = 2e-5  # m


@dataclass(frozen=True, slots=True)
class WearMeasures:
    """Wear measures of a wheel profile, m."""

    flange_height: float  # Sh: tip of the flange below the tread at the datum
    flange_thickness: float  # Sd: flange back to flange face, 10 mm below the tread at the datum
    flange_gradient: float  # qR: lateral distance from there to the face 2 mm above the tip
    hollow: float  # largest rise of the profile from the tread to a point further out


def wear_measures(wheel: Profile) -> WearMeasures:
    """Return the wear measures of a wheel whose origin is the tread datum, 70 mm from the flange back.

    Raises:
        ProfileError: A rail, or a profile that does not reach from the flange to the datum.
    """
    if wheel.kind != "wheel":
        raise ProfileError(f"{wheel.name!r} is a rail; wear measures are a wheel's", field="kind")
    if not wheel.y[0] < _TREAD_FROM or not wheel.y[-1] > 0.0:
        raise ProfileError(f"{wheel.name!r} does not reach from the flange to the tread datum", field="y")
    y = np.arange(wheel.y[0], wheel.y[-1], _FINE)
    z = wheel.height(y)
    tip = int(np.argmax(z))
    tread = float(wheel.height(np.zeros(1))[0])
    thick = _face(y[tip:], z[tip:], tread + _FACE_BELOW_TREAD)
    high = _face(y[tip:], z[tip:], float(z[tip]) - _FACE_ABOVE_TIP)
    return WearMeasures(float(z[tip]) - tread, thick + TREAD_DATUM, thick - high, _deepest_hollow(y, z))


def _face(y: FloatArray, z: FloatArray, level: float) -> float:
    """Return where the flange face, from its tip outwards, first rises above ``level``."""
    above = np.flatnonzero(z < level)
    if len(above) == 0 or above[0] == 0:
        raise ProfileError(f"the flange face does not cross a depth of {level * 1e3:.2f} mm", field="z")
    i = int(above[0])
    return float(y[i] - (y[i] - y[i - 1]) * (level - z[i]) / (z[i - 1] - z[i]))


def _deepest_hollow(y: FloatArray, z: FloatArray) -> float:
    """Return the largest amount by which a point further out is deeper than the tread."""
    part = z[(y >= _TREAD_FROM) & (y <= y[-1] - _RIM_MARGIN)]
    deepest_outside = np.maximum.accumulate(part[::-1])[::-1]
    return float((deepest_outside - part).max())

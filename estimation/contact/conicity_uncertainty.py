"""How well the equivalent conicity of measured profiles is known: their noise carried through the contact search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack
from estimation.contact.radius_difference import radius_difference_curve
from estimation.contact.smoothed_profile import SmoothedProfile
from estimation.contact.table import ContactMethod
from estimation.errors import ContactError
from estimation.values.arrays import FloatArray

DRAWS = 48
FEWEST = 0.8  # share of the draws that must cover an amplitude
_SEED = 20_15302


@dataclass(frozen=True, slots=True)
class MeasuredShapes:
    """The four profiles of a wheelset on a track with their uncertainty; one that is used twice errs alike."""

    left_wheel: SmoothedProfile
    right_wheel: SmoothedProfile
    left_rail: SmoothedProfile
    right_rail: SmoothedProfile

    @property
    def exact(self) -> bool:
        """Whether all four shapes are known."""
        return all(shape.spline is None for shape in self._all())

    def draw(self, wheelset: WheelsetOnTrack, random: np.random.Generator) -> WheelsetOnTrack:
        """Return the wheelset with profiles that the measurements allow."""
        different = {id(shape): shape for shape in self._all()}
        drawn = {key: shape.draw(random) for key, shape in different.items()}
        return replace(
            wheelset,
            left_wheel=drawn[id(self.left_wheel)],
            right_wheel=drawn[id(self.right_wheel)],
            left_rail=drawn[id(self.left_rail)],
            right_rail=drawn[id(self.right_rail)],
        )

    def _all(self) -> tuple[SmoothedProfile, ...]:
        return self.left_wheel, self.right_wheel, self.left_rail, self.right_rail


def conicity_std(
    wheelset: WheelsetOnTrack,
    shapes: MeasuredShapes,
    lateral_displacement: npt.ArrayLike,
    amplitudes: npt.ArrayLike,
    *,
    method: ContactMethod = ContactMethod.EN15302,
    draws: int = DRAWS,
) -> FloatArray:
    """Return the standard deviation (k,) of tan(gamma_e) that follows from the noise of the profiles.

    Profiles are drawn from what the measurements allow, and the contact search is done for each: contact jumps move,
    appear and vanish with them. 0 for profiles that are known; NaN for an amplitude that fewer than 80 % of the draws
    cover. Errors of an instrument that are alike along the whole profile (scale, tilt) are not in it.

    Args:
        shapes: The same profiles with their uncertainty.
        lateral_displacement: (n,) m, strictly increasing: the grid of the contact search.
        amplitudes: (k,) m, positive.

    Raises:
        ContactError: The profiles never touch.
    """
    wanted = np.array(amplitudes, dtype=np.float64, ndmin=1)
    if shapes.exact:
        return np.zeros(len(wanted))
    random = np.random.default_rng(_SEED)
    expected = _conicity(wheelset, lateral_displacement, wanted, method)
    values = np.full((draws, len(wanted)), np.nan)
    for row in range(draws):
        try:
            drawn = shapes.draw(wheelset, random)
            values[row] = _conicity(drawn, lateral_displacement, wanted, method)
        except ContactError:
            continue
    covered = np.isfinite(values)
    squares = np.where(covered, (values - expected) ** 2, 0.0).sum(axis=0) / np.maximum(covered.sum(axis=0), 1)
    return np.where(covered.mean(axis=0) >= FEWEST, np.sqrt(squares), np.nan)


def _conicity(
    wheelset: WheelsetOnTrack, displacement: npt.ArrayLike, amplitudes: FloatArray, method: ContactMethod
) -> FloatArray:
    curve = radius_difference_curve(wheelset, displacement, method=method)
    return equivalent_conicity(curve.displacement, curve.difference, amplitudes)

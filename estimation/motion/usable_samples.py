"""Which samples of a window can be used, and what became of the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.motion.curves import straight
from estimation.motion.parameters import CurveLimits, SignalParameters
from estimation.values.arrays import BoolArray, frozen_array
from estimation.values.track import TrackLayout
from estimation.values.windows import Window


def moving_samples(window: Window, parameters: SignalParameters) -> BoolArray:
    """Return the valid samples (n,) at known positions at which the vehicle runs fast enough.

    Parameters
    ----------
    window
        Speed and distance, (n,) each.
    parameters
        The least speed.
    """
    with np.errstate(invalid="ignore"):
        fast_enough = window.speed >= parameters.least_speed_m_s
    return np.asarray(window.valid & np.isfinite(window.distance) & fast_enough)


@dataclass(frozen=True, slots=True)
class Usable:
    """Samples that can be used (n,), and the share of all samples that was lost by each cause, counted once."""

    samples: BoolArray
    lost: Mapping[str, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", frozen_array(self.samples, (len(self.samples),), np.bool_, name="samples"))

    @property
    def causes(self) -> str:
        """What was lost and why, the largest share first."""
        ordered = sorted(self.lost.items(), key=lambda item: -item[1])
        return ", ".join(f"{share:.0%} {cause}" for cause, share in ordered if share > 0)


def usable_samples(
    window: Window, known: BoolArray, layout: TrackLayout | None, least_speed: float, limits: CurveLimits
) -> Usable:
    """Return the samples of ``window`` that can be used.

    Parameters
    ----------
    window
        Samples.
    known
        (n,) samples at places of known alignment.
    layout
        Curves of its section; None where none is on file: then every place counts as straight.
    least_speed
        m/s.
    limits
        What is left out of curves.
    """
    with np.errstate(invalid="ignore"):
        moving = window.speed >= least_speed
    tests = {
        "missing, clipped or invalid": window.valid,
        "off the known part of the section": known,
        f"slower than {least_speed:g} m/s": moving,
    }
    if layout is not None:
        tests["in curves"] = straight(window.distance, layout, limits)
    left, lost = np.ones(len(window.valid), dtype=np.bool_), {}
    for cause, passed in tests.items():
        lost[cause] = float((left & ~passed).mean())
        left &= passed
    return Usable(left, lost)

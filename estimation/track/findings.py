"""What a settled section says besides its alignment: of the vehicles, of the gauge, of the wheels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.arrays import FloatArray
from estimation.track.settling import Settled
from estimation.track.wheel_functions import fitted, gauge_factor, places
from estimation.types import Findings

LIFE = "#"  # after a wheelset's serial, then the number of its profile and that of its mileage interval
UNKNOWN_SHARE = 0.6  # of its own std that an estimated gauge deviation may be off by


@dataclass(frozen=True, slots=True)
class Told:
    """Findings, and the gauge deviation (n,) with its std, m, where the passes themselves tell it."""

    findings: Findings
    gauge: FloatArray | None
    gauge_std: FloatArray | None


def findings(settled: Settled, *, gauge_estimated: bool) -> Told:
    """Return what the passes tell; ``gauge_estimated`` where the gauge of the panel came from them."""
    ratios = {vehicle: one.value for vehicle, one in settled.ratios.items()}
    std = max((one.std for one in settled.ratios.values()), default=0.0)
    gauge = settled.panel.gauge
    if gauge is None:
        return Told(Findings(ratios, std, {}), None, None)
    panel = settled.panel
    seen = places(settled.passes, settled.solution, settled.solution.alignment, panel)
    factor = gauge_factor(seen) if gauge_estimated else 1.0
    lives = fitted(seen, factor)
    wheels = {_life(name)[0]: lives[name] for name in sorted(lives, key=_life)}  # of several lives the latest
    found = Findings(ratios, std, wheels)
    if not gauge_estimated:
        return Told(found, None, None)
    sized = factor * gauge
    return Told(found, sized, np.full(len(sized), UNKNOWN_SHARE * float(sized.std())))


def _life(name: str) -> tuple[str, tuple[int, ...]]:
    """Return the serial of a wheelset and the numbers of its life, in whose order lives follow each other."""
    serial, *numbers = name.rsplit(LIFE, 2)
    return serial, tuple(int(number) for number in numbers)

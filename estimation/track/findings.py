"""What a settled section says besides its alignment: of the vehicles, of the gauge, of the wheels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.arrays import FloatArray
from estimation.track.settling import Settled
from estimation.track.wheel_functions import gauge_sign, places, whole_shifts
from estimation.types import Findings, GaugeShift

LIFE = "#"  # after a wheelset's serial, then the number of its profile and that of its mileage interval
UNKNOWN_SHARE = 0.3  # of its own std that an estimated gauge deviation may be off by


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
    shifts = whole_shifts(settled.solution, panel)
    sign = gauge_sign(places(settled.passes, settled.solution, panel), shifts) if gauge_estimated else 1
    if sign < 0:
        shifts = {name: _turned(one) for name, one in shifts.items()}
    latest = {_life(name)[0]: shifts[name] for name in sorted(shifts, key=_life)}  # of several lives the latest
    found = Findings(ratios, std, latest)
    if not gauge_estimated:
        return Told(found, None, None)
    return Told(found, sign * gauge, np.full(len(gauge), UNKNOWN_SHARE * float(gauge.std())))


def _turned(shift: GaugeShift) -> GaugeShift:
    """Return what a gauge of the other sign does; the grid is symmetric."""
    return replace(shift, shift=shift.shift[:, ::-1])


def _life(name: str) -> tuple[str, tuple[int, ...]]:
    """Return the serial of a wheelset and the numbers of its life, in whose order lives follow each other."""
    serial, *numbers = name.rsplit(LIFE, 2)
    return serial, tuple(int(number) for number in numbers)

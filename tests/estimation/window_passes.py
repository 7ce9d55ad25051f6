"""The passes of a window that nothing is wrong with."""

from __future__ import annotations

from estimation.motion.checks import moving_samples
from estimation.motion.integration import SignalParameters, integrate
from estimation.track.passes import Pass, passes
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleParameters


def window_passes(window: Window, vehicle: VehicleParameters, *, mounted_reversed: bool = False) -> list[Pass]:
    """Return the passes of a window as it is."""
    signals = SignalParameters()
    integrated = integrate(window, moving_samples(window, signals), signals)
    return passes(window, integrated, vehicle, mounted_reversed=mounted_reversed)

"""Which windows are good enough to be looked at."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.motion.parameters import SignalParameters
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowQuality
from estimation.vehicle.equations_of_motion import VehicleParameters


@dataclass(frozen=True, slots=True)
class Gates:
    """When a window may be estimated at all."""

    least_coverage: float = 0.25
    most_clipped: float = 0.1  # clipped samples are left out; more than this, and the rest is not trusted
    least_position_quality: float = 0.1


@dataclass(frozen=True, slots=True)
class WindowParameters:
    """What turns a window into motion: the vehicle, the filters, and the gates."""

    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    signals: SignalParameters = field(default_factory=SignalParameters)
    gates: Gates = field(default_factory=Gates)


def gate(quality: WindowQuality, track_section: str | None, gates: Gates) -> Reason | None:
    """Return why a window of this quality is not looked at; None where it is.

    Parameters
    ----------
    quality
        What was counted of the window.
    track_section
        Code of its section; None where it is not known.
    gates
        Limits of the quality.
    """
    if quality.sensor_fault:
        return Reason(ReasonCode.SENSOR_FAULT, "the sensor reports a fault")
    if quality.coverage < gates.least_coverage:
        return Reason(
            ReasonCode.TOO_FEW_SAMPLES,
            f"{quality.coverage:.0%} of the samples are there, {gates.least_coverage:.0%} are needed",
        )
    if quality.clipped > gates.most_clipped:
        return Reason(
            ReasonCode.CLIPPED,
            f"{quality.clipped:.1%} of the samples are clipped, at most {gates.most_clipped:.0%} may be",
        )
    if track_section is None:
        return Reason(ReasonCode.SECTION_UNKNOWN, "the track section is not known")
    if quality.position_quality < gates.least_position_quality:
        return Reason(ReasonCode.POSITION_UNKNOWN, "the position is not known well enough")
    return None

"""Fleets, vehicles and wheelsets, and what happened to them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Self

from annotated_types import Interval

from estimation.errors import ParameterError
from estimation.values.file_units import MM, FileDefault, FileForm, FileUnit, Key

MAX_AXLES = 8
MOST_KM = 1e8
FARTHEST_M = 1000.0  # of an axle from the reference point

SPEED_IN_FILES = FileUnit("_km_h", divisor=3.6)
Code = Annotated[str, FileForm.CODE]
Axle = Annotated[int, Interval(ge=1, le=MAX_AXLES)]
Kilometres = Annotated[float, Interval(ge=0.0, le=MOST_KM)]
MomentNs = Annotated[int, FileForm.MOMENT]
FreeText = Annotated[str, FileForm.FREE_TEXT]
Text = Annotated[str, FileForm.TEXT]


@dataclass(frozen=True, slots=True)
class FleetRecord:
    """A fleet: who operates what."""

    code: Code
    name: Text


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """A vehicle and what its rules depend on."""

    code: Code
    fleet: Code
    vehicle_class: Code
    axles: Axle
    max_speed_m_s: Annotated[float, Interval(ge=1.0, le=600.0), SPEED_IN_FILES, Key("max_speed_km_h")]
    axle_offsets_m: tuple[Annotated[float, Interval(ge=-FARTHEST_M, le=FARTHEST_M)], ...]
    """Distance of each axle behind the position reference, m."""

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse offsets that are not those of the axles."""
        if len(self.axle_offsets_m) != self.axles:
            reason = f"{len(self.axle_offsets_m)} offsets for {self.axles} axles"
            raise ParameterError(reason, field="axle_offsets_m")
        if len(set(self.axle_offsets_m)) < self.axles:
            raise ParameterError("two axles are at one place", field="axle_offsets_m")
        return self


@dataclass(frozen=True, slots=True)
class Mounting:
    """Which wheelset ran at which axle of which vehicle, ``[from_ns, to_ns)`` on the vehicle's clock."""

    wheelset: Code
    vehicle: Code
    axle: Axle
    from_ns: Annotated[MomentNs, Key("from")]
    to_ns: Annotated[MomentNs, Key("to"), FileDefault(None)] | None
    vehicle_odometer_km: Kilometres  # at from_ns
    wheelset_mileage_km: Kilometres  # at from_ns
    reversed: bool = False  # left wheel on the right-hand side

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse an end before the start."""
        if self.to_ns is not None and self.to_ns <= self.from_ns:
            raise ParameterError("must be later than 'from'", field="to")
        return self


@dataclass(frozen=True, slots=True)
class Reprofiling:
    """A wheelset came back from the lathe; every later window belongs to a new baseline."""

    wheelset: Code
    at_ns: Annotated[MomentNs, Key("at")]
    mileage_km: Kilometres
    note: FreeText = ""


class SensorWork(StrEnum):
    """What was done to the sensors of an axle."""

    SWAP = "swap"
    CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True)
class SensorChange:
    """The sensors of an axle were exchanged or calibrated; what was wrong with them before says nothing of them now."""

    vehicle: Code
    axle: Axle
    at_ns: Annotated[MomentNs, Key("at")]
    work: Annotated[SensorWork, FileForm.CHOICE]
    removed: FreeText = ""  # serial number of what was taken off
    fitted: FreeText = ""  # of what is there since
    note: FreeText = ""


@dataclass(frozen=True, slots=True)
class WheelsetRecord:
    """A wheelset by serial, with where it is now and its history of lathes."""

    serial: Code
    fleet: Code
    wheel_profile: Text
    nominal_radius_m: Annotated[float, Interval(ge=100.0, le=1000.0), MM, Key("nominal_radius_mm")]
    mounting: Annotated[Mounting | None, Key(None)] = None
    reprofilings: Annotated[tuple[Reprofiling, ...], Key(None)] = ()

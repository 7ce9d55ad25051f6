"""Fleets, vehicles and wheelsets, and what happened to them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Self

from annotated_types import Interval

from estimation.errors import ParameterError
from estimation.values.fields import MM, FileDefault, FileForm, FileUnit, Key, Served
from estimation.values.units import IN_MM, KM_H_IN_M_S

MAX_AXLES = 8
MOST_KM = 1e8
FARTHEST_M = 1000.0  # of an axle from the reference point

SPEED_IN_FILES = FileUnit("_km_h", divisor=KM_H_IN_M_S)
Code = Annotated[str, FileForm.CODE]
Axle = Annotated[int, Interval(ge=1, le=MAX_AXLES)]
Kilometres = Annotated[float, Interval(ge=0.0, le=MOST_KM)]
MomentNs = Annotated[int, FileForm.MOMENT]
FreeText = Annotated[str, FileForm.FREE_TEXT]
Text = Annotated[str, FileForm.TEXT]


@dataclass(frozen=True, slots=True)
class FleetRecord:
    """A fleet: who operates what."""

    code: Annotated[Code, Served(example="demo")]
    name: Annotated[Text, Served(example="Demonstration fleet")]


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """A vehicle and what its rules depend on."""

    code: Annotated[Code, Served(example="V-101")]
    fleet: Annotated[Code, Served(example="demo")]
    vehicle_class: Annotated[
        Code, Served("Code of its class; while that is not on file the vehicle is not estimated.", example="coach")
    ]
    axles: Annotated[Axle, Served(example=4)]
    max_speed_m_s: Annotated[float, Interval(ge=1.0, le=600.0), SPEED_IN_FILES, Key("max_speed_km_h")]
    axle_offsets_m: Annotated[
        tuple[Annotated[float, Interval(ge=-FARTHEST_M, le=FARTHEST_M)], ...],
        Served(
            "Distance of each axle behind the vehicle's reference point, from the first axle on.",
            example=(2.0, 4.5, 16.0, 18.5),
        ),
    ]

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

    wheelset: Annotated[Code, Served(example="WS-0001")]
    vehicle: Annotated[Code, Served(example="V-101")]
    axle: Annotated[Axle, Served(example=1)]
    from_ns: Annotated[MomentNs, Key("from"), Served("When the wheelset was mounted.", "mounted_from")]
    to_ns: Annotated[
        MomentNs | None,
        Key("to"),
        FileDefault(None),
        Served("When the wheelset was taken off; null means that it still runs there.", "mounted_to"),
    ]
    vehicle_odometer_km: Annotated[Kilometres, Served("Odometer of the vehicle at the time of mounting.")]
    wheelset_mileage_km: Annotated[Kilometres, Served("Mileage of the wheelset at the time of mounting.")]
    reversed: Annotated[bool, Served("The left wheel runs on the right-hand side.")] = False

    def covers(self, at_ns: int) -> bool:
        """Return whether the wheelset was mounted at a time of the vehicle's clock."""
        return self.from_ns <= at_ns and (self.to_ns is None or at_ns < self.to_ns)

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse an end before the start."""
        if self.to_ns is not None and self.to_ns <= self.from_ns:
            raise ParameterError("must be later than 'from'", field="to")
        return self


def mounting_of(mountings: Iterable[Mounting], axle: int, at_ns: int) -> Mounting | None:
    """Return which of the mountings on a vehicle was at an axle at a time of its clock; None where there was none."""
    return next((mounting for mounting in mountings if mounting.axle == axle and mounting.covers(at_ns)), None)


@dataclass(frozen=True, slots=True)
class Reprofiling:
    """A wheelset came back from the lathe; every later window belongs to a new baseline."""

    wheelset: Annotated[Code, Served(example="WS-0001")]
    at_ns: Annotated[MomentNs, Key("at"), Served(name="reprofiled_at")]
    mileage_km: Annotated[Kilometres, Served(example=151200.0)]
    note: FreeText = ""


class SensorWork(StrEnum):
    """What was done to the sensors of an axle."""

    SWAP = "swap"
    CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True)
class SensorChange:
    """The sensors of an axle were exchanged or calibrated; what was wrong with them before says nothing of them now."""

    vehicle: Annotated[Code, Served(example="V-101")]
    axle: Annotated[Axle, Served(example=2)]
    at_ns: Annotated[MomentNs, Key("at"), Served("When it was done.", "worked_at")]
    work: Annotated[SensorWork, FileForm.CHOICE]
    removed: Annotated[FreeText, Served("Serial number of what was taken off.", example="N-0815")] = ""
    fitted: Annotated[FreeText, Served("Serial number of what is there since.", example="N-0816")] = ""
    note: Annotated[FreeText, Served(example="cable chafed")] = ""


@dataclass(frozen=True, slots=True)
class WheelsetRecord:
    """A wheelset by serial, with where it is now and its history of lathes."""

    serial: Annotated[Code, Served(example="WS-0001")]
    fleet: Annotated[Code, Served(example="demo")]
    wheel_profile: Annotated[Text, Served(example="P8")]
    nominal_radius_m: Annotated[
        float,
        Interval(ge=100.0, le=1000.0),
        MM,
        Key("nominal_radius_mm"),
        Served(name="nominal_radius_mm", scale=IN_MM, example=460.0),
    ]
    mounting: Annotated[Mounting | None, Key(None)] = None
    reprofilings: Annotated[tuple[Reprofiling, ...], Key(None)] = ()

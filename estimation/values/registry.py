"""Fleets, vehicles and wheelsets, and what happened to them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.served import MM, Served


@dataclass(frozen=True, slots=True)
class FleetRecord:
    """A fleet: who operates what."""

    code: Annotated[str, Served(example="demo")]
    name: Annotated[str, Served(example="Demonstration fleet")]


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """A vehicle and what its rules depend on."""

    code: Annotated[str, Served(example="V-101")]
    fleet: Annotated[str, Served(example="demo")]
    vehicle_class: Annotated[
        str, Served("Code of its class; while that is not on file the vehicle is not estimated.", example="coach")
    ]
    axles: Annotated[int, Served(example=4)]
    max_speed_m_s: Annotated[float, Served(example=44.4)]
    axle_offsets_m: Annotated[
        tuple[float, ...], Served(example=[2.0, 4.5, 16.0, 18.5])
    ]  # distance of each axle behind the position reference, m


@dataclass(frozen=True, slots=True)
class Mounting:
    """Which wheelset ran at which axle of which vehicle, ``[from_ns, to_ns)`` on the vehicle's clock."""

    wheelset: Annotated[str, Served(example="WS-0001")]
    vehicle: Annotated[str, Served(example="V-101")]
    axle: Annotated[int, Served(example=1)]
    from_ns: Annotated[int, Served(name="mounted_from")]
    to_ns: Annotated[int | None, Served(name="mounted_to")]
    vehicle_odometer_km: float  # at from_ns
    wheelset_mileage_km: float  # at from_ns
    reversed: Annotated[bool, Served("The left wheel runs on the right-hand side.")] = False


@dataclass(frozen=True, slots=True)
class Reprofiling:
    """A wheelset came back from the lathe; every later window belongs to a new baseline."""

    wheelset: Annotated[str, Served(example="WS-0001")]
    at_ns: Annotated[int, Served(name="reprofiled_at")]
    mileage_km: Annotated[float, Served(example=151200.0)]
    note: str = ""


class SensorWork(StrEnum):
    """What was done to the sensors of an axle."""

    SWAP = "swap"
    CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True)
class SensorChange:
    """The sensors of an axle were exchanged or calibrated; what was wrong with them before says nothing of them now."""

    vehicle: Annotated[str, Served(example="V-101")]
    axle: Annotated[int, Served(example=2)]
    at_ns: Annotated[int, Served(name="worked_at")]
    work: SensorWork
    removed: Annotated[str, Served("Serial number of what was taken off.", example="N-0815")] = ""
    fitted: Annotated[str, Served("Serial number of what is there since.", example="N-0816")] = ""
    note: Annotated[str, Served(example="cable chafed")] = ""


@dataclass(frozen=True, slots=True)
class WheelsetRecord:
    """A wheelset by serial, with where it is now and its history of lathes."""

    serial: Annotated[str, Served(example="WS-0001")]
    fleet: Annotated[str, Served(example="demo")]
    wheel_profile: Annotated[str, Served(example="P8")]
    nominal_radius_m: Annotated[float, Served(name="nominal_radius_mm", scale=MM, example=460.0)]
    mounting: Mounting | None
    reprofilings: tuple[Reprofiling, ...] = ()

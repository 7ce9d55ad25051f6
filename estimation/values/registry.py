"""Fleets, vehicles and wheelsets, and what happened to them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


@dataclass(frozen=True, slots=True)
class FleetRecord:
    """A fleet: who operates what."""

    code: str
    name: str


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """A vehicle and what its rules depend on."""

    code: str
    fleet: str
    vehicle_class: str
    axles: int
    max_speed_m_s: float
    axle_offsets_m: tuple[float, ...]  # distance of each axle behind the position reference, m


@dataclass(frozen=True, slots=True)
class Mounting:
    """Which wheelset ran at which axle of which vehicle, ``[from_ns, to_ns)`` on the vehicle's clock."""

    wheelset: str
    vehicle: str
    axle: int
    from_ns: int
    to_ns: int | None
    vehicle_odometer_km: float  # at from_ns
    wheelset_mileage_km: float  # at from_ns
    reversed: bool = False  # left wheel on the right-hand side


@dataclass(frozen=True, slots=True)
class Reprofiling:
    """A wheelset came back from the lathe; every later window belongs to a new baseline."""

    wheelset: str
    at_ns: int
    mileage_km: float
    note: str = ""


class SensorWork(StrEnum):
    """What was done to the sensors of an axle."""

    SWAP = "swap"
    CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True)
class SensorChange:
    """The sensors of an axle were exchanged or calibrated; what was wrong with them before says nothing of them now."""

    vehicle: str
    axle: int
    at_ns: int
    work: SensorWork
    removed: str = ""  # serial number of what was taken off
    fitted: str = ""  # of what is there since
    note: str = ""


@dataclass(frozen=True, slots=True)
class WheelsetRecord:
    """A wheelset by serial, with where it is now and its history of lathes."""

    serial: str
    fleet: str
    wheel_profile: str
    nominal_radius_m: float
    mounting: Mounting | None
    reprofilings: tuple[Reprofiling, ...] = ()

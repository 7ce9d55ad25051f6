"""A scenario: what a simulated fleet is and does. Values only; ``scenario_file`` reads them from TOML."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from datetime import datetime
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from annotated_types import Interval

from estimation.errors import ScenarioError
from estimation.values.fields import KM, M_S, M_S2, MINUTES, MS, PERCENT, US, FileUnit, Key, M, S
from estimation.values.units import DAY_NS, SECOND_NS
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, BogieParameters, VehicleClass, VehicleParameters
from ingest.file_value import Counted, between, written
from ingest.input_file import NotNegative, Positive, field_error
from ingest.simulator.drawn_plan import DrawnFleet
from ingest.simulator.motion import MINIMUM_SPEED
from ingest.simulator.running import CreepPlan, TractionPlan, WheelsPlan
from ingest.simulator.section import SectionPlan, SideFiles
from ingest.simulator.sensors import SensorNode


@dataclass(frozen=True, slots=True)
class ClassOnFile:
    """A class file, and what the registry says of vehicles of that class."""

    path: Path
    vehicle_class: VehicleClass
    nominal_radius: float | None = None  # m, of the wheelsets; None: what it is

    def axle_offsets(self, true: tuple[float, ...]) -> tuple[float, ...]:
        """Return the axle offsets, m, of a vehicle with its bogies in place and the wheelbase of the class."""
        bogie = self.vehicle_class.bogie
        if bogie is None or len(true) % AXLES_OF_A_BOGIE:
            return true
        half = 0.5 * bogie.wheelbase
        middles = (0.5 * (front + rear) for front, rear in zip(true[::2], true[1::2], strict=True))
        return tuple(round(middle + side * half, 6) for middle in middles for side in (-1.0, 1.0))


_AXLE_SPACING = 2.6  # m
BOGIE_SPACING = 19.0  # m between the middles of two bogies
NORMAL_REACH = 3.0  # standard deviations that a normal error of the position is at most


class FaultKind(StrEnum):
    """How a sensor node fails."""

    SENSOR_FAULT = "sensor_fault"  # its signals are "not available", its self-test fails, an emergency is sent
    NO_TRANSMISSION = "no_transmission"  # no frame of the node any more


@dataclass(frozen=True, slots=True)
class Fault:
    """A sensor node that fails in campaign ``from_campaign`` (counted from 1) and stays so."""

    kind: FaultKind
    from_campaign: Counted


@dataclass(frozen=True, slots=True)
class WheelsetPlan:
    """A wheelset, how fast it wears, and when it goes to the lathe.

    Wear is the depth of the hollow in the tread, in metres, as ``estimation.contact.wear`` means it; ``rate_left``
    and ``rate_right`` are per metre run, ``initial_left`` and ``initial_right`` are there when the vehicle's odometer
    stands at 0.
    """

    serial: str
    wheel_profile: str
    nominal_radius: float  # m
    rate_left: float
    rate_right: float
    wear_centre: float  # m, from the tread datum, positive to the field side
    wear_half_width: float  # m
    flange_share: float  # flange wear as a share of the tread's
    initial_left: float  # m
    initial_right: float  # m
    initial_mileage: float  # m, since new, when the vehicle's odometer stands at 0
    reprofilings: tuple[float, ...]  # m, vehicle odometer
    diameter_difference: float  # m, left minus right, at the lathe
    fault: Fault | None
    wheel_files: SideFiles = (None, None)  # measured wheels, before the wear above
    reprofilings_registered: bool = True  # False: the lathe turned it, and nobody registered it


@dataclass(frozen=True, slots=True)
class WeakDamper:
    """A lateral damper that has lost some of its damping from campaign ``from_campaign`` (counted from 1) on.

    It is the damper between frame and body of a bogie, or above a single wheelset.
    """

    share: Annotated[float, between(0.0, 2.0)]  # of its damping that is left
    from_campaign: Counted = 1
    running_gear: Counted | None = None  # counted from 1; None: every one of the vehicle


@dataclass(frozen=True, slots=True)
class VehiclePlan:
    """A vehicle and its wheelsets, front to rear."""

    code: str
    vehicle_class: str
    max_speed: float  # m/s
    axle_offsets: tuple[float, ...]  # m behind the position reference
    wheelsets: tuple[WheelsetPlan, ...]
    longest_run: float = math.inf  # s, where its runs end before those of the others
    weak_damper: WeakDamper | None = None


def usual_offsets(axles: int, bogie: BogieParameters | None = None) -> tuple[float, ...]:
    """Return the distances of ``axles`` axles behind the position reference, m, where none are given."""
    if bogie is None:
        return tuple(_AXLE_SPACING * axle for axle in range(axles))
    pairs = (divmod(axle, AXLES_OF_A_BOGIE) for axle in range(axles))
    return tuple(BOGIE_SPACING * pair + bogie.wheelbase * rear for pair, rear in pairs)


@dataclass(frozen=True, slots=True)
class SpeedRange:
    """Speed wanders smoothly between two values."""

    lowest: Annotated[float, Interval(ge=2.0 * MINIMUM_SPEED), M_S]
    highest: Annotated[float, Interval(le=131.0), M_S]
    period: Annotated[float, Interval(ge=20.0), S] = 120.0  # of the slowest wave
    stop_every: Annotated[NotNegative, S] = 0.0  # between the middles of two stops; 0 for none
    stop: Annotated[NotNegative, S] = 30.0  # of standing
    braking: Annotated[float, Interval(gt=0.0, le=2.0), M_S2] = 0.5  # before and after a stop
    steady: bool = False  # every run has a mean of its own and swings a little about it

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse limits in the wrong order."""
        if self.highest < self.lowest:
            raise field_error(f"{self.highest} is outside the range: at least {self.lowest:g}", "highest_m_s")
        return self


def _with_offset(moment: datetime) -> int:
    if moment.tzinfo is None:
        raise field_error("needs an offset from UTC, as in 2024-01-08T05:30:00Z")
    return round(moment.timestamp()) * SECOND_NS


@dataclass(frozen=True, slots=True, kw_only=True)
class Sessions:
    """When and how long the fleet is recorded: campaigns, between which the odometer jumps."""

    start_ns: Annotated[int, written(datetime, _with_offset), Key("start")]  # vehicle clock, of the first campaign
    campaigns: Annotated[int, between(1, 10_000)]
    duration: Annotated[float, Interval(gt=0.0, le=600.0), MINUTES, Key("minutes_each")] = math.inf
    """s each, at most; inf until it follows from section and speed."""
    push_pull: bool = False  # every second campaign is run with the rear end first
    whole_section: bool = False  # runs begin before the section and end behind it; ``duration`` is the longest
    distance_between: Annotated[Positive, KM, Key("km_between")]  # m
    first_odometer: Annotated[NotNegative, KM] = 0.0  # m
    distance_per_day: Annotated[Positive, KM, Key("km_per_day")] = 1e3 * 400.0  # m
    start_within: Annotated[NotNegative, M] = math.inf  # of the begin of the section: where runs begin; inf: all of it

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse runs of no length, and of two."""
        if "minutes_each" not in given and not self.whole_section:
            raise field_error("is missing", "minutes_each")
        for key in ("minutes_each", "start_within_m"):
            if self.whole_section and key in given:
                raise field_error("cannot be given beside whole_section = true", key)
        return self


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """How far the positions that a vehicle reports are off, one draw per run: uniform errors plus normal ones."""

    offset: Annotated[float, between(0.0, 1000.0), Key("largest_offset_m")] = 0.0  # at most
    scale: Annotated[float, between(0.0, 10.0), PERCENT, Key("largest_scale_percent")] = 0.0  # of the distance run
    offset_std: Annotated[float, between(0.0, 300.0), M] = 0.0  # drawn within three of them
    scale_std: Annotated[float, between(0.0, 3.0), PERCENT] = 0.0
    fixed_offset: Annotated[float, between(0.0, 1000.0), Key("offset_m")] = 0.0  # forwards or backwards
    odometer_scale_std: Annotated[float, between(0.0, 3.0), PERCENT] = 0.0  # of odometer and speed, one per vehicle
    frozen_every: Annotated[float, between(10.0, 1e6), M] = 1000.0  # along the section between the begins of tunnels
    frozen_length: Annotated[NotNegative, M] = 0.0  # of each, in which the last position is repeated

    @property
    def largest_offset(self) -> float:
        """The largest offset that may be drawn, m."""
        return self.offset + NORMAL_REACH * self.offset_std + self.fixed_offset


@dataclass(frozen=True, slots=True)
class BusPlan:
    """How far the bus is from perfect."""

    lost_share: Annotated[float, between(0.0, 50.0), PERCENT, Key("lost_frames_percent")] = 0.0  # of all frames
    burst_per_hour: Annotated[float, between(0.0, 3600.0), Key("bursts_per_hour")] = 0.0  # gaps in everything
    burst: Annotated[float, between(0.0, 60.0), S] = 0.5  # each
    jitter: Annotated[float, between(0.0, 1000.0), US] = 0.0  # standard deviation of a frame's time stamp
    recorder_offset: Annotated[float, between(-86400.0, 86400.0), Key("recorder_clock_offset_s")] = 0.0
    """Recorder's clock minus vehicle clock."""
    stamp_jitter: Annotated[float, between(0.0, 1000.0), US] = 0.0  # standard deviation of each stamp on its own
    bit_rate: Annotated[float, between(0.0, 1000.0), FileUnit("", 1e3), Key("bitrate_kbit_s")] = 0.0
    """bit/s; 0: every message has a slot of its own in the first three quarters of a cycle."""
    node_delay: Annotated[float, between(0.0, 500.0), US] = 0.0
    """After SYNC, times its number, at which a wheelset's node hands its frames over."""
    position_delay: Annotated[float, between(0.0, 3.9), MS] = 0.0  # after SYNC at which the position is handed over
    nodes_swapped: bool = False  # nodes 1 and 2, 3 and 4, ... are on each other's axles

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse delays of messages that have slots."""
        for key, delay in (("node_delay_us", self.node_delay), ("position_delay_ms", self.position_delay)):
            if self.bit_rate == 0.0 and delay > 0.0:
                raise field_error("needs a 'bitrate_kbit_s'", key)
        return self


@dataclass(frozen=True, slots=True)
class VehicleErrors:
    """How far vehicles are from the parameters of the scenario: 95 % limits, relative, of normal errors."""

    creep: Annotated[float, between(0.0, 50.0), PERCENT] = 0.20  # one factor for the fleet: the surface of the rails
    stiffness: Annotated[float, between(0.0, 50.0), PERCENT] = 0.10  # lateral and yaw springs, per vehicle
    mass: Annotated[float, between(0.0, 50.0), PERCENT] = 0.05
    """Wheelset with its inertias; suspended mass with the load; per vehicle."""
    seed: Annotated[int | None, Key(None)] = None
    """Of what is drawn per vehicle, where a fleet runs in several scenarios; None: as the rest."""
    fleet: Annotated[tuple[str, ...], Key(None)] = ()  # codes of all its vehicles then


@dataclass(frozen=True, slots=True)
class Scenario:
    """A simulated fleet, its track, its sensors, and its campaigns."""

    name: str
    description: str
    seed: int
    fleet_code: str
    fleet_name: str
    parameters: VehicleParameters
    section: SectionPlan
    sensors: SensorNode
    speed: SpeedRange
    sessions: Sessions
    bus: BusPlan
    position: PositionErrors
    vehicles: tuple[VehiclePlan, ...]
    drawn: DrawnFleet | None = None  # where ``vehicles`` follow from, with the seed
    vehicle_errors: VehicleErrors | None = None  # None: vehicles have ``parameters`` exactly
    bogie: BogieParameters | None = None  # None: single wheelsets
    class_on_file: ClassOnFile | None = None  # None: that of ``parameters``
    creep: CreepPlan = field(default_factory=CreepPlan)
    wheels: WheelsPlan = field(default_factory=WheelsPlan)
    traction: TractionPlan | None = None  # None: the speed is forced, and uses no creep

    @property
    def pair(self) -> str:
        """Wheel and rail of the fleet, for people."""
        if self.drawn is not None:
            return self.drawn.pairs[self.seed % len(self.drawn.pairs)].name
        first, rail = self.vehicles[0].wheelsets[0], self.section.rail_files[0]
        wheel = first.wheel_profile if first.wheel_files[0] is None else first.wheel_files[0].stem
        return f"{wheel}/{self.section.rail_profile if rail is None else rail.stem}"

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of the true track and of the profiles that recordings follow from, in a fixed order."""
        section = self.section
        wheels = {path for plan in self.vehicles for item in plan.wheelsets for path in item.wheel_files}
        return tuple(sorted(path for path in {section.file, *section.rail_files, *wheels} if path is not None))

    def vehicle(self, code: str) -> VehiclePlan:
        """Return a vehicle by its code."""
        for plan in self.vehicles:
            if plan.code == code:
                return plan
        known = ", ".join(plan.code for plan in self.vehicles)
        raise ScenarioError(f"no vehicle {code!r} in scenario {self.name!r}; there are {known}", field="vehicle")

    def duration(self, vehicle: VehiclePlan) -> float:
        """Return how long a run of ``vehicle`` is at most, s."""
        return min(self.sessions.duration, vehicle.longest_run)

    def odometer(self, campaign: int) -> float:
        """Return the vehicles' odometer, m, at the start of ``campaign`` (from 0)."""
        return self.sessions.first_odometer + campaign * self.sessions.distance_between

    def start_ns(self, vehicle: VehiclePlan, campaign: int) -> int:
        """Return the vehicle time at which ``campaign`` (from 0) starts: whole seconds, one vehicle after another."""
        days = campaign * self.sessions.distance_between / self.sessions.distance_per_day
        order = self.vehicles.index(vehicle)
        seconds = round(days * DAY_NS / SECOND_NS) + round(order * (self.sessions.duration + 60.0))
        return self.sessions.start_ns + seconds * SECOND_NS

    def at_odometer_ns(self, odometer: float) -> int:
        """Return the vehicle time, ns, at which the vehicles reach ``odometer``, m."""
        days = (odometer - self.sessions.first_odometer) / self.sessions.distance_per_day
        return self.sessions.start_ns + round(days * DAY_NS / SECOND_NS) * SECOND_NS


class Stream(IntEnum):
    """First word of the key of a stream; its number decides the recordings of a seed and stays."""

    TRACK = 0
    SPEED = 1  # by vehicle and campaign
    SENSOR = 2  # by vehicle, axle and campaign
    OFFSETS = 3  # of the sensors, by vehicle and axle
    BUS = 4  # by vehicle and campaign
    SURVEY = 5
    POSITION = 6  # by vehicle and campaign
    OTHER_SECTION = 7  # that a wrong survey belongs to
    WEAR = 20  # by wheelset
    CREEP = 21
    VEHICLE = 22  # errors of its parameters, by vehicle
    WHEEL = 23  # file of a measured one, by wheelset
    MEASURED_WHEELSET = 24  # of the bench, by wheelset
    CROSS_LEVEL = 60
    FRICTION = 61  # along the section; of the fleet by campaign
    LOAD = 62
    OUT_OF_ROUND = 63  # phases, by vehicle, axle and campaign
    DIAMETER = 64  # by wheelset
    WHEEL_FLAT = 70  # where on the tread, by vehicle, axle and campaign
    STAMPS = 40  # jitter of each, by vehicle and campaign
    NODE_ERRORS = 41  # scale, mounting and skew of the sensors, by vehicle and axle
    TEMPERATURE = 42  # drift of the sensors, by vehicle, axle and campaign
    ODOMETER = 43  # its scale, by vehicle


def seed_of(seed: int, stream: Stream, *key: int) -> np.random.SeedSequence:
    """Return the seed of one random stream: the same for the same seed of the scenario and key."""
    return np.random.SeedSequence(seed, spawn_key=(stream, *key))


def generator(seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """Return the generator of one random stream."""
    return np.random.default_rng(seed_of(seed, stream, *key))

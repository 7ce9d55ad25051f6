"""A scenario: what a simulated fleet is and does. Values only; ``scenario_file`` reads them from TOML."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from estimation.contact.wear import RailWear
from estimation.errors import ScenarioError
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, BogieParameters
from ingest.simulator.class_on_file import ClassOnFile
from ingest.simulator.running import RunningPlan
from ingest.simulator.sensors import SensorNode
from ingest.simulator.track import TrackRecipe

DAY_NS = 86_400_000_000_000
SECOND_NS = 1_000_000_000
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
    from_campaign: int


SideFiles = tuple[Path | None, Path | None]
"""Files of the left and of the right profile; None: the built-in one."""

SideMirrors = tuple[bool | None, bool | None]
"""Of left and right rail: whether the gauge side is at positive y of the file; None: the shape shows it."""


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
    reprofilings_registered: bool = True  # False: the lathe turned it, and nobody told the registry


@dataclass(frozen=True, slots=True)
class WeakDamper:
    """A lateral damper that has lost some of its damping from campaign ``from_campaign`` (counted from 1) on.

    It is the damper between frame and body of a bogie, or above a single wheelset.
    """

    share: float  # of its damping that is left
    from_campaign: int = 1
    running_gear: int | None = None  # counted from 1; None: every one of the vehicle


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
class SurveyPlan:
    """How the survey that is on file is wrong, beside its own errors, and what it states of these."""

    other_section: bool = False  # it is of another section: that in ``file``, else one drawn by the same recipe
    gauge_other_section: bool = False  # its gauge alone is of that other section
    file: Path | None = None
    shift: float = 0.0  # m, by which it is further on than the track
    alignment_factor: float = 1.0
    gauge_factor: float = 1.0
    gauge: bool = True  # False: no gauge was surveyed, the file has zeros
    stated_alignment_std: float | None = None  # m; None: that of its errors
    stated_gauge_std: float | None = None


@dataclass(frozen=True, slots=True)
class SectionPlan:
    """The track section that all campaigns run on: by recipe, or from a recorded file."""

    code: str
    number: int
    name: str
    rail_profile: str
    inclination: float
    nominal_gauge: float  # m
    recipe: TrackRecipe | None
    file: Path | None
    survey_alignment_std: float  # m: error of the alignment that is on file
    survey_gauge_std: float  # m
    surveyed: bool  # whether a survey is on file at all
    gauge_surveyed: bool  # whether the gauge is on file even without a survey
    latitude: float  # deg, of the section's start
    longitude: float
    survey: SurveyPlan = field(default_factory=SurveyPlan)
    rail_files: SideFiles = (None, None)
    rail_mirrors: SideMirrors = (None, None)
    file_inclination: float = 0.0  # tangent, given to rails of which one or both are from files
    rail_wear: tuple[RailWear | None, RailWear | None] = (None, None)  # of left and right rail; not on file
    rail_growth: float = 0.0  # m of depth by 100 million gross tonnes, from the first campaign on; not on file
    tonnage: float | None = None  # million gross tonnes a year, on file

    @property
    def stated_alignment_std(self) -> float:
        """Standard deviation of the alignment that is on file, as the registry states it, m."""
        stated = self.survey.stated_alignment_std
        return self.survey_alignment_std if stated is None else stated

    @property
    def stated_gauge_std(self) -> float:
        """The same of the gauge deviation, m."""
        stated = self.survey.stated_gauge_std
        return self.survey_gauge_std if stated is None else stated


@dataclass(frozen=True, slots=True)
class SpeedRange:
    """Speed wanders smoothly between two values, m/s."""

    lowest: float
    highest: float
    period: float  # s, of the slowest wave
    steady: bool = False  # every run has a mean of its own and swings a little about it
    stop_every: float = 0.0  # s between the middles of two stops; 0 for none
    stop: float = 30.0  # s of standing
    braking: float = 0.5  # m/s2, before and after a stop


@dataclass(frozen=True, slots=True)
class Sessions:
    """When and how long the fleet is recorded: campaigns, between which the odometer jumps."""

    start_ns: int  # vehicle clock, of the first campaign
    campaigns: int
    duration: float  # s each
    distance_between: float  # m
    first_odometer: float  # m
    distance_per_day: float  # m
    start_within: float  # m, of the begin of the section: where runs begin; inf for all of it
    push_pull: bool = False  # every second campaign is run with the rear end first
    whole_section: bool = False  # runs begin before the section and end behind it; ``duration`` is the longest


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """How far the positions that a vehicle reports are off, one draw per run: uniform errors plus normal ones."""

    offset: float  # m, at most
    scale: float  # share of the distance run, at most
    offset_std: float = 0.0  # m; drawn within three of them
    scale_std: float = 0.0
    fixed_offset: float = 0.0  # m, forwards or backwards
    odometer_scale_std: float = 0.0  # of odometer and speed, one draw per vehicle
    frozen_every: float = 1000.0  # m along the section between the begins of tunnels
    frozen_length: float = 0.0  # m of each, in which the last position is repeated

    @property
    def largest_offset(self) -> float:
        """The largest offset that may be drawn, m."""
        return self.offset + NORMAL_REACH * self.offset_std + self.fixed_offset


@dataclass(frozen=True, slots=True)
class BusPlan:
    """How far the bus is from perfect."""

    lost_share: float  # of all frames
    burst_per_hour: float  # gaps in everything, per hour
    burst: float  # s each
    jitter: float  # s, standard deviation of a frame's time stamp
    recorder_offset: float  # s, recorder's clock minus vehicle clock
    stamp_jitter: float = 0.0  # s, standard deviation of each stamp on its own
    bit_rate: float = 0.0  # bit/s; 0: every message has a slot of its own in the first three quarters of a cycle
    node_delay: float = 0.0  # s after SYNC, times its number, at which a wheelset's node hands its frames over
    position_delay: float = 0.0  # s after SYNC at which the position is handed over
    nodes_swapped: bool = False  # nodes 1 and 2, 3 and 4, ... are on each other's axles


@dataclass(frozen=True, slots=True)
class ProfilePair:
    """Wheel and rail of a drawn fleet, and how far its wheels are worn at most."""

    name: str
    wheel_profile: str
    rail_profile: str
    inclination: float  # tangent
    deepest_wear: float  # m
    wheel_files: tuple[SideFiles, ...] = ()  # measured wheels that the wheelsets have; empty: the built-in one
    wheels_drawn: bool = False  # which wheelset has which is drawn; False: in turn
    rail_files: SideFiles = (None, None)
    rail_mirrors: SideMirrors = (None, None)
    file_inclination: float = 0.0


class WearDistribution(StrEnum):
    """How the wear of a drawn fleet is spread over its wheelsets."""

    STEPS = "steps"  # from almost nothing to the deepest, in equal steps: as different as can be
    UNIFORM = "uniform"
    NORMAL = "normal"
    LOGNORMAL = "lognormal"


@dataclass(frozen=True, slots=True)
class FleetWear:
    """Wear of the wheelsets of a drawn fleet; m. Draws outside the limits are repeated."""

    distribution: WearDistribution = WearDistribution.STEPS
    mean: float = 0.0  # of normal and lognormal before the limits
    std: float = 0.0
    lowest: float = 0.0
    highest: float | None = None  # None: the deepest of the pair
    asymmetry: float = 0.08  # std of the share by which the left wheel's wear is above the mean of both


@dataclass(frozen=True, slots=True)
class DrawnFleet:
    """A fleet whose wheelsets are drawn."""

    pairs: tuple[ProfilePair, ...]  # taken in turn by seed
    vehicles: int
    wheelsets: int  # of each vehicle
    wear_alike: bool  # all wheelsets have half of the deepest wear, the same on both sides
    profiles_measured: int  # the first of the fleet, with their profiles on file
    vehicle_class: str
    max_speed: float  # m/s
    wear: FleetWear = field(default_factory=FleetWear)
    radius_std: float = 0.0  # m, of the nominal rolling radii of the wheelsets
    diameter_difference_std: float = 0.0  # m, of left minus right
    total: int | None = None  # wheelsets of the fleet, where the last ones to be filled stay free; None: all places

    @property
    def places(self) -> int:
        """How many wheelsets the fleet has."""
        return self.vehicles * self.wheelsets if self.total is None else self.total


@dataclass(frozen=True, slots=True)
class VehicleErrors:
    """How far vehicles are from the parameters of the scenario: 95 % limits, relative, of normal errors."""

    creep: float = 0.20  # one factor for the fleet: the state of the rails' surface
    stiffness: float = 0.10  # lateral and yaw springs, per vehicle
    mass: float = 0.05  # wheelset with its inertias; suspended mass with the load; per vehicle
    seed: int | None = None  # of what is drawn per vehicle, where a fleet runs in several scenarios; None: as the rest
    fleet: tuple[str, ...] = ()  # codes of all its vehicles then


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
    running: RunningPlan = field(default_factory=RunningPlan)

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
        """Return a vehicle by its code.

        Raises:
            ScenarioError: There is none.
        """
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

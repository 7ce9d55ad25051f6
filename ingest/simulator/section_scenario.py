"""A section scenario: what a fleet runs over, what is known of it, and with which errors. Values only."""

from __future__ import annotations

from dataclasses import dataclass

from ingest.simulator.sensors import SensorNode


@dataclass(frozen=True, slots=True)
class ProfilePair:
    """Wheel and rail of a fleet, and how far its wheels are worn at most."""

    name: str
    wheel: str
    rail: str
    inclination: float  # tangent
    deepest_wear: float  # m


@dataclass(frozen=True, slots=True)
class VehicleErrors:
    """How far vehicles are from the parameters that an estimator assumes: 95 % limits, relative, of normal errors."""

    creep: float  # one factor for the section: the state of the rails' surface
    stiffness: float  # lateral and yaw springs, per vehicle
    mass: float  # wheelset with its inertias; suspended mass with the load; per vehicle


@dataclass(frozen=True, slots=True)
class SectionScenario:
    """A fleet on one section; lengths in m, speeds in m/s.

    ``alignment_known``, ``gauge_known``, ``wheelsets_measured`` and the position errors say what is handed to an
    estimator; everything else shapes the simulation.
    """

    name: str
    description: str
    pairs: tuple[ProfilePair, ...]  # taken in turn by seed
    vehicles: int
    wheelsets: int  # per vehicle
    passes: int  # of every vehicle
    wear_alike: bool  # all wheelsets have the same, symmetrical wear
    length: float
    alignment_std: float
    gauge_std: float
    lowest_speed: float
    highest_speed: float
    speed_alike: bool  # every journey has the same constant speed
    sensors: SensorNode
    alignment_known: bool
    gauge_known: bool
    wheelsets_measured: int  # the first of the fleet, with an error
    position_offset: float  # largest, uniform, per journey
    position_scale: float  # largest, uniform, relative, per journey
    vehicle_errors: VehicleErrors
    errors_drawn: bool  # False: the simulated vehicles have the assumed parameters exactly

    def pair(self, seed: int) -> ProfilePair:
        """Return the pair that runs with this seed."""
        return self.pairs[seed % len(self.pairs)]

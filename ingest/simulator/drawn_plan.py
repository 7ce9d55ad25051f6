"""A fleet whose wheelsets are drawn: wheels and rails by seed, wear by distribution."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Self

from annotated_types import Interval, MinLen

from estimation.values.fields import KM_H, MM, PERCENT, Key
from estimation.values.registry import MAX_AXLES
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE
from ingest.file_value import As, FileBeside, between
from ingest.input_file import Text, field_error
from ingest.simulator.section import Inclination, RailFiles, RailName, SideFiles, WheelName

MAX_VEHICLES = 64
Wear = Annotated[float, between(0.0, 5.0), MM]


@dataclass(frozen=True, slots=True)
class _WheelFiles:
    left: FileBeside
    right: FileBeside | None = None

    def plan(self) -> SideFiles:
        return self.left, self.right or self.left


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfilePair(RailFiles):
    """Wheel and rail of a drawn fleet, and how far its wheels are worn at most."""

    name: Text
    wheel_profile: WheelName
    rail_profile: RailName
    inclination: Annotated[Inclination, Key("rail_inclination_1_in")] = 1.0 / 20.0  # tangent
    deepest_wear: Wear = 0.0
    wheel_files: tuple[Annotated[SideFiles, As(_WheelFiles)], ...] = ()
    """Measured wheels that the wheelsets have; empty: the built-in one."""
    wheels_drawn: bool = False  # which wheelset has which is drawn; False: in turn

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse wheels of which neither wear nor files are given."""
        self.check_rails()
        if "deepest_wear_mm" not in given and not self.wheel_files:
            raise field_error("is missing", "deepest_wear_mm")
        if self.wheels_drawn and not self.wheel_files:
            raise field_error("needs 'wheel_files'", "wheels_drawn")
        return self


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
    mean: Annotated[float, Interval(gt=0.0, le=5.0), MM] = 0.0  # of normal and lognormal before the limits
    std: Wear = 0.0
    lowest: Wear = 0.0
    highest: Wear | None = None  # None: the deepest of the pair
    asymmetry: Annotated[float, between(0.0, 50.0), PERCENT] = 0.08
    """Std of the share by which the left wheel's wear is above the mean of both."""

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse keys that the distribution does not have."""
        by_mean = self.distribution in {WearDistribution.NORMAL, WearDistribution.LOGNORMAL}
        for key in ("mean_mm", "std_mm"):
            if by_mean and key not in given:
                raise field_error(f"is missing; a {self.distribution} distribution needs it", key)
            if not by_mean and key in given:
                raise field_error(f"unknown key of a distribution in {self.distribution}", key)
        if self.distribution == WearDistribution.STEPS and "lowest_mm" in given:
            raise field_error("unknown key of a distribution in steps", "lowest_mm")
        return self

    def check(self, deepest: float) -> None:
        """Refuse limits that leave no room for the mean."""
        highest = deepest if self.highest is None else self.highest
        lowest_mm, highest_mm, mean_mm = 1e3 * self.lowest, 1e3 * highest, 1e3 * self.mean
        if highest < self.lowest:
            reason = f"{lowest_mm:g} mm is above the deepest wear, {highest_mm:g} mm"
            raise field_error(reason, "wear", "lowest_mm")
        if self.mean and not self.lowest <= self.mean <= highest:
            reason = f"{mean_mm:g} mm is not between the limits, {lowest_mm:g} and {highest_mm:g} mm"
            raise field_error(reason, "wear", "mean_mm")


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnFleet:
    """A fleet whose wheelsets are drawn."""

    given_vehicles: Annotated[int, between(1, MAX_VEHICLES), Key("vehicles")] = 4
    wheelsets: Annotated[int, between(1, MAX_AXLES), Key("wheelsets_each")] = 4  # of each vehicle
    total: Annotated[int, between(1, MAX_VEHICLES * MAX_AXLES), Key("wheelsets")] | None = None
    """Wheelsets of the fleet, where the last ones to be filled stay free; None: all places."""
    wear_alike: bool = False  # all wheelsets have half of the deepest wear, the same on both sides
    wear: FleetWear = field(default_factory=FleetWear)
    profiles_measured: Annotated[int, between(0, 512)] = 0  # the first of the fleet, with their profiles on file
    vehicle_class: Annotated[Text, Key("class")] = "multiple unit"
    max_speed: Annotated[float, Interval(gt=0.0, le=400.0), KM_H] = 1.0 / 3.6 * 120.0  # m/s
    radius_std: Annotated[float, between(0.0, 20.0), MM] = 0.0  # of the nominal rolling radii of the wheelsets
    diameter_difference_std: Annotated[float, between(0.0, 2.0), MM] = 0.0  # of left minus right
    pairs: Annotated[tuple[ProfilePair, ...], MinLen(1)]  # taken in turn by seed

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse two counts of vehicles, and wear that is alike and is not."""
        if self.total is not None and "vehicles" in given:
            raise field_error("cannot be given beside 'wheelsets'", "vehicles")
        if self.vehicles > MAX_VEHICLES:
            raise field_error(f"{self.total} wheelsets are more than {MAX_VEHICLES} vehicles have", "wheelsets")
        if self.wear_alike and "wear" in given:
            raise field_error("cannot be given beside wear_alike = true", "wear")
        for pair in self.pairs:
            self.wear.check(pair.deepest_wear)
        return self

    @property
    def vehicles(self) -> int:
        """How many vehicles the fleet has."""
        return self.given_vehicles if self.total is None else math.ceil(self.total / self.wheelsets)

    @property
    def places(self) -> int:
        """How many wheelsets the fleet has."""
        return self.vehicles * self.wheelsets if self.total is None else self.total

    def axles_without_bogie(self) -> int:
        """Return how many wheelsets a vehicle has where that is an odd number; 0 where there is none."""
        counts = [len(range(number, self.places, self.vehicles)) for number in range(self.vehicles)]
        return next((count for count in counts if count % AXLES_OF_A_BOGIE), 0)

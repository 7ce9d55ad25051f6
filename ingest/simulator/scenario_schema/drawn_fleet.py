"""A fleet whose wheelsets are drawn: wheels and rails by seed, wear by distribution."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE
from ingest.input_file import InputTable, Text, field_error
from ingest.simulator.scenario import DrawnFleet, FleetWear, ProfilePair, WearDistribution
from ingest.simulator.scenario_schema.profile_names import RailName, WheelName
from ingest.simulator.scenario_schema.rails import RailFiles
from ingest.simulator.scenario_schema.units import KM_PER_HOUR, MM

MAX_AXLES = 8
MAX_VEHICLES = 64


class WheelFilesTable(InputTable):
    """An entry of ``wheel_files``."""

    left: Text
    right: Text | None = None


class PairTable(RailFiles):
    """``[[drawn_fleet.pairs]]``."""

    name: Text
    wheel_profile: WheelName
    rail_profile: RailName
    rail_inclination_1_in: float = Field(default=20.0, ge=5.0)
    deepest_wear_mm: float | None = Field(default=None, ge=0.0, le=5.0)
    wheel_files: list[WheelFilesTable] = Field(default_factory=list)
    wheels_drawn: bool = False

    @model_validator(mode="after")
    def _check_wear(self) -> Self:
        if self.deepest_wear_mm is None and not self.wheel_files:
            raise field_error("is missing", "deepest_wear_mm")
        if self.wheels_drawn and not self.wheel_files:
            raise field_error("needs 'wheel_files'", "wheels_drawn")
        return self

    def plan(self, folder: Path) -> ProfilePair:
        """Return the pair in SI units.

        Args:
            folder: Folder of the scenario file: relative file names start here.
        """
        return ProfilePair(
            name=self.name,
            wheel_profile=self.wheel_profile,
            rail_profile=self.rail_profile,
            inclination=1.0 / self.rail_inclination_1_in,
            deepest_wear=MM * (self.deepest_wear_mm or 0.0),
            wheel_files=tuple((folder / item.left, folder / (item.right or item.left)) for item in self.wheel_files),
            wheels_drawn=self.wheels_drawn,
            rail_files=self.files(folder),
            rail_mirrors=self.mirrors,
            file_inclination=self.inclination_of_files(self.rail_inclination_1_in),
        )


class WearTable(InputTable):
    """``[drawn_fleet.wear]``."""

    distribution: Text = "steps"
    mean_mm: float | None = Field(default=None, gt=0.0, le=5.0)
    std_mm: float | None = Field(default=None, ge=0.0, le=5.0)
    lowest_mm: float = Field(default=0.0, ge=0.0, le=5.0)
    highest_mm: float | None = Field(default=None, ge=0.0, le=5.0)
    asymmetry_percent: float = Field(default=8.0, ge=0.0, le=50.0)

    @model_validator(mode="after")
    def _check_distribution(self) -> Self:
        known = tuple(WearDistribution)
        if self.distribution not in known:
            raise field_error(f"{self.distribution!r} is none of {', '.join(known)}", "distribution")
        by_mean = self.distribution in (WearDistribution.NORMAL, WearDistribution.LOGNORMAL)
        for key in ("mean_mm", "std_mm"):
            if by_mean and key not in self.model_fields_set:
                raise field_error(f"is missing; a {self.distribution} distribution needs it", key)
            if not by_mean and key in self.model_fields_set:
                raise field_error(f"unknown key of a distribution in {self.distribution}", key)
        if self.distribution == WearDistribution.STEPS and "lowest_mm" in self.model_fields_set:
            raise field_error("unknown key of a distribution in steps", "lowest_mm")
        return self

    def check(self, deepest_mm: float) -> None:
        """Refuse limits that leave no room for the mean.

        Args:
            deepest_mm: Of the pair: the upper limit where the table has none.

        Raises:
            PydanticCustomError: With the location inside this table.
        """
        highest = deepest_mm if self.highest_mm is None else self.highest_mm
        if highest < self.lowest_mm:
            raise field_error(f"{self.lowest_mm:g} mm is above the deepest wear, {highest:g} mm", "wear", "lowest_mm")
        if self.mean_mm is not None and not self.lowest_mm <= self.mean_mm <= highest:
            reason = f"{self.mean_mm:g} mm is not between the limits, {self.lowest_mm:g} and {highest:g} mm"
            raise field_error(reason, "wear", "mean_mm")

    def plan(self) -> FleetWear:
        """Return the wear in SI units."""
        return FleetWear(
            distribution=WearDistribution(self.distribution),
            mean=MM * (self.mean_mm or 0.0),
            std=MM * (self.std_mm or 0.0),
            lowest=MM * self.lowest_mm,
            highest=None if self.highest_mm is None else MM * self.highest_mm,
            asymmetry=self.asymmetry_percent / 100.0,
        )


class DrawnFleetTable(InputTable):
    """``[drawn_fleet]``: stands in for ``[[vehicles]]``."""

    vehicles: int = Field(default=4, ge=1, le=MAX_VEHICLES)
    wheelsets_each: int = Field(default=4, ge=1, le=MAX_AXLES)
    wheelsets: int | None = Field(default=None, ge=1, le=MAX_VEHICLES * MAX_AXLES)
    wear_alike: bool = False
    wear: WearTable = Field(default_factory=WearTable)
    profiles_measured: int = Field(default=0, ge=0, le=512)
    vehicle_class: Text = Field(default="multiple unit", alias="class")
    max_speed_km_h: float = Field(default=120.0, gt=0.0, le=400.0)
    radius_std_mm: float = Field(default=0.0, ge=0.0, le=20.0)
    diameter_difference_std_mm: float = Field(default=0.0, ge=0.0, le=2.0)
    pairs: list[PairTable] = Field(min_length=1)

    @model_validator(mode="after")
    def _check_count(self) -> Self:
        if self.wheelsets is not None and "vehicles" in self.model_fields_set:
            raise field_error("cannot be given beside 'wheelsets'", "vehicles")
        if self._vehicles() > MAX_VEHICLES:
            reason = f"{self.wheelsets} wheelsets are more than {MAX_VEHICLES} vehicles have"
            raise field_error(reason, "wheelsets")
        return self

    @model_validator(mode="after")
    def _check_wear(self) -> Self:
        if self.wear_alike and "wear" in self.model_fields_set:
            raise field_error("cannot be given beside wear_alike = true", "wear")
        for pair in self.pairs:
            self.wear.check(pair.deepest_wear_mm or 0.0)
        return self

    def _vehicles(self) -> int:
        return self.vehicles if self.wheelsets is None else math.ceil(self.wheelsets / self.wheelsets_each)

    def serials(self) -> tuple[str, ...]:
        """Return the serials of the wheelsets."""
        places = self.vehicles * self.wheelsets_each if self.wheelsets is None else self.wheelsets
        return tuple(f"W{rank:02d}" for rank in range(places))

    def axles_without_bogie(self) -> int:
        """Return how many wheelsets a vehicle has where that is an odd number; 0 where there is none."""
        vehicles = self._vehicles()
        places = vehicles * self.wheelsets_each if self.wheelsets is None else self.wheelsets
        counts = [len(range(number, places, vehicles)) for number in range(vehicles)]
        return next((count for count in counts if count % AXLES_OF_A_BOGIE), 0)

    def plan(self, folder: Path) -> DrawnFleet:
        """Return the fleet in SI units.

        Args:
            folder: Folder of the scenario file: relative file names start here.
        """
        return DrawnFleet(
            pairs=tuple(pair.plan(folder) for pair in self.pairs),
            vehicles=self._vehicles(),
            wheelsets=self.wheelsets_each,
            wear_alike=self.wear_alike,
            profiles_measured=self.profiles_measured,
            vehicle_class=self.vehicle_class,
            max_speed=KM_PER_HOUR * self.max_speed_km_h,
            wear=self.wear.plan(),
            total=self.wheelsets,
            radius_std=MM * self.radius_std_mm,
            diameter_difference_std=MM * self.diameter_difference_std_mm,
        )

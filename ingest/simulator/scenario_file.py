"""Scenario files: TOML in, a frozen ``Scenario`` out.

``docs/scenarios.md`` and the pages that it names describe every key.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Self

from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile
from estimation.errors import ProfileError, ScenarioError
from estimation.values.fields import MM
from ingest.file_value import As, FileBeside, between, read_value, taken
from ingest.input_file import Location, Text, field_error, read_toml
from ingest.simulator.axle_motion import rail_in, wheel_in
from ingest.simulator.campaign import MARGIN
from ingest.simulator.drawn_fleet import DynamicsTable, VehicleTable, drawn_serial, impossible_bogies, with_seed
from ingest.simulator.drawn_plan import DrawnFleet
from ingest.simulator.running import CreepPlan, TractionPlan, WheelsPlan
from ingest.simulator.scenario import (
    BusPlan,
    ClassOnFile,
    PositionErrors,
    Scenario,
    Sessions,
    SpeedRange,
    VehicleErrors,
)
from ingest.simulator.section import RailFiles, SectionPlan
from ingest.simulator.sensors import SensorNode, SensorsTable
from ingest.vehicle_class_schema import read_vehicle_class, shipped_classes, shipped_path


@dataclass(frozen=True, slots=True)
class ClassOnFileTable:
    """``[class_on_file]``."""

    file: FileBeside | None = None
    shipped: Text | None = None
    nominal_radius: Annotated[float, between(150.0, 700.0), MM] | None = None

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse none, two, and a class that the package does not ship."""
        if (self.file is None) == (self.shipped is None):
            raise field_error("needs either 'file' or 'shipped'")
        if self.shipped is not None and self.shipped not in shipped_classes():
            raise field_error(f"{self.shipped!r} is none of {', '.join(shipped_classes())}", "shipped")
        return self

    def plan(self) -> ClassOnFile:
        """Return what is on file."""
        path = shipped_path(self.shipped) if self.file is None and self.shipped is not None else self.file
        assert path is not None
        return ClassOnFile(path, read_vehicle_class(path, ScenarioError), self.nominal_radius)


MAX_SEED = 2**53


@dataclass(frozen=True, slots=True)
class FleetTable:
    """``[fleet]``."""

    code: Text
    name: Text


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioTable:
    """The whole file."""

    name: Text
    description: Text
    seed: Annotated[int, between(0, MAX_SEED)]
    fleet: FleetTable
    dynamics: DynamicsTable = field(default_factory=DynamicsTable)
    section: SectionPlan
    speed: SpeedRange
    sensors: Annotated[SensorNode, As(SensorsTable)] = field(default_factory=lambda: SensorsTable().plan())
    position: PositionErrors = field(default_factory=PositionErrors)
    bus: BusPlan = field(default_factory=BusPlan)
    sessions: Sessions
    vehicles: tuple[VehicleTable, ...] = ()
    drawn_fleet: DrawnFleet | None = None
    vehicle_errors: VehicleErrors | None = None
    class_on_file: ClassOnFileTable | None = None
    creep: CreepPlan = field(default_factory=CreepPlan)
    wheels: WheelsPlan = field(default_factory=WheelsPlan)
    traction: TractionPlan | None = None

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse what tables contradict each other in."""
        if self.drawn_fleet is None and not self.vehicles:
            raise field_error("must have at least 1 entries" if "vehicles" in given else "is missing", "vehicles")
        if self.drawn_fleet is not None and "vehicles" in given:
            raise field_error("cannot be given beside 'drawn_fleet'", "vehicles")
        self._check_unique()
        for index, vehicle in enumerate(self.vehicles):
            for k, wheelset in enumerate(vehicle.wheelsets):
                if wheelset.fault is not None:
                    self._check_campaign(wheelset.fault.from_campaign, "vehicles", index, "wheelsets", k, "fault")
        for index, vehicle in enumerate(self.vehicles):
            if math.isfinite(vehicle.longest_run) and self.sessions.whole_section:
                reason = "runs over the whole section are not shorter for one vehicle"
                raise field_error(reason, "vehicles", index, "minutes_each")
        self._check_running()
        self._check_bogies()
        drawn = self.drawn_fleet
        fewest = min(len(vehicle.wheelsets) for vehicle in self.vehicles) if drawn is None else drawn.wheelsets
        for axle in () if self.traction is None else self.traction.driven_axles:
            if axle > fewest:
                raise field_error(f"there is no axle {axle} in every vehicle", "traction", "driven_axles")
        self._check_length()
        self._check_growth_of_rail_wear()
        return self

    @property
    def length(self) -> float | None:
        """Length of the section, m; None of a recorded one."""
        return None if self.section.recipe is None else self.section.recipe.length

    def _check_unique(self) -> None:
        codes = Counter(vehicle.code for vehicle in self.vehicles)
        serials = Counter(wheelset.serial for vehicle in self.vehicles for wheelset in vehicle.wheelsets)
        for what, names in (("vehicle code", codes), ("wheelset serial", serials)):
            for name, count in names.items():
                if count > 1:
                    raise field_error(f"{what} {name!r} occurs twice", "vehicles")

    def _check_campaign(self, campaign: int, *place: str | int) -> None:
        if campaign > self.sessions.campaigns:
            reason = f"{campaign} is outside the range: at most {self.sessions.campaigns}"
            raise field_error(reason, *place, "from_campaign")

    def _check_running(self) -> None:
        for i, stretch in enumerate(self.creep.stretches):
            if self.length is not None and stretch.end > self.length:
                reason = f"{stretch.end:g} is outside the range: at most {self.length:g}, the length of the section"
                raise field_error(reason, "creep", "stretches", i, "to_m")
            self._check_campaign(stretch.from_campaign, "creep", "stretches", i)
        serials = {wheelset.serial for vehicle in self.vehicles for wheelset in vehicle.wheelsets}
        if self.drawn_fleet is not None:
            serials = {drawn_serial(rank) for rank in range(self.drawn_fleet.places)}
        for i, flat in enumerate(self.wheels.flats):
            if flat.wheelset not in serials:
                raise field_error(f"there is no wheelset {flat.wheelset!r}", "wheels", "flats", i, "wheelset")
            self._check_campaign(flat.from_campaign, "wheels", "flats", i)

    def _check_bogies(self) -> None:
        bogie = self.dynamics.bogie
        if bogie is None:
            return
        if self.drawn_fleet is not None and (uneven := self.drawn_fleet.axles_without_bogie()):
            raise field_error(f"a vehicle has {uneven} wheelsets, bogies have two each", "drawn_fleet", "wheelsets")
        for index, vehicle in enumerate(self.vehicles):
            reason = impossible_bogies(vehicle.offsets(bogie), bogie.wheelbase)
            if reason is not None:
                raise field_error(reason, "vehicles", index, "axle_offsets_m")

    def _check_length(self) -> None:
        length, duration = self.length, self.sessions.duration
        if self.sessions.whole_section and length is None:
            raise field_error("needs a section with 'length_m'", "sessions", "whole_section")
        if length is None or math.isinf(duration) or self.drawn_fleet is not None:
            return
        rear = max(vehicle.offsets(self.dynamics.bogie)[-1] for vehicle in self.vehicles)
        needed = self.speed.highest * duration + rear
        if length < needed:
            reason = f"a campaign may need {needed:.0f} m of track, the section has {length:.0f} m"
            raise field_error(reason, "section", "length_m")

    def _check_growth_of_rail_wear(self) -> None:
        wear, place = self.section.rail_wear, ("section", "rail_wear", "growth_mm_per_100_mgt")
        if wear is None or wear.growth == 0.0:
            return
        if self.section.tonnage is None:
            raise field_error("needs 'section.tonnage_mgt_per_year'", *place)
        if self.drawn_fleet is not None:
            raise field_error("the rails under a drawn fleet do not wear", *place)
        days = (self.sessions.campaigns - 1) * self.sessions.distance_between / self.sessions.distance_per_day
        deepest = max(wear.after(self.section.tonnage, days).depths)
        if deepest > PROFILES.deepest_band:
            most = 1e3 * PROFILES.deepest_band
            reason = f"the last campaign is on bands {1e3 * deepest:.1f} mm deep; at most {most:g} mm"
            raise field_error(reason, *place)

    def scenario(self) -> Scenario:
        """Return the scenario."""
        parameters, bogie, sessions = self.dynamics.parameters, self.dynamics.bogie, self.sessions
        if math.isinf(sessions.duration):
            sessions = replace(sessions, duration=((self.length or 0.0) + 2.0 * MARGIN) / self.speed.lowest)
        scenario = taken(
            Scenario,
            self,
            fleet_code=self.fleet.code,
            fleet_name=self.fleet.name,
            parameters=parameters,
            sessions=sessions,
            vehicles=tuple(vehicle.plan(parameters.nominal_radius, bogie) for vehicle in self.vehicles),
            drawn=self.drawn_fleet,
            bogie=bogie,
            class_on_file=None if self.class_on_file is None else self.class_on_file.plan(),
        )
        return with_seed(scenario, self.seed)


def builtin_scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that come with the package."""
    folder = files("ingest.simulator") / "scenarios"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario."""
    if str(name_or_path) in builtin_scenarios():
        with as_file(files("ingest.simulator") / "scenarios" / f"{name_or_path}.toml") as path:
            return read_scenario(path)
    path = Path(name_or_path)
    if not path.exists():
        raise ScenarioError(
            f"no such file, and no built-in scenario of that name ({', '.join(builtin_scenarios())})", file=path
        )
    return read_scenario(path)


def read_scenario(path: Path) -> Scenario:
    """Read a scenario file."""
    file = read_toml(path, ScenarioError)
    table = read_value(file, ScenarioTable)
    for location, read in (*_rail_reads(table), *_wheel_reads(table)):
        try:
            read()
        except ProfileError as error:
            raise file.error(str(error), location) from error
    return table.scenario()


_Read = tuple[Location, Callable[[], Profile]]


def _rail_reads(table: ScenarioTable) -> Iterator[_Read]:
    tables: list[tuple[Location, RailFiles]] = [(("section",), table.section)]
    for index, pair in enumerate(() if table.drawn_fleet is None else table.drawn_fleet.pairs):
        tables.append((("drawn_fleet", "pairs", index), pair))
    for place, rails in tables:
        for key in ("rail_file", "rail_left_file", "rail_right_file"):
            if (path := getattr(rails, key)) is not None:
                yield (*place, key), partial(rail_in, path, getattr(rails, f"{key}_mirror"))


def _wheel_reads(table: ScenarioTable) -> Iterator[_Read]:
    for i, vehicle in enumerate(table.vehicles):
        for k, wheelset in enumerate(vehicle.wheelsets):
            for key in ("wheel_file", "wheel_left_file", "wheel_right_file"):
                if (path := getattr(wheelset, key)) is not None:
                    yield ("vehicles", i, "wheelsets", k, key), partial(wheel_in, path)
    for index, pair in enumerate(() if table.drawn_fleet is None else table.drawn_fleet.pairs):
        for k, sides in enumerate(pair.wheel_files):
            for side, wheel in zip(("left", "right"), sides, strict=True):
                if wheel is not None:
                    yield ("drawn_fleet", "pairs", index, "wheel_files", k, side), partial(wheel_in, wheel)

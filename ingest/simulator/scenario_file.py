"""Scenario files: TOML in, a frozen ``Scenario`` out.

``docs/scenarios.md`` and the pages that it names describe every key.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from estimation.contact.profiles import Profile
from estimation.contact.wear import DEEPEST_BAND
from estimation.errors import ProfileError, ScenarioError
from ingest.input_file import InputFile, InputTable, Location, Text, field_error, read_toml
from ingest.simulator.campaign import MARGIN
from ingest.simulator.class_on_file import ClassOnFile
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.profile_files import rail_in, wheel_in
from ingest.simulator.rail_course import DAYS_PER_YEAR
from ingest.simulator.running import RunningPlan
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_schema.drawn_fleet import DrawnFleetTable
from ingest.simulator.scenario_schema.dynamics import DynamicsTable, VehicleErrorsTable, impossible_bogies
from ingest.simulator.scenario_schema.fleet import FleetTable, VehicleTable
from ingest.simulator.scenario_schema.measurement import BusTable, PositionTable, SensorsTable
from ingest.simulator.scenario_schema.rails import RailFiles
from ingest.simulator.scenario_schema.running import SessionsTable, SpeedTable
from ingest.simulator.scenario_schema.running_plan import CreepTable, TractionTable, WheelsTable
from ingest.simulator.scenario_schema.track import SectionTable
from ingest.simulator.scenario_schema.units import MM
from ingest.vehicle_class_file import read_vehicle_class, shipped_classes, shipped_path


class ClassOnFileTable(InputTable):
    """``[class_on_file]``."""

    file: Text | None = None
    shipped: Text | None = None
    nominal_radius_mm: Annotated[float, Field(ge=150.0, le=700.0)] | None = None

    @model_validator(mode="after")
    def _check_file(self) -> Self:
        if (self.file is None) == (self.shipped is None):
            raise field_error("needs either 'file' or 'shipped'")
        if self.shipped is not None and self.shipped not in shipped_classes():
            raise field_error(f"{self.shipped!r} is none of {', '.join(shipped_classes())}", "shipped")
        return self

    def plan(self, folder: Path) -> ClassOnFile:
        """Return what is on file.

        Args:
            folder: Folder of the scenario file: a relative file name starts here.

        Raises:
            ScenarioError: The file is no class file.
        """
        path = shipped_path(self.shipped) if self.shipped is not None else folder / str(self.file)
        radius = None if self.nominal_radius_mm is None else MM * self.nominal_radius_mm
        return ClassOnFile(path, read_vehicle_class(path, ScenarioError), radius)


MAX_SEED = 2**53


class ScenarioTable(InputTable):
    """The whole file."""

    name: Text
    description: Text
    seed: int = Field(ge=0, le=MAX_SEED)
    fleet: FleetTable
    dynamics: DynamicsTable = Field(default_factory=DynamicsTable)
    section: SectionTable
    speed: SpeedTable
    sensors: SensorsTable = Field(default_factory=SensorsTable)
    position: PositionTable = Field(default_factory=PositionTable)
    bus: BusTable = Field(default_factory=BusTable)
    sessions: SessionsTable
    vehicles: list[VehicleTable] = Field(default_factory=list)
    drawn_fleet: DrawnFleetTable | None = None
    vehicle_errors: VehicleErrorsTable | None = None
    class_on_file: ClassOnFileTable | None = None
    creep: CreepTable = Field(default_factory=CreepTable)
    wheels: WheelsTable = Field(default_factory=WheelsTable)
    traction: TractionTable | None = None

    @model_validator(mode="after")
    def _check_fleet(self) -> Self:
        listed = "vehicles" in self.model_fields_set
        if self.drawn_fleet is None and not self.vehicles:
            raise field_error("must have at least 1 entries" if listed else "is missing", "vehicles")
        if self.drawn_fleet is not None and listed:
            raise field_error("cannot be given beside 'drawn_fleet'", "vehicles")
        return self

    @model_validator(mode="after")
    def _check_unique(self) -> Self:
        codes = Counter(vehicle.code for vehicle in self.vehicles)
        serials = Counter(wheelset.serial for vehicle in self.vehicles for wheelset in vehicle.wheelsets)
        for what, names in (("vehicle code", codes), ("wheelset serial", serials)):
            for name, count in names.items():
                if count > 1:
                    raise field_error(f"{what} {name!r} occurs twice", "vehicles")
        return self

    @model_validator(mode="after")
    def _check_faults(self) -> Self:
        last = self.sessions.campaigns
        for i, vehicle in enumerate(self.vehicles):
            for k, wheelset in enumerate(vehicle.wheelsets):
                if wheelset.fault is not None and wheelset.fault.from_campaign > last:
                    reason = f"{wheelset.fault.from_campaign} is outside the range: at most {last}"
                    raise field_error(reason, "vehicles", i, "wheelsets", k, "fault", "from_campaign")
        return self

    @model_validator(mode="after")
    def _check_runs(self) -> Self:
        for index, vehicle in enumerate(self.vehicles):
            if vehicle.minutes_each is not None and self.sessions.whole_section:
                reason = "runs over the whole section are not shorter for one vehicle"
                raise field_error(reason, "vehicles", index, "minutes_each")
        return self

    @model_validator(mode="after")
    def _check_stretches(self) -> Self:
        length, last = self.section.length_m, self.sessions.campaigns
        for i, stretch in enumerate(self.creep.stretches):
            if length is not None and stretch.to_m > length:
                reason = f"{stretch.to_m:g} is outside the range: at most {length:g}, the length of the section"
                raise field_error(reason, "creep", "stretches", i, "to_m")
            if stretch.from_campaign > last:
                reason = f"{stretch.from_campaign} is outside the range: at most {last}"
                raise field_error(reason, "creep", "stretches", i, "from_campaign")
        return self

    @model_validator(mode="after")
    def _check_flats(self) -> Self:
        listed = {wheelset.serial for vehicle in self.vehicles for wheelset in vehicle.wheelsets}
        serials = listed if self.drawn_fleet is None else set(self.drawn_fleet.serials())
        for i, flat in enumerate(self.wheels.flats):
            if flat.wheelset not in serials:
                raise field_error(f"there is no wheelset {flat.wheelset!r}", "wheels", "flats", i, "wheelset")
            if flat.from_campaign > self.sessions.campaigns:
                reason = f"{flat.from_campaign} is outside the range: at most {self.sessions.campaigns}"
                raise field_error(reason, "wheels", "flats", i, "from_campaign")
        return self

    @model_validator(mode="after")
    def _check_bogies(self) -> Self:
        bogie = self.dynamics.bogie_plan()
        if bogie is None:
            return self
        if self.drawn_fleet is not None:
            if uneven := self.drawn_fleet.axles_without_bogie():
                raise field_error(f"a vehicle has {uneven} wheelsets, bogies have two each", "drawn_fleet", "wheelsets")
            return self
        for index, vehicle in enumerate(self.vehicles):
            reason = impossible_bogies(vehicle.offsets(bogie), bogie.wheelbase)
            if reason is not None:
                raise field_error(reason, "vehicles", index, "axle_offsets_m")
        return self

    @model_validator(mode="after")
    def _check_driven_axles(self) -> Self:
        if self.drawn_fleet is None:
            fewest = min(len(vehicle.wheelsets) for vehicle in self.vehicles)
        else:
            fewest = self.drawn_fleet.wheelsets_each
        for axle in () if self.traction is None else self.traction.driven_axles:
            if axle > fewest:
                raise field_error(f"there is no axle {axle} in every vehicle", "traction", "driven_axles")
        return self

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        if self.sessions.whole_section and self.section.length_m is None:
            raise field_error("needs a section with 'length_m'", "sessions", "whole_section")
        if self.section.length_m is None or self.sessions.minutes_each is None:
            return self
        if self.drawn_fleet is not None:
            return self
        rear = max(vehicle.offsets(self.dynamics.bogie_plan())[-1] for vehicle in self.vehicles)
        needed = 60.0 * self.speed.highest_m_s * self.sessions.minutes_each + rear
        if self.section.length_m < needed:
            reason = f"a campaign may need {needed:.0f} m of track, the section has {self.section.length_m:.0f} m"
            raise field_error(reason, "section", "length_m")
        return self

    @model_validator(mode="after")
    def _check_growth_of_rail_wear(self) -> Self:
        wear, place = self.section.rail_wear, ("section", "rail_wear", "growth_mm_per_100_mgt")
        if wear is None or wear.growth_mm_per_100_mgt == 0.0:
            return self
        if self.section.tonnage_mgt_per_year is None:
            raise field_error("needs 'section.tonnage_mgt_per_year'", *place)
        if self.drawn_fleet is not None:
            raise field_error("the rails under a drawn fleet do not wear", *place)
        days = (self.sessions.campaigns - 1) * self.sessions.km_between / self.sessions.km_per_day
        deepest = wear.deepest_mm(self.section.tonnage_mgt_per_year * days / DAYS_PER_YEAR)
        if deepest > DEEPEST_BAND / MM:
            reason = f"the last campaign is on bands {deepest:.1f} mm deep; at most {DEEPEST_BAND / MM:g} mm"
            raise field_error(reason, *place)
        return self

    def scenario(self, folder: Path) -> Scenario:
        """Return the scenario in SI units.

        Args:
            folder: Folder of the scenario file: relative file names start here.
        """
        length, bogie = self.section.length_m or 0.0, self.dynamics.bogie_plan()
        parameters = self.dynamics.parameters()
        scenario = Scenario(
            name=self.name,
            description=self.description,
            seed=self.seed,
            fleet_code=self.fleet.code,
            fleet_name=self.fleet.name,
            parameters=parameters,
            section=self.section.plan(folder),
            sensors=self.sensors.plan(),
            speed=self.speed.plan(),
            sessions=self.sessions.plan((length + 2.0 * MARGIN) / self.speed.lowest_m_s),
            bus=self.bus.plan(),
            position=self.position.plan(),
            vehicles=tuple(vehicle.plan(folder, parameters.nominal_radius, bogie) for vehicle in self.vehicles),
            drawn=None if self.drawn_fleet is None else self.drawn_fleet.plan(folder),
            vehicle_errors=None if self.vehicle_errors is None else self.vehicle_errors.plan(),
            bogie=bogie,
            class_on_file=None if self.class_on_file is None else self.class_on_file.plan(folder),
            running=self._running(),
        )
        return with_seed(scenario, self.seed)

    def _running(self) -> RunningPlan:
        level, load = self.section.cross_level, self.section.load_variation
        return RunningPlan(
            creep=self.creep.plan(),
            friction=self.creep.friction_plan(),
            cross_level=None if level is None else level.plan(),
            load_variation=None if load is None else load.plan(),
            out_of_round=MM * self.wheels.out_of_round_mm,
            traction=self.traction is not None,
            driven_axles=() if self.traction is None else tuple(self.traction.driven_axles),
            contact_half_width=MM * self.wheels.contact_half_width_mm,
            contact_step=MM * self.wheels.contact_step_mm,
            stretches=tuple(stretch.plan() for stretch in self.creep.stretches),
            flats=tuple(flat.plan() for flat in self.wheels.flats),
            track_blows=None if self.section.blows is None else self.section.blows.plan(),
        )


def builtin_scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that come with the package."""
    folder = files("ingest.simulator") / "scenarios"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario.

    Args:
        name_or_path: The name of a built-in scenario, or else a file.

    Raises:
        ScenarioError: No such scenario or file, no TOML, or an entry that is missing, unknown or impossible.
    """
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
    """Read a scenario file.

    Raises:
        ScenarioError: As ``load_scenario``.
    """
    file = read_toml(path, ScenarioError)
    table = file.parse(ScenarioTable)
    _check_profile_files(file, table)
    return table.scenario(path.parent)


def _check_profile_files(file: InputFile, table: ScenarioTable) -> None:
    """Read every wheel and rail that the scenario names, so that one which cannot be read is refused at once."""
    for location, read in (*_rail_reads(file, table), *_wheel_reads(file, table)):
        try:
            read()
        except ProfileError as error:
            raise file.error(str(error), location) from error


_Read = tuple[Location, Callable[[], Profile]]


def _rail_reads(file: InputFile, table: ScenarioTable) -> Iterator[_Read]:
    tables: list[tuple[Location, RailFiles]] = [(("section",), table.section)]
    for index, pair in enumerate([] if table.drawn_fleet is None else table.drawn_fleet.pairs):
        tables.append((("drawn_fleet", "pairs", index), pair))
    for place, rails in tables:
        for key, name, mirror in rails.rail_names():
            yield (*place, key), partial(rail_in, file.path.parent / name, mirror)


def _wheel_reads(file: InputFile, table: ScenarioTable) -> Iterator[_Read]:
    for location, name in _wheel_names(table):
        yield location, partial(wheel_in, file.path.parent / name)


def _wheel_names(table: ScenarioTable) -> Iterator[tuple[Location, str]]:
    for i, vehicle in enumerate(table.vehicles):
        for k, wheelset in enumerate(vehicle.wheelsets):
            for key, name in wheelset.wheel_names():
                yield ("vehicles", i, "wheelsets", k, key), name
    for index, pair in enumerate([] if table.drawn_fleet is None else table.drawn_fleet.pairs):
        for k, item in enumerate(pair.wheel_files):
            for side, name in (("left", item.left), ("right", item.right or item.left)):
                yield ("drawn_fleet", "pairs", index, "wheel_files", k, side), name

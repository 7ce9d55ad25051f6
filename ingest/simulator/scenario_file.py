"""Scenario files: TOML in, a frozen ``Scenario`` out. ``docs/scenarios.md`` describes every key."""

from __future__ import annotations

import math
import tomllib
from dataclasses import fields
from importlib.resources import as_file, files
from pathlib import Path

from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course
from estimation.errors import ParameterError, ProfileError, ScenarioError
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.simulator.curves import Curve
from ingest.simulator.motion import MINIMUM_SPEED
from ingest.simulator.scenario import (
    BusPlan,
    Fault,
    FaultKind,
    PositionErrors,
    Scenario,
    SectionPlan,
    Sessions,
    SpeedRange,
    VehiclePlan,
    WheelsetPlan,
)
from ingest.simulator.sensors import FULL_RATE_HZ, Channel, SensorNode, ideal_node
from ingest.simulator.toml_table import TomlTable, key_lines
from ingest.simulator.track import TrackRecipe

MM = 1e-3
SHARPEST_RADIUS = 150.0  # m
KM = 1e3
KM_PER_HOUR = 1.0 / 3.6
MICRO_G = 9.80665e-6
MOST_AXLES = 8
FLANGE_SHARE = 0.6


def builtin_scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that come with the package."""
    folder = files("ingest.simulator") / "scenarios"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario: a built-in one by its name, else a file.

    Raises
    ------
    ScenarioError
        No such scenario or file, no TOML, or an entry that is missing, unknown or impossible.
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
    """Read a scenario file; raises ``ScenarioError`` as ``load_scenario`` does."""
    try:
        text = path.read_text(encoding="utf-8")
        values = tomllib.loads(text)
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror or error}", file=path) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ScenarioError(f"is no TOML file: {error}", file=path) from error
    root = TomlTable(values, path, key_lines(text))
    scenario = _scenario(root)
    root.end()
    return scenario


def _scenario(root: TomlTable) -> Scenario:
    fleet = root.table("fleet")
    fleet_code, fleet_name = fleet.text("code"), fleet.text("name")
    fleet.end()
    sessions = _sessions(root.table("sessions"))
    speed = _speed(root.table("speed"))
    section_table = root.table("section")
    section = _section(section_table)
    vehicles = tuple(_vehicle(table, sessions) for table in root.tables("vehicles"))
    _check_unique(root, vehicles)
    _check_length(section_table, section, speed, sessions, vehicles)
    return Scenario(
        name=root.text("name"),
        description=root.text("description"),
        seed=root.integer("seed"),
        fleet_code=fleet_code,
        fleet_name=fleet_name,
        parameters=_parameters(root.table("dynamics")),
        section=section,
        sensors=sensor_node(root.table("sensors")),
        speed=speed,
        sessions=sessions,
        bus=_bus(root.table("bus")),
        position=_position(root.table("position")),
        vehicles=vehicles,
    )


def _parameters(table: TomlTable) -> VehicleParameters:
    standard = VehicleParameters()
    given = {item.name: table.number(item.name, getattr(standard, item.name)) for item in fields(VehicleParameters)}
    table.end()
    try:
        return VehicleParameters(**given)
    except ParameterError as error:
        raise table.fail(error.reason, error.field) from error


def _section(table: TomlTable) -> SectionPlan:
    rail = table.text("rail_profile", "56E1")
    try:
        rail_profile(rail)
    except ProfileError as error:
        raise table.fail(error.reason, "rail_profile") from error
    file = table.folder / table.text("file") if table.has("file") else None
    recipe = None if file is not None else _recipe(table)
    section = SectionPlan(
        code=table.text("code"),
        number=table.integer("number", low=1, high=65534),
        name=table.text("name"),
        rail_profile=rail,
        inclination=1.0 / table.number("rail_inclination_1_in", 20.0, low=5.0),
        nominal_gauge=MM * table.number("nominal_gauge_mm", 1435.0, low=500.0, high=2000.0),
        recipe=recipe,
        file=file,
        survey_alignment_std=MM * table.number("survey_alignment_std_mm", 0.0),
        survey_gauge_std=MM * table.number("survey_gauge_std_mm", 0.0),
        surveyed=table.flag("surveyed", default=True),
        latitude=table.number("latitude_deg", 51.5, low=-90.0, high=90.0),
        longitude=table.number("longitude_deg", -0.2, low=-180.0, high=180.0),
    )
    table.end()
    return section


def _recipe(table: TomlTable) -> TrackRecipe:
    length = table.number("length_m", above=True)
    interval = table.number("interval_m", 0.25, above=True)
    shortest = table.number("shortest_wavelength_m", 3.0, low=4.0 * interval)
    longest = table.number("longest_wavelength_m", 70.0, low=shortest, high=length, above=True)
    return TrackRecipe(
        length=length,
        interval=interval,
        alignment_std=MM * table.number("alignment_std_mm", 2.0, high=50.0),
        gauge_std=MM * table.number("gauge_std_mm", 0.0, high=20.0),
        gauge_offset=MM * table.number("gauge_offset_mm", 0.0, low=-20.0, high=40.0),
        wavelengths=(shortest, longest),
        curves=tuple(_curve(item, length) for item in table.optional_tables("curves")),
    )


def _curve(table: TomlTable, length: float) -> Curve:
    radius = table.number("radius_m", low=-1e6, high=1e6)
    if abs(radius) < SHARPEST_RADIUS:
        raise table.fail(
            f"{radius:g} m is no radius; at least {SHARPEST_RADIUS:g} m, negative to the right", "radius_m"
        )
    transition = table.number("transition_m", 80.0, above=True)
    curve = Curve(
        start=table.number("start_m", high=length),
        length=table.number("length_m", low=2.0 * transition, high=length, above=True),
        radius=radius,
        cant=MM * table.number("cant_mm", 0.0, low=-200.0, high=200.0),
        transition=transition,
    )
    table.end()
    return curve


def sensor_node(table: TomlTable) -> SensorNode:
    """Return the sensor node that a ``sensors`` table describes."""
    kind = table.text("kind", "mems")
    rate = table.integer("rate_hz", 250, low=1, high=FULL_RATE_HZ)
    if FULL_RATE_HZ % rate:
        raise table.fail(f"{rate} Hz does not divide {FULL_RATE_HZ} Hz", "rate_hz")
    if kind == "ideal":
        table.end()
        return ideal_node(rate)
    if kind != "mems":
        raise table.fail(f"{kind!r} is neither 'mems' nor 'ideal'", "kind")
    linear = Channel(
        noise_density=MICRO_G * table.number("lateral_noise_ug_per_root_hz", 100.0),
        offset=1e3 * MICRO_G * table.number("lateral_offset_mg", 20.0),
        drift=MICRO_G * table.number("lateral_drift_ug_per_root_s", 20.0),
        limit=1e6 * MICRO_G * table.number("lateral_limit_g", 50.0, above=True),
    )
    mass = Channel(
        noise_density=MICRO_G * table.number("mass_noise_ug_per_root_hz", 100.0),
        offset=1e3 * MICRO_G * table.number("mass_offset_mg", 10.0),
        drift=MICRO_G * table.number("mass_drift_ug_per_root_s", 20.0),
        limit=1e6 * MICRO_G * table.number("mass_limit_g", 2.0, above=True),
    )
    angular = Channel(
        noise_density=table.number("angular_noise_rad_s2_per_root_hz", 2e-3),
        offset=table.number("angular_offset_rad_s2", 0.05),
        drift=table.number("angular_drift_rad_s2_per_root_s", 2e-4),
        limit=table.number("angular_limit_rad_s2", 100.0, above=True),
    )
    filtered = table.flag("anti_alias", default=True)
    table.end()
    return SensorNode(linear, angular, angular, mass, rate_hz=rate, anti_alias=filtered)


def _speed(table: TomlTable) -> SpeedRange:
    lowest = table.number("lowest_m_s", low=2.0 * MINIMUM_SPEED)
    highest = table.number("highest_m_s", low=lowest, high=131.0)
    period = table.number("period_s", 120.0, low=20.0)
    every = table.number("stop_every_s", 0.0)
    stop = table.number("stop_s", 30.0)
    braking = table.number("braking_m_s2", 0.5, high=2.0, above=True)
    table.end()
    return SpeedRange(lowest, highest, period, every, stop, braking)


def _sessions(table: TomlTable) -> Sessions:
    sessions = Sessions(
        start_ns=table.moment_ns("start"),
        campaigns=table.integer("campaigns", low=1, high=10_000),
        duration=60.0 * table.number("minutes_each", above=True, high=600.0),
        distance_between=KM * table.number("km_between", above=True),
        first_odometer=KM * table.number("first_odometer_km", 0.0),
        distance_per_day=KM * table.number("km_per_day", 400.0, above=True),
        start_within=table.number("start_within_m") if table.has("start_within_m") else math.inf,
    )
    table.end()
    return sessions


def _position(table: TomlTable) -> PositionErrors:
    plan = PositionErrors(
        offset=table.number("largest_offset_m", 0.0, high=1000.0),
        scale=table.number("largest_scale_percent", 0.0, high=10.0) / 100.0,
    )
    table.end()
    return plan


def _bus(table: TomlTable) -> BusPlan:
    plan = BusPlan(
        lost_share=table.number("lost_frames_percent", 0.0, high=50.0) / 100.0,
        burst_per_hour=table.number("bursts_per_hour", 0.0, high=3600.0),
        burst=table.number("burst_s", 0.5, high=60.0),
        jitter=1e-6 * table.number("jitter_us", 0.0, high=1000.0),
        recorder_offset=table.number("recorder_clock_offset_s", 0.0, low=-86400.0, high=86400.0),
    )
    table.end()
    return plan


def _vehicle(table: TomlTable, sessions: Sessions) -> VehiclePlan:
    wheelsets = tuple(_wheelset(item, sessions) for item in table.tables("wheelsets"))
    if len(wheelsets) > MOST_AXLES:
        raise table.fail(f"{len(wheelsets)} wheelsets, at most {MOST_AXLES}", "wheelsets")
    default = tuple(2.6 * axle for axle in range(len(wheelsets)))
    offsets = table.numbers("axle_offsets_m", default)
    if len(offsets) != len(wheelsets):
        raise table.fail(f"{len(offsets)} offsets for {len(wheelsets)} wheelsets", "axle_offsets_m")
    plan = VehiclePlan(
        code=table.text("code"),
        vehicle_class=table.text("class"),
        max_speed=KM_PER_HOUR * table.number("max_speed_km_h", above=True, high=400.0),
        axle_offsets=offsets,
        wheelsets=wheelsets,
    )
    table.end()
    return plan


def _wheelset(table: TomlTable, sessions: Sessions) -> WheelsetPlan:
    wheel = table.text("wheel_profile", "P8")
    try:
        wheel_profile(wheel)
    except ProfileError as error:
        raise table.fail(error.reason, "wheel_profile") from error
    course = wear_course(WearFamily.S1002_ON_60E1 if "1002" in wheel else WearFamily.P8_ON_56E1, 0.0)
    rate = table.number("wear_mm_per_100000_km", 0.0, high=20.0)
    per_metre = MM / (1e5 * KM)
    plan = WheelsetPlan(
        serial=table.text("serial"),
        wheel_profile=wheel,
        nominal_radius=MM * table.number("nominal_radius_mm", 450.0, low=150.0, high=700.0),
        rate_left=per_metre * table.number("wear_left_mm_per_100000_km", rate, high=20.0),
        rate_right=per_metre * table.number("wear_right_mm_per_100000_km", rate, high=20.0),
        wear_centre=MM * table.number("wear_centre_mm", course.centre / MM, low=-30.0, high=30.0),
        wear_half_width=MM * table.number("wear_half_width_mm", course.half_width / MM, low=5.0, high=100.0),
        flange_share=table.number("flange_wear_share", FLANGE_SHARE, high=2.0),
        initial_wear=MM * table.number("initial_wear_mm", 0.0, high=5.0),
        initial_mileage=KM * table.number("initial_mileage_km", 0.0),
        reprofilings=tuple(KM * value for value in table.numbers("reprofiled_at_odometer_km", ())),
        diameter_difference=MM * table.number("diameter_difference_mm", 0.0, low=-5.0, high=5.0),
        fault=_fault(table.table("fault"), sessions) if table.has("fault") else None,
    )
    table.end()
    return plan


def _fault(table: TomlTable, sessions: Sessions) -> Fault:
    kind = table.text("kind")
    if kind not in tuple(FaultKind):
        raise table.fail(f"{kind!r} is none of {', '.join(FaultKind)}", "kind")
    fault = Fault(FaultKind(kind), table.integer("from_campaign", low=1, high=sessions.campaigns))
    table.end()
    return fault


def _check_unique(root: TomlTable, vehicles: tuple[VehiclePlan, ...]) -> None:
    codes = [plan.code for plan in vehicles]
    serials = [wheelset.serial for plan in vehicles for wheelset in plan.wheelsets]
    for what, names in (("vehicle code", codes), ("wheelset serial", serials)):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise root.fail(f"{what} {twice[0]!r} occurs twice", "vehicles")


def _check_length(
    table: TomlTable, section: SectionPlan, speed: SpeedRange, sessions: Sessions, vehicles: tuple[VehiclePlan, ...]
) -> None:
    if section.recipe is None:
        return
    needed = speed.highest * sessions.duration + max(plan.axle_offsets[-1] for plan in vehicles)
    if section.recipe.length < needed:
        raise table.fail(
            f"a campaign may need {needed:.0f} m of track, the section has {section.recipe.length:.0f} m", "length_m"
        )

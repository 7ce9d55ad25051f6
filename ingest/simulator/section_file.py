"""Section scenario files: TOML in, a frozen ``SectionScenario`` out. ``docs/compare.md`` describes every key."""

from __future__ import annotations

import tomllib
from importlib.resources import as_file, files
from pathlib import Path

from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.errors import ProfileError, ScenarioError
from ingest.simulator.motion import MINIMUM_SPEED
from ingest.simulator.section_scenario import ProfilePair, SectionScenario, VehicleErrors
from ingest.simulator.toml_table import TomlTable, key_lines, sensor_node

MM = 1e-3
PERCENT = 1e-2
SHORTEST_SECTION = 500.0  # m
DEEPEST_MM = 6.0


def builtin_section_scenarios() -> tuple[str, ...]:
    """Return the names of the section scenarios that come with the package."""
    folder = files("ingest.simulator") / "scenarios" / "section"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def load_section_scenario(name_or_path: str | Path) -> SectionScenario:
    """Read a section scenario: a built-in one by its name, else a file.

    Raises
    ------
    ScenarioError
        No such scenario or file, no TOML, or an entry that is missing, unknown or impossible.
    """
    known = builtin_section_scenarios()
    if str(name_or_path) in known:
        with as_file(files("ingest.simulator") / "scenarios" / "section" / f"{name_or_path}.toml") as path:
            return read_section_scenario(path)
    path = Path(name_or_path)
    if not path.exists():
        raise ScenarioError(f"no such file, and no built-in scenario of that name ({', '.join(known)})", file=path)
    return read_section_scenario(path)


def read_section_scenario(path: Path) -> SectionScenario:
    """Read a section scenario file; raises ``ScenarioError`` as ``load_section_scenario`` does."""
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


def _scenario(root: TomlTable) -> SectionScenario:
    fleet, section, speed = root.table("fleet"), root.table("section"), root.table("speed")
    known, vehicle = root.table("known"), root.table("vehicle_errors")
    lowest = speed.number("lowest_m_s", 14.0, low=2.0 * MINIMUM_SPEED)
    length = section.number("length_m", 12_000.0, low=SHORTEST_SECTION, high=100_000.0)
    scenario = SectionScenario(
        name=root.text("name"),
        description=root.text("description"),
        pairs=tuple(_pair(table) for table in root.tables("pairs")),
        vehicles=fleet.integer("vehicles", 4, low=1, high=64),
        wheelsets=fleet.integer("wheelsets", 4, low=1, high=8),
        passes=fleet.integer("passes", 3, low=1, high=100),
        wear_alike=fleet.flag("wear_alike", default=False),
        length=length,
        alignment_std=MM * section.number("alignment_std_mm", 2.0, high=20.0),
        gauge_std=MM * section.number("gauge_std_mm", 0.0, high=5.0),
        lowest_speed=lowest,
        highest_speed=speed.number("highest_m_s", 25.0, low=lowest, high=80.0),
        speed_alike=speed.flag("alike", default=False),
        sensors=sensor_node(root.table("sensors")),
        alignment_known=known.flag("alignment", default=False),
        gauge_known=known.flag("gauge", default=False),
        wheelsets_measured=known.integer("wheelsets_measured", 0, low=0, high=512),
        position_offset=known.number("position_offset_m", 0.0, high=100.0),
        position_scale=PERCENT * known.number("position_scale_percent", 0.0, high=1.0),
        vehicle_errors=VehicleErrors(
            creep=PERCENT * vehicle.number("creep_percent", 20.0, high=50.0),
            stiffness=PERCENT * vehicle.number("stiffness_percent", 10.0, high=50.0),
            mass=PERCENT * vehicle.number("mass_percent", 5.0, high=50.0),
        ),
        errors_drawn=vehicle.flag("drawn", default=False),
    )
    for table in (fleet, section, speed, known, vehicle):
        table.end()
    return scenario


def _pair(table: TomlTable) -> ProfilePair:
    wheel, rail = table.text("wheel_profile"), table.text("rail_profile")
    for key, look_up in (("wheel_profile", wheel_profile), ("rail_profile", rail_profile)):
        try:
            look_up(table.text(key))
        except ProfileError as error:
            raise table.fail(error.reason, key) from error
    pair = ProfilePair(
        name=table.text("name", f"{wheel}/{rail}"),
        wheel=wheel,
        rail=rail,
        inclination=1.0 / table.number("rail_inclination_1_in", 20.0, low=5.0),
        deepest_wear=MM * table.number("deepest_wear_mm", high=DEEPEST_MM),
    )
    table.end()
    return pair

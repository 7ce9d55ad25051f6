"""What an exchange is checked for before anything of it is stored: table, axes, vehicle, section, mountings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.errors import ConflictError, NotFoundError
from estimation.values.registry import VehicleRecord
from estimation.values.track import TrackSectionRecord
from fleet_db.storage import SqlUnitOfWork
from ingest.exchange.bundle import SUFFIX, read_run
from ingest.exchange.description import ExchangeFile, read_description
from ingest.exchange.run import INTERVAL_NS, ExchangeRun, RegistryFacts
from ingest.exchange.signs import check_signs
from ingest.input_file import InputFile, Location


def check_alone(unit: SqlUnitOfWork, vehicle: str, first_ns: int, last_ns: int, digest: str) -> None:
    """Raise where another exchange of the vehicle shares an instant with one."""
    for other in unit.chunks.overlapping(vehicle, first_ns, last_ns + 1):
        if other.suffix == SUFFIX and other.digest != digest:
            reason = (
                f"another exchange of vehicle {vehicle} is stored for the same time: {other.digest[:12]};"
                f" where that one is wrong: treadwatch recordings set-aside {other.digest[:12]}"
            )
            raise ConflictError(reason, kind="chunk", key=other.digest)


BEYOND_M = 1.0
"""How far beyond the ends of its section a position may be: sections are surveyed to that."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """An exchange that can be received."""

    description: Path
    table: Path
    vehicle: str
    facts: RegistryFacts
    first_ns: int  # vehicle clock
    last_ns: int


def checked_exchange(description: Path, unit: SqlUnitOfWork) -> Exchange:
    """Return an exchange that was checked from its units to its mountings.

    Raises:
        ExchangeError: Something in it is missing, impossible or contradicts itself or the registry; names file, line
            and field.
    """
    file, toml = read_description(description)
    vehicle, section = _vehicle(file, toml, unit), _section(file, toml, unit)
    on_file = unit.registry.vehicle_class(vehicle.vehicle_class)
    if on_file is None:
        reason = f"the registry has no class {vehicle.vehicle_class!r}, of which vehicle {vehicle.code} is"
        raise toml.error(reason, ("run", "vehicle"))
    gravity = on_file.vehicle_class.sensors.measures_gravity
    in_bogie = on_file.vehicle_class.bogie is not None
    facts = RegistryFacts(section.number, _offset(file, vehicle), measures_gravity=gravity)
    table = description.parent / file.data
    if not table.is_file():
        raise toml.error(f"{table} does not exist", ("data",))
    run = read_run(file, table, facts)
    _check_section(run, facts, section, toml, table)
    first_ns, last_ns = (int(end) * INTERVAL_NS for end in run.tick[[0, -1]])
    _check_mountings(file, toml, unit, (first_ns, last_ns))
    check_signs(run, file, toml, in_bogie=in_bogie)
    return Exchange(description, table, vehicle.code, facts, first_ns, last_ns)


def _vehicle(file: ExchangeFile, toml: InputFile, unit: SqlUnitOfWork) -> VehicleRecord:
    try:
        vehicle = unit.registry.vehicle(file.run.vehicle)
    except NotFoundError as error:
        raise toml.error(f"the registry has {error}", ("run", "vehicle")) from error
    numbers: list[tuple[Location, int]] = [(("axles", at, "axle"), axle.axle) for at, axle in enumerate(file.axles)]
    if file.run.position_of_axle is not None:
        numbers.append((("run", "position_of_axle"), file.run.position_of_axle))
    for location, number in numbers:
        if number > vehicle.axles:
            raise toml.error(f"{number}: vehicle {vehicle.code} has {vehicle.axles} axles", location)
    return vehicle


def _section(file: ExchangeFile, toml: InputFile, unit: SqlUnitOfWork) -> TrackSectionRecord:
    try:
        return unit.tracks.section(file.run.section)
    except NotFoundError as error:
        raise toml.error(f"the registry has {error}", ("run", "section")) from error


def _offset(file: ExchangeFile, vehicle: VehicleRecord) -> float:
    axle = file.run.position_of_axle
    return 0.0 if axle is None else vehicle.axle_offsets_m[axle - 1]


def _check_section(
    run: ExchangeRun, facts: RegistryFacts, section: TrackSectionRecord, toml: InputFile, table: Path
) -> None:
    reach = BEYOND_M + abs(facts.axle_offset_m)
    worst = float(run.distance[np.argmax(np.abs(run.distance - 0.5 * section.length_m))])
    if not -reach <= worst <= section.length_m + reach:
        reason = (
            f"the run reaches {worst:.1f} m, section {section.code} of the registry goes from 0 to"
            f" {section.length_m:.1f} m: another section, or another origin of the position in {table.name}"
        )
        raise toml.error(reason, ("run", "section"))


def _check_mountings(file: ExchangeFile, toml: InputFile, unit: SqlUnitOfWork, span: tuple[int, int]) -> None:
    for at, axle in enumerate(file.axles):
        ends = [unit.registry.mounting_at(file.run.vehicle, axle.axle, end) for end in span]
        if ends[0] is None or ends[0] != ends[1]:
            reason = f"no one wheelset was mounted at axle {axle.axle} from begin to end of the run"
            raise toml.error(reason, ("axles", at, "axle"))

"""What an exchange is checked for before anything of it is stored: table, axes, vehicle, section, mountings."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from estimation.errors import ConflictError, InputError, NotFoundError
from estimation.motion.checks import high_pass_running_mean, lateral_yaw_correlation
from estimation.motion.integration import SignalParameters, integrate
from estimation.motion.parameters import MOTION
from estimation.values.registry import VehicleRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS, Window, WindowQuality
from fleet_db.storage import SqlUnitOfWork
from ingest.exchange.description import AxesTable, ExchangeFile, read_description
from ingest.exchange.run import COUNT, INTERVAL_NS, SUFFIX, ExchangeRun, RegistryFacts, read_run
from ingest.input_file import InputFile, Location

INTERVAL_S = INTERVAL_NS * 1e-9
MOST_GAIN = 4.0
"""Of the lateral velocity over V psi, or less than its inverse: creep leaves 0.6 to 1.6, g for m/s2 makes 10."""

OTHER_WAY = {"left": "right", "right": "left"}
_GOOD = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0, 1.0, sensor_fault=False)


class Turned(StrEnum):
    """Which signal of an axle has the wrong sign."""

    LATERAL = "lateral"
    YAW = "yaw"
    ROLL = "roll"
    MASS_LATERAL = "mass_lateral"
    LATERAL_OR_YAW = "lateral or yaw"  # roll is too small to part them


@dataclass(frozen=True, slots=True)
class SignEvidence:
    """How the signals of an axle go with each other, -1 to 1; None where nothing moves.

    ``roll_low`` and ``roll_high`` bound the correlation of roll with the lateral displacement without gravity.
    """

    lateral_yaw: float | None
    roll_low: float
    roll_high: float
    mass: float  # acceleration of the mass, velocity of a bogie frame, with the lateral velocity of the axle
    gain: float | None = None  # rms of the lateral velocity over that of V psi

    @property
    def other_unit(self) -> bool:
        """Whether lateral and yaw go with each other, but not in magnitude: the unit of one of them is another."""
        goes = self.lateral_yaw is not None and self.lateral_yaw >= -MOTION.backwards_correlation
        return goes and self.gain is not None and not 1.0 / MOST_GAIN <= self.gain <= MOST_GAIN

    @property
    def turned(self) -> Turned | None:
        """The signal whose sign the others contradict."""
        roll_is_against = self.roll_high < MOTION.backwards_correlation
        if self.lateral_yaw is None or self.lateral_yaw >= MOTION.backwards_correlation:
            if roll_is_against and (self.lateral_yaw or 0.0) > -MOTION.backwards_correlation:
                return Turned.ROLL
            return Turned.MASS_LATERAL if self.mass < MOTION.backwards_correlation else None
        if roll_is_against:
            return Turned.LATERAL
        return Turned.YAW if self.roll_low > -MOTION.backwards_correlation else Turned.LATERAL_OR_YAW


def sign_evidence(run: ExchangeRun, axle: int, *, in_bogie: bool) -> SignEvidence:
    """Return how lateral, yaw and roll of an axle go with each other over a run.

    The lateral accelerometer of a node that rolls by phi measures y'' + g phi, so the displacement from it has a part
    whose second derivative is g phi: it bounds the correlation with roll, taken out with the measured sign and with the
    other one.
    """
    integrated = integrate(_window(run, axle), np.ones(len(run.tick), np.bool_), SignalParameters())
    seconds, sums = round(MOTION.comparison_s / INTERVAL_S), np.zeros(8)
    for segment in integrated.segments:
        above = (segment.rates if in_bogie else segment.accelerations)[3]
        signals = (segment.rates[0], segment.speed * segment.displacements[1], above)
        v, turned, mass = (high_pass_running_mean(signal, seconds) for signal in signals)
        y, phi = (
            high_pass_running_mean(signal, seconds) for signal in (segment.displacements[0], segment.displacements[2])
        )
        falling = GRAVITY * phi  # the displacement that gravity along the roll makes
        for _ in range(2):
            falling = np.concatenate([[0.0], np.cumsum(0.5 * INTERVAL_S * (falling[1:] + falling[:-1]))])
            falling = high_pass_running_mean(np.pad(falling - falling.mean(), seconds), seconds)
        products = (v @ v, turned @ turned, mass @ v, mass @ mass, y @ phi, abs(falling @ phi), y @ y, phi @ phi)
        sums += products
    lateral, yaw, with_mass, of_mass, with_roll, gravity, of_y, of_roll = sums.tolist()
    scale = math.sqrt(of_y * of_roll)
    return SignEvidence(
        lateral_yaw_correlation(integrated),
        (with_roll - gravity) / scale if scale else 0.0,
        (with_roll + gravity) / scale if scale else 0.0,
        with_mass / math.sqrt(of_mass * lateral) if of_mass * lateral > 0.0 else 0.0,
        math.sqrt(lateral / yaw) if yaw > 0.0 else None,
    )


def check_signs(run: ExchangeRun, file: ExchangeFile, toml: InputFile, *, in_bogie: bool) -> None:
    """Raise where the signals of a run contradict its axes, or lateral and yaw of an axle differ in magnitude.

    Where all axles have the wrong sign the error names the axis that must be turned, else a sensor.
    """
    signs = {axle: sign_evidence(run, axle, in_bogie=in_bogie) for axle in run.accelerations}
    for index, axle in enumerate(file.axles):
        evidence = signs[axle.axle]
        if evidence.other_unit:
            reason = f"the lateral velocity is {evidence.gain:.3g} times what yaw and speed give (y' = V psi)"
            raise toml.error(f"{reason}: is the unit of lateral or of yaw another?", ("axles", index, "lateral"))
    turned = {axle: evidence.turned for axle, evidence in signs.items()}
    kinds = set(turned.values())
    if kinds == {None}:
        return
    if len(kinds) == 1:
        raise _axis_error(next(kind for kind in turned.values() if kind), signs, file.axes, toml)
    index, axle, kind = next((i, axle, kind) for i, axle in enumerate(file.axles) if (kind := turned[axle.axle]))
    signal = "lateral" if kind is Turned.LATERAL_OR_YAW else str(kind)
    good = [str(number) for number, other in turned.items() if other is None]
    others = f"axles {', '.join(good)} do not" if good else "other signals of other axles do too"
    reason = f"{_contradiction(kind, [signs[axle.axle]])} on axle {axle.axle}, {others}: turn that sensor (turned = "
    raise toml.error(f"{reason}{str(not getattr(axle, signal).turned).lower()})", ("axles", index, signal))


def _axis_error(kind: Turned, evidence: Mapping[int, SignEvidence], axes: AxesTable, toml: InputFile) -> InputError:
    yaw = "front_left" if axes.signs["yaw"] > 0.0 else "front_right"
    roll = "left_up" if axes.signs["roll"] > 0.0 else "left_down"
    if kind is Turned.YAW:
        field, yaw = "yaw", "front_right" if yaw == "front_left" else "front_left"
        what = f'the axis of yaw, z, must be turned: yaw = "{yaw}"'
    elif kind is Turned.ROLL:
        field, roll = "roll", "left_down" if roll == "left_up" else "left_up"
        what = f'the axis of roll, x, must be turned: roll = "{roll}"'
    elif kind is Turned.MASS_LATERAL:
        field, what = "y", "it must be turned on each axle (turned = true)"
    else:
        field = "y"
        what = f'y must be turned: y = "{OTHER_WAY[axes.y]}", with yaw = "{yaw}" and roll = "{roll}"'
        if kind is Turned.LATERAL_OR_YAW:
            what += "; or yaw, the roll is too small to part them"
    location: Location = ("axes", field) if getattr(axes, field) is not None else ("axes",)
    return toml.error(f"{_contradiction(kind, evidence.values())}: {what}", location)


def _contradiction(kind: Turned, items: Collection[SignEvidence]) -> str:
    yaw = float(np.mean([item.lateral_yaw or 0.0 for item in items]))
    roll = float(np.mean([0.5 * (item.roll_low + item.roll_high) for item in items]))
    mass = float(np.mean([item.mass for item in items]))
    sentence = {
        Turned.LATERAL: "the lateral acceleration contradicts yaw and roll",
        Turned.YAW: "yaw contradicts the lateral acceleration, which agrees with roll",
        Turned.ROLL: "roll contradicts the lateral acceleration, which agrees with yaw",
        Turned.MASS_LATERAL: "the lateral acceleration of the mass contradicts that of the axle",
        Turned.LATERAL_OR_YAW: "lateral acceleration and yaw contradict each other",
    }[kind]
    return (
        f"{sentence} (correlation of lateral velocity with yaw {yaw:.2f}, of displacement with roll {roll:.2f},"
        f" of velocity with the mass {mass:.2f})"
    )


def _window(run: ExchangeRun, axle: int) -> Window:
    count = len(run.tick)
    return Window(
        wheelset="",
        vehicle="",
        axle=axle,
        start_ns=int(run.tick[0]) * INTERVAL_NS,
        length_ns=count * INTERVAL_NS,
        sample_interval_s=INTERVAL_S,
        **dict(zip(ACCELERATIONS, run.accelerations[axle].T, strict=True)),
        speed=run.speed,
        distance=run.distance,
        valid=np.ones(count, np.bool_),
        resolution=(COUNT, COUNT, COUNT, COUNT),
        track_section=None,
        odometer_m=0.0,
        quality=_GOOD,
    )


def check_alone(unit: SqlUnitOfWork, vehicle: str, first_ns: int, last_ns: int, digest: str) -> None:
    """Raise where another exchange of the vehicle shares an instant with one."""
    for other in unit.chunks.overlapping(vehicle, first_ns, last_ns + 1):
        if other.suffix == SUFFIX and other.digest != digest:
            reason = (
                f"another exchange of vehicle {vehicle} is stored for the same time: {other.digest[:12]};"
                f" where that one is wrong: treadwatch recordings set-aside {other.digest[:12]}"
            )
            raise ConflictError(reason, kind="chunk", key=other.digest)


BEYOND_M = 1.0  # how far beyond the ends of its section a position may be: sections are surveyed to that


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
    """Return an exchange that was checked from its units to its mountings; errors name file, line and field."""
    file, toml = read_description(description)
    vehicle = _vehicle(file, toml, unit)
    try:
        section = unit.tracks.section(file.run.section)
    except NotFoundError as error:
        raise toml.error(f"the registry has {error}", ("run", "section")) from error
    on_file = unit.registry.vehicle_class(vehicle.vehicle_class)
    if on_file is None:
        reason = f"the registry has no class {vehicle.vehicle_class!r}, of which vehicle {vehicle.code} is"
        raise toml.error(reason, ("run", "vehicle"))
    gravity = on_file.vehicle_class.sensors.measures_gravity
    in_bogie = on_file.vehicle_class.bogie is not None
    axle = file.run.position_of_axle
    offset = 0.0 if axle is None else vehicle.axle_offsets_m[axle - 1]
    facts = RegistryFacts(section.number, offset, measures_gravity=gravity)
    table = description.parent / file.data
    if not table.is_file():
        raise toml.error(f"{table} does not exist", ("data",))
    run = read_run(file, table, facts)
    _check_section(run, facts, section, toml, table)
    first_ns, last_ns = (int(end) * INTERVAL_NS for end in run.tick[[0, -1]])
    for index, mounted in enumerate(file.axles):
        begin, end = (unit.registry.mounting_at(vehicle.code, mounted.axle, t_ns) for t_ns in (first_ns, last_ns))
        if begin is None or begin != end:
            reason = f"no one wheelset was mounted at axle {mounted.axle} from begin to end of the run"
            raise toml.error(reason, ("axles", index, "axle"))
    check_signs(run, file, toml, in_bogie=in_bogie)
    return Exchange(description, table, vehicle.code, facts, first_ns, last_ns)


def _vehicle(file: ExchangeFile, toml: InputFile, unit: SqlUnitOfWork) -> VehicleRecord:
    try:
        vehicle = unit.registry.vehicle(file.run.vehicle)
    except NotFoundError as error:
        raise toml.error(f"the registry has {error}", ("run", "vehicle")) from error
    axles = [axle.axle for axle in file.axles]
    numbers: list[tuple[Location, int]] = [(("axles", index, "axle"), axle) for index, axle in enumerate(axles)]
    if file.run.position_of_axle is not None:
        numbers.append((("run", "position_of_axle"), file.run.position_of_axle))
    for location, number in numbers:
        if number > vehicle.axles:
            raise toml.error(f"{number}: vehicle {vehicle.code} has {vehicle.axles} axles", location)
    return vehicle


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

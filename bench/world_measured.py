"""Rows of the world bench with wheels as they were measured on vehicles: ``python -m bench world --measured FOLDER``.

Measured wheels are not part of the repository. The MiniProf wheels (``.whl``) of a folder become wheelsets: two files
whose names differ by "left" and "right" alone belong together; every other wheel runs with itself, mirrored, and with
the next ones in order on the other side. Left out is what no railway would run, by :func:`fault` and
:func:`with_wheels`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from bench.wheelset_motion import wheelset_motion
from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table, radius_difference_curve
from estimation.errors import ContactError, ProfileError, ScenarioError
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.axle_motion import DerailmentError, contact_of, rails_of, wheel_in
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.drawn_fleet import with_wheelset
from ingest.simulator.scenario import Scenario, SectionPlan, Stream, generator
from ingest.simulator.track import TrackTruth

NOMINAL_RADIUS = 0.45  # m, of the fleets of the rows
ROWS = ("measured_known", "measured_unknown")
PARTNERS = 3  # other wheels with which each one runs
DISPLACEMENT = np.arange(-240, 241) * 0.05e-3  # m
AMPLITUDES = tuple(float(a) for a in np.arange(4, 13) * 0.25e-3)  # m: 1 to 3 mm, as the rows are judged
FURTHEST_ZERO = 3e-3  # m from the track centre, where both wheels roll on the same radius
STEEPEST = math.radians(30.0)  # contact angle on the tread and its root; beyond is flange contact
MOST_FLANGING = 0.01  # of a journey
HIGHEST_CONICITY = 0.4  # the highest at which running gear is tested (EN 14363)

WheelPair = tuple[Path, Path]
"""Files of the left and of the right wheel."""


@dataclass(frozen=True, slots=True)
class MeasuredWheels:
    """Wheelsets of measured wheels, and what was left out."""

    pairs: tuple[WheelPair, ...]
    left_out: tuple[str, ...]  # names, with the reason


def measured_wheels(folder: Path, section: SectionPlan) -> MeasuredWheels:
    """Return the wheelsets that the wheels in a folder make and that can run on a section."""
    left_out: dict[str, str] = {}
    alone, together = _read(sorted(folder.rglob("*.whl")), left_out)
    sound = [path for path in alone if not _left_out((path, path), section, left_out)]
    pairs = [(path, path) for path in sound]
    pairs += [pair for pair in (*together, *_mixed(sound)) if not _left_out(pair, section, left_out)]
    reasons = tuple(f"{name}: {reason}" for name, reason in left_out.items())
    if not pairs:
        raise ScenarioError("; ".join(("no measured wheels that can run", *reasons)), file=folder)
    return MeasuredWheels(tuple(pairs), reasons)


def with_wheels(scenario: Scenario, pairs: Sequence[WheelPair]) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario of a row with measured wheels, drawn by its seed, and what was drawn and left out.

    A wheelset is left out, and another one drawn, that climbs a rail in any of its journeys or spends more than 1 % of
    one in flange contact (30 degrees).
    """
    track, left_out = scenario_track(scenario), []
    places = [(plan.code, axle) for plan in scenario.vehicles for axle in range(len(plan.wheelsets))]
    for place, (vehicle, axle) in enumerate(places):
        drawn = generator(scenario.seed, Stream.MEASURED_WHEELSET, place)
        for index in drawn.permutation(len(pairs)):
            wheelset = replace(scenario.vehicle(vehicle).wheelsets[axle], wheel_files=pairs[index])
            tried = with_wheelset(scenario, vehicle, axle, wheelset)
            reason = _flanging(tried, track, vehicle, axle)
            if reason is None:
                scenario = tried
                break
            left_out.append(f"{wheelset.serial}, {_name(pairs[index])}: {reason}")
        else:
            raise ScenarioError("; ".join(("no measured wheelset can run", *left_out)), field=f"vehicles.{vehicle}")
    return scenario, tuple(left_out)


def _flanging(scenario: Scenario, track: TrackTruth, vehicle: str, axle: int) -> str | None:
    """Return why a wheelset cannot run as the scenario has it; None where it can."""
    plan = scenario.vehicle(vehicle)
    contact = contact_of(scenario, track, plan.wheelsets[axle], scenario.odometer(0))
    displacement = contact.table.lateral_displacement
    steep = displacement[(_angles(contact.table) > STEEPEST) | ~contact.table.exists[:, 0]]
    low, high = steep[steep < 0.0].max(initial=displacement[0]), steep[steep > 0.0].min(initial=displacement[-1])
    for campaign in range(scenario.sessions.campaigns):
        run = vehicle_run(scenario, track, plan, campaign)
        try:
            x = wheelset_motion(scenario, track, run, axle, contact.table).relative_displacement
        except DerailmentError:
            return f"climbs its rail in campaign {campaign + 1}"
        share = float(((x <= low) | (x >= high)).mean())
        if share > MOST_FLANGING:
            return f"flange contact in {share:.0%} of campaign {campaign + 1}"
    return None


def fault(pair: WheelPair, section: SectionPlan) -> str | None:
    """Return why a wheelset cannot run on a section; None where it can.

    Contact is rigid, at nominal gauge. A wheelset is left out whose profiles do not touch on both sides;
    whose radii are equal nowhere within 3 mm of the track centre; which within 3 mm of that place climbs a rail or
    has flange contact (30 degrees); whose equivalent conicity at 1 to 3 mm is above 0.4.
    """
    left_rail, right_rail, inclination = rails_of(section)
    left, right = (wheel_in(path) for path in pair)
    radius = VehicleParameters().nominal_radius
    try:
        wheelset = WheelsetOnTrack(
            left, right, left_rail, right_rail, inclination, section.nominal_gauge, radius, radius
        )
        table = contact_table(wheelset, DISPLACEMENT, outside="hold")
    except ContactError as error:
        return error.reason
    curve = radius_difference_curve(wheelset, DISPLACEMENT)
    zero = zero_crossing(curve.displacement, curve.difference)
    if not abs(zero) <= FURTHEST_ZERO:
        return f"its radii are equal {1e3 * zero:+.1f} mm beside the track centre"
    within = np.abs(DISPLACEMENT - zero) <= AMPLITUDES[-1]
    if not table.exists[within, 0].all():
        return "climbs its rail within 3 mm"
    steepest = float(_angles(table)[within].max())
    if steepest > STEEPEST:
        return f"flange contact within 3 mm, at {math.degrees(steepest):.0f} degrees"
    highest = float(np.max(equivalent_conicity(curve.displacement, curve.difference, AMPLITUDES)))
    return None if highest <= HIGHEST_CONICITY else f"equivalent conicity of {highest:.2f}"


def _angles(table: ContactTable) -> FloatArray:
    """Return the larger contact angle (n,) of both wheels at the first gauge."""
    return np.maximum(table.contact_angle_left[:, 0], table.contact_angle_right[:, 0])


def _name(pair: WheelPair) -> str:
    return " + ".join(dict.fromkeys(path.stem for path in pair))


def _read(paths: Sequence[Path], left_out: dict[str, str]) -> tuple[list[Path], list[WheelPair]]:
    """Return wheels that have no other side on file, and pairs; what cannot be read goes to ``left_out``."""
    readable = []
    for path in paths:
        try:
            wheel_in(path)
        except ProfileError as error:
            left_out[path.stem] = error.reason
        else:
            readable.append(path)
    partners = {path: path.with_name(path.name.replace("left", "right")) for path in readable if "left" in path.name}
    together = [(left, right) for left, right in partners.items() if right in readable]
    paired = {path for pair in together for path in pair}
    return [path for path in readable if path not in paired], together


def _mixed(wheels: Sequence[Path]) -> Iterator[WheelPair]:
    """Yield each wheel beside the next ones, which come after the last from the first on again."""
    for place, step in product(range(len(wheels)), range(1, min(PARTNERS, len(wheels) - 1) + 1)):
        yield wheels[place], wheels[(place + step) % len(wheels)]


def _left_out(pair: WheelPair, section: SectionPlan, left_out: dict[str, str]) -> bool:
    reason = fault(pair, section)
    if reason is not None:
        left_out[_name(pair)] = reason
    return reason is not None

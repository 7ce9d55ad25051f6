"""Whether the parameters of a class can be those of a railway vehicle: a unit that is wrong by 1000 moves a mode.

Each parameter enters a frequency, a damping ratio or a ratio of its neighbours whose range over wagons, coaches,
multiple units and locomotives is narrower than a factor of 1000 (of frequencies, its root) is wide. A
mode is that of one coordinate with all others held, so that it depends on few parameters and can be named.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

from estimation.errors import ParameterError
from estimation.values.units import GRAVITY
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import BogieParameters, VehicleClass, VehicleParameters

UNIT_FACTORS = VEHICLE.unit_factor, VEHICLE.unit_factor**2  # kN/mm for N/m, MN for N


@dataclass(frozen=True, slots=True)
class PlausibleRange:
    """A quantity of the vehicle, and the range that railway vehicles have; the fields that it follows from."""

    name: str
    unit: str
    value: float
    lowest: float
    highest: float
    fields: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Whether the value is in the range."""
        return self.lowest <= self.value <= self.highest


def check_plausible(vehicle_class: VehicleClass) -> None:
    """Check that no quantity is outside its range.

    Raises:
        ParameterError: Names the mode or quantity, its value and range, and as field the parameter whose correction by
            a unit mends most.
    """
    failing = [item for item in plausible_ranges(vehicle_class) if not item.holds]
    if not failing:
        return
    field, factor = _suspect(vehicle_class, failing)
    named = next(item for item in failing if field in item.fields)
    hint = ""
    if factor is not None:
        size = "small" if factor > 1.0 else "large"
        hint = f"; {field} is {max(factor, 1.0 / factor):,.0f} times too {size}: is its unit right?"
    reason = (
        f"{named.name} would be {named.value:.3g} {named.unit}".rstrip()
        + f", railway vehicles have {named.lowest:g} to {named.highest:g}{hint}"
    )
    raise ParameterError(reason, field=field)


def plausible_ranges(vehicle_class: VehicleClass) -> tuple[PlausibleRange, ...]:
    """Return the quantities of a class with their ranges, modes first."""
    p, bogie = vehicle_class.parameters, vehicle_class.bogie
    of_bogie = () if bogie is None else tuple(_bogie_ratios(bogie))
    return (*_modes(p, bogie), *_damping(p, bogie), *of_bogie, *_wheelset_ratios(p), *_creep_ratios(p))


def _suspect(vehicle_class: VehicleClass, failing: list[PlausibleRange]) -> tuple[str, float | None]:
    best = len(failing)
    suspect: tuple[str, float | None] = failing[0].fields[0], None
    parameters = [field for item in failing for field in item.fields]
    for unit, field, inverse in itertools.product(UNIT_FACTORS, parameters, (False, True)):
        factor = 1.0 / unit if inverse else unit
        left = sum(not item.holds for item in plausible_ranges(_scaled(vehicle_class, field, factor)))
        if left < best:
            best, suspect = left, (field, factor)
    return suspect


def _scaled(vehicle_class: VehicleClass, field: str, factor: float) -> VehicleClass:
    if field in {item.name for item in fields(VehicleParameters)}:
        p = vehicle_class.parameters
        return replace(vehicle_class, parameters=replace(p, **{field: factor * getattr(p, field)}))
    bogie = vehicle_class.bogie
    assert bogie is not None
    return replace(vehicle_class, bogie=replace(bogie, **{field: factor * getattr(bogie, field)}))


def _mode(name: str, stiffness: float, inertia: float, ends: tuple[float, float], *names: str) -> PlausibleRange:
    frequency = math.sqrt(stiffness / inertia) / (2 * math.pi)
    return PlausibleRange(f"the mode {name!r}", "Hz", frequency, *ends, names)


def _modes(p: VehicleParameters, bogie: BogieParameters | None) -> Iterator[PlausibleRange]:
    on, lateral = "on its primary springs", ("lateral_stiffness", "wheelset_mass")
    yield _mode(f"wheelset lateral {on}", p.lateral_stiffness, p.wheelset_mass, (1.0, 30.0), *lateral)
    yield _mode(f"wheelset yaw {on}", p.yaw_stiffness, p.yaw_inertia, (2.5, 70.0), "yaw_stiffness", "yaw_inertia")
    if bogie is None:
        names: tuple[str, ...] = "suspended_mass", "lateral_stiffness"
        yield _mode("mass lateral on its springs", p.lateral_stiffness, p.suspended_mass, (0.2, 6.0), *names)
        return
    both, on = 2 * p.lateral_stiffness, "on the primary springs"
    yield _mode(f"frame lateral {on}", both, bogie.frame_mass, (2.0, 60.0), "frame_mass", "lateral_stiffness")
    torsion = 2 * p.yaw_stiffness + both * (bogie.wheelbase / 2) ** 2
    names = "frame_yaw_inertia", "yaw_stiffness", "lateral_stiffness", "wheelbase"
    yield _mode(f"frame yaw {on}", torsion, bogie.frame_yaw_inertia, (3.0, 90.0), *names)
    on = "on the secondary springs"
    stiffness, torsion = bogie.secondary_lateral_stiffness, bogie.secondary_yaw_stiffness
    if stiffness:
        names = "secondary_lateral_stiffness", "body_mass"
        yield _mode(f"body lateral {on}", stiffness, bogie.body_mass, (0.2, 6.0), *names)
    if torsion:
        names = "secondary_yaw_stiffness", "frame_yaw_inertia"
        yield _mode(f"frame yaw {on}", torsion, bogie.frame_yaw_inertia, (0.3, 9.0), *names)


def _damping(p: VehicleParameters, bogie: BogieParameters | None) -> Iterator[PlausibleRange]:
    on, ends = "on its primary springs", (0.003, 3.0)
    rows = [
        (f"wheelset lateral {on}", p.lateral_damping, p.lateral_stiffness, p.wheelset_mass, ends, "lateral_damping"),
        (f"wheelset yaw {on}", p.yaw_damping, p.yaw_stiffness, p.yaw_inertia, ends, "yaw_damping"),
    ]
    if bogie is not None:
        on = "on the secondary springs"
        lateral = bogie.secondary_lateral_damping, bogie.secondary_lateral_stiffness, bogie.body_mass
        yaw = bogie.secondary_yaw_damping, bogie.secondary_yaw_stiffness, bogie.frame_yaw_inertia
        rows.append((f"body lateral {on}", *lateral, (0.01, 5.0), "secondary_lateral_damping"))
        rows.append((f"frame yaw {on}", *yaw, (0.05, 60.0), "secondary_yaw_damping"))
    for mode, damping, stiffness, inertia, (lowest, highest), name in rows:
        if damping and stiffness:
            ratio = damping / (2 * math.sqrt(stiffness * inertia))
            yield PlausibleRange(f"the damping ratio of the mode {mode!r}", "", ratio, lowest, highest, (name,))


def _bogie_ratios(bogie: BogieParameters) -> Iterator[PlausibleRange]:
    yield PlausibleRange("the wheelbase", "m", bogie.wheelbase, 1.2, 5.0, ("wheelbase",))
    gyration = math.sqrt(bogie.frame_yaw_inertia / bogie.frame_mass)
    yield _gyration("frame", gyration, (0.4, 2.5), "frame_yaw_inertia", "frame_mass")
    ratio = bogie.body_mass / bogie.frame_mass
    yield PlausibleRange("body mass over frame mass", "", ratio, 1.5, 100.0, ("body_mass", "frame_mass"))


def _wheelset_ratios(p: VehicleParameters) -> Iterator[PlausibleRange]:
    yield PlausibleRange("the nominal radius", "m", p.nominal_radius, 0.15, 0.75, ("nominal_radius",))
    half = p.half_contact_distance
    yield PlausibleRange("half the distance of the contacts", "m", half, 0.25, 1.0, ("half_contact_distance",))
    gyration = math.sqrt(p.yaw_inertia / p.wheelset_mass)
    yield _gyration("wheelset", gyration, (0.3, 1.2), "yaw_inertia", "wheelset_mass")
    rolling = math.sqrt(p.pitch_inertia / p.wheelset_mass) / p.nominal_radius
    name = "the radius of gyration of the rolling wheelset over its radius"
    yield PlausibleRange(name, "", rolling, 0.2, 1.2, ("pitch_inertia", "wheelset_mass"))
    ratio = p.suspended_mass / p.wheelset_mass
    yield PlausibleRange("suspended mass over wheelset mass", "", ratio, 1.0, 50.0, ("suspended_mass", "wheelset_mass"))
    weight = (p.wheelset_mass + p.suspended_mass) * GRAVITY
    names = "load", "suspended_mass", "wheelset_mass"
    yield PlausibleRange("the axle load over the weight of the masses", "", p.load / weight, 0.13, 2.0, names)


def _creep_ratios(p: VehicleParameters) -> Iterator[PlausibleRange]:
    f11, f22 = p.longitudinal_creep_coefficient, p.lateral_creep_coefficient
    names = "longitudinal_creep_coefficient", "load"
    yield PlausibleRange("longitudinal creep coefficient over wheel load", "", 2 * f11 / p.load, 40.0, 1500.0, names)
    names = "lateral_creep_coefficient", "longitudinal_creep_coefficient"
    yield PlausibleRange("lateral over longitudinal creep coefficient", "", f22 / f11, 0.5, 1.5, names)
    if p.lateral_spin_creep_coefficient:
        length = p.lateral_spin_creep_coefficient / f22
        name = "lateral/spin over lateral creep coefficient"
        yield PlausibleRange(name, "m", length, 2e-4, 1e-2, ("lateral_spin_creep_coefficient",))
    if p.spin_creep_coefficient:
        length = math.sqrt(p.spin_creep_coefficient / f22)
        name = "the root of spin over lateral creep coefficient"
        yield PlausibleRange(name, "m", length, 3e-4, 9e-3, ("spin_creep_coefficient",))


def _gyration(body: str, value: float, ends: tuple[float, float], *names: str) -> PlausibleRange:
    return PlausibleRange(f"the radius of gyration of the {body} in yaw", "m", value, *ends, names)

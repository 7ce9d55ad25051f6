"""Wear that grows with mileage, and the contact geometry that goes with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np

from estimation.contact.conicity import equivalent_conicity, nonlinearity_parameter, zero_crossing
from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table, refined_curve
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import TreadWear, worn, worn_rail
from estimation.values.arrays import FloatArray, FrozenArrays
from ingest.profiles.files import read_profile, read_wheel_profile
from ingest.simulator.running import CONTACT_STEP
from ingest.simulator.scenario import Scenario, WheelsetPlan
from ingest.simulator.section import MGT_OF_GROWTH, SectionPlan

DAYS_PER_YEAR = 365.25


def section_at(scenario: Scenario, odometer: float) -> SectionPlan:
    """Return the section as its rails are when the vehicles' odometer stands at ``odometer``, m."""
    section, sessions = scenario.section, scenario.sessions
    days = (odometer - sessions.first_odometer) / sessions.distance_per_day
    gained = section.rail_growth * (section.tonnage or 0.0) / MGT_OF_GROWTH * days / DAYS_PER_YEAR
    if gained == 0.0:
        return section
    left, right = (one and replace(one, depth=one.depth + gained) for one in section.rail_wear)
    return replace(section, rail_wear=(left, right))


@lru_cache(maxsize=256)
def wheel_in(path: Path) -> Profile:
    """Return the wheel profile in a file, read once in a process."""
    return read_wheel_profile(path)


@lru_cache(maxsize=16)
def rail_in(path: Path, mirror: bool | None) -> Profile:  # noqa: FBT001 - a place beside the path, as the plans have it
    """Return the rail profile in a file, read once in a process.

    ``mirror``: whether its gauge side is at positive y of the file; None decides from the shape.
    """
    return read_profile(path, "rail", mirror=mirror)


def rails_of(section: SectionPlan) -> tuple[Profile, Profile, float]:
    """Return left and right rail of a section as worn, and the inclination (a tangent) that is to be given to them."""
    left = right = rail_profile(section.rail_profile)
    inclination = section.inclination
    if section.rail_files != (None, None):
        inclination = section.file_inclination
        left, right = (
            rail_profile(section.rail_profile) if path is None else rail_in(path, mirror)
            for path, mirror in zip(section.rail_files, section.rail_mirrors, strict=True)
        )
    of_left, of_right = section.rail_wear
    left = left if of_left is None else worn_rail(left, of_left)
    return left, right if of_right is None else worn_rail(right, of_right), inclination


AMPLITUDES = tuple(float(a) for a in np.arange(2, 21) * 0.25e-3)  # m


@dataclass(frozen=True, slots=True)
class WearState:
    """Wear of a wheelset at one moment; m."""

    mileage: float  # since new
    reprofilings: int  # so far
    depth_left: float
    depth_right: float


def wear_at(plan: WheelsetPlan, odometer: float) -> WearState:
    """Return the wear when the vehicle's odometer stands at ``odometer``, m; the lathe takes all of it away."""
    done = [place for place in plan.reprofilings if place <= odometer]
    since = odometer - done[-1] if done else odometer
    left, right = (0.0, 0.0) if done else (plan.initial_left, plan.initial_right)
    return WearState(
        plan.initial_mileage + odometer, len(done), left + plan.rate_left * since, right + plan.rate_right * since
    )


@dataclass(frozen=True, slots=True)
class WornContact:
    """A worn wheelset on a section, and its contact geometry."""

    wheelset: WheelsetOnTrack
    table: ContactTable


def worn_contact(
    plan: WheelsetPlan,
    wear: WearState,
    section: SectionPlan,
    gauge_deviation: FloatArray,
    limit: float,
    step: float = CONTACT_STEP,
) -> WornContact:
    """Return the contact geometry of a worn wheelset on ``section`` at gauge deviations (g,), m; rigid with roll."""
    wheelset = _on_track(plan, wear, section)
    half = round(limit / step)
    grid = np.asarray(step * np.arange(-half, half + 1))
    return WornContact(wheelset, contact_table(wheelset, grid, gauge_deviation, outside="hold"))


def _on_track(plan: WheelsetPlan, wear: WearState, section: SectionPlan) -> WheelsetOnTrack:
    left_rail, right_rail, inclination = rails_of(section)
    left_wheel, right_wheel = worn_profiles(plan, wear)
    return WheelsetOnTrack(
        left_wheel=left_wheel,
        right_wheel=right_wheel,
        left_rail=left_rail,
        right_rail=right_rail,
        inclination=inclination,
        gauge=section.nominal_gauge,
        left_radius=plan.nominal_radius + 0.25 * plan.diameter_difference,
        right_radius=plan.nominal_radius - 0.25 * plan.diameter_difference,
    )


@dataclass(frozen=True, slots=True)
class GeometryTruth(FrozenArrays):
    """True contact geometry of a wheelset at nominal gauge as EN 15302 means it: rigid, without roll.

    The curves are those of such a contact table; conicity, nonlinearity and zero crossing have every contact jump where
    it is, and are NaN where they reach beyond the last displacement with contact.
    """

    lateral_displacement: Annotated[FloatArray, "n"]  # m
    rolling_radius_sum: Annotated[FloatArray, "n"]  # m
    rolling_radius_difference: Annotated[FloatArray, "n"]  # m
    contact_angle_sum: Annotated[FloatArray, "n"]  # rad
    contact_angle_difference: Annotated[FloatArray, "n"]  # rad
    amplitude: Annotated[FloatArray, "k"]  # (k,) m
    equivalent_conicity: Annotated[FloatArray, "k"]  # (k,)
    nonlinearity: float  # 1/mm
    zero_crossing: float  # m


def truth_of(contact: WornContact) -> GeometryTruth:
    """Return the true geometry of a worn wheelset at nominal gauge, whatever gauge its line has."""
    grid = contact.table.lateral_displacement
    table = contact_table(contact.wheelset, grid, method=ContactMethod.EN15302, outside="hold")
    curve = refined_curve(contact.wheelset, table, 0)
    x, R = curve.displacement, curve.difference
    return GeometryTruth(
        lateral_displacement=table.lateral_displacement,
        rolling_radius_sum=table.rolling_radius_sum[:, 0],
        rolling_radius_difference=table.rolling_radius_difference[:, 0],
        contact_angle_sum=table.contact_angle_sum[:, 0],
        contact_angle_difference=table.contact_angle_difference[:, 0],
        amplitude=np.array(AMPLITUDES),
        equivalent_conicity=equivalent_conicity(x, R, AMPLITUDES),
        nonlinearity=nonlinearity_parameter(x, R),
        zero_crossing=zero_crossing(x, R),
    )


def worn_profiles(plan: WheelsetPlan, wear: WearState) -> tuple[Profile, Profile]:
    """Return the profiles of the left and the right wheel of ``plan`` after that wear."""
    left, right = (wheel_profile(plan.wheel_profile) if path is None else wheel_in(path) for path in plan.wheel_files)
    return _worn(plan, left, wear.depth_left), _worn(plan, right, wear.depth_right)


def _worn(plan: WheelsetPlan, wheel: Profile, depth: float) -> Profile:
    if depth == 0.0:
        return wheel
    return worn(wheel, TreadWear(depth, plan.wear_centre, plan.wear_half_width, plan.flange_share * depth))

"""Wheels and rails of a scenario: built-in or measured ones from files."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import RailWear, worn_rail
from ingest.profiles.files import read_profile
from ingest.profiles.wheel_profile import read_wheel_profile
from ingest.simulator.scenario import Scenario, WheelsetPlan
from ingest.simulator.section import MGT_OF_GROWTH, SectionPlan

DAYS_PER_YEAR = 365.25


def depth_gained(section: SectionPlan, days: float) -> float:
    """Return by how much the bands of both rails are deeper after some days of traffic, m."""
    if section.tonnage is None:
        return 0.0
    return section.rail_growth * section.tonnage / MGT_OF_GROWTH * days / DAYS_PER_YEAR


def section_at(scenario: Scenario, odometer: float) -> SectionPlan:
    """Return the section as its rails are when the vehicles' odometer stands at ``odometer``, m."""
    section, sessions = scenario.section, scenario.sessions
    gained = depth_gained(section, (odometer - sessions.first_odometer) / sessions.distance_per_day)
    if gained == 0.0:
        return section
    left, right = (_deeper(one, gained) for one in section.rail_wear)
    return replace(section, rail_wear=(left, right))


def _deeper(wear: RailWear | None, gained: float) -> RailWear | None:
    return None if wear is None else replace(wear, depth=wear.depth + gained)


@lru_cache(maxsize=256)
def wheel_in(path: Path) -> Profile:
    """Return the wheel profile in a file, read once in a process."""
    return read_wheel_profile(path)


@lru_cache(maxsize=16)
def rail_in(path: Path, mirror: bool | None) -> Profile:  # noqa: FBT001 - a place beside the path, as the plans have it
    """Return the rail profile in a file, read once in a process.

    Args:
        mirror: Whether its gauge side is at positive y of the file; None decides from the shape.
    """
    return read_profile(path, "rail", mirror=mirror)


def wheels_of(plan: WheelsetPlan) -> tuple[Profile, Profile]:
    """Return left and right wheel of a wheelset before the wear of the scenario."""
    left, right = (wheel_profile(plan.wheel_profile) if path is None else wheel_in(path) for path in plan.wheel_files)
    return left, right


def rails_of(section: SectionPlan) -> tuple[Profile, Profile, float]:
    """Return left and right rail of a section as worn, and the inclination (a tangent) that is to be given to them."""
    left, right, inclination = _unworn_rails(section)
    of_left, of_right = section.rail_wear
    left = left if of_left is None else worn_rail(left, of_left)
    return left, right if of_right is None else worn_rail(right, of_right), inclination


def _unworn_rails(section: SectionPlan) -> tuple[Profile, Profile, float]:
    if section.rail_files == (None, None):
        rail = rail_profile(section.rail_profile)
        return rail, rail, section.inclination
    left, right = (
        rail_profile(section.rail_profile) if path is None else rail_in(path, mirror)
        for path, mirror in zip(section.rail_files, section.rail_mirrors, strict=True)
    )
    return left, right, section.file_inclination

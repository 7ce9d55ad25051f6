"""Wear of rails that grows with the traffic on them, from the first campaign on."""

from __future__ import annotations

from dataclasses import replace

from estimation.contact.wear import RailWear
from ingest.simulator.scenario import Scenario
from ingest.simulator.section import MGT_OF_GROWTH, SectionPlan

DAYS_PER_YEAR = 365.25


def depth_gained(section: SectionPlan, days: float) -> float:
    """Return by how much the bands of both rails are deeper after some days of traffic, m."""
    if section.tonnage is None:
        return 0.0
    return section.rail_growth * section.tonnage / MGT_OF_GROWTH * days / DAYS_PER_YEAR


def section_at(scenario: Scenario, odometer: float) -> SectionPlan:
    """Return the section as its rails are when the vehicles' odometer stands at ``odometer``, m.

    Args:
        odometer: m.
    """
    section, sessions = scenario.section, scenario.sessions
    gained = depth_gained(section, (odometer - sessions.first_odometer) / sessions.distance_per_day)
    if gained == 0.0:
        return section
    left, right = (_deeper(one, gained) for one in section.rail_wear)
    return replace(section, rail_wear=(left, right))


def _deeper(wear: RailWear | None, gained: float) -> RailWear | None:
    return None if wear is None else replace(wear, depth=wear.depth + gained)

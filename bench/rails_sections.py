"""Sections of the rails bench: one fleet, several sections, rails of their own; what is true of them.

A scenario has one section. Several scenarios with the same wheelsets, whose runs are between each other, are several
sections of one fleet. Not every vehicle runs everywhere, and one never runs on the section whose rails are known: what
its wheels are has to come from the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.profiles import wheel_profile
from estimation.contact.wear import RailWear
from estimation.values.arrays import FloatArray
from estimation.values.units import DAY_NS
from ingest.simulator.axle_motion import rails_of
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario, SectionPlan, VehicleErrors
from ingest.simulator.scenario_file import load_scenario

TEMPLATE = Path(__file__).parent / "rails_scenarios" / "sections.toml"
KNOWN = "S0"
KM_BETWEEN = 25.0  # between a run on one section and that on the next
TRACK_SEEDS = 1000  # apart, of the tracks of sections
RUNS: tuple[tuple[str, ...], ...] = (("V0", "V2"), ("V0", "V1"), ("V1", "V2"), ("V1",))


@dataclass(frozen=True, slots=True)
class BenchSection:
    """A section, and the fleet as it runs there."""

    scenario: Scenario
    worn: bool

    @property
    def plan(self) -> SectionPlan:
        """The section."""
        return self.scenario.section


def sections_of(seed: int, *, surveyed: bool = True, drawn: bool = False) -> tuple[BenchSection, ...]:
    """Return the sections of a seed: rails as on file, worn heads, another gauge, rails as new that nobody knows.

    Args:
        seed: Of the fleet, and of what its rails are.
        drawn: Whether springs and masses of the vehicles, and the creep on each section, are off from those on file.
    """
    fleet = replace(with_seed(load_scenario(TEMPLATE), seed), drawn=None)
    if drawn:
        codes = tuple(vehicle.code for vehicle in fleet.vehicles)
        fleet = replace(fleet, vehicle_errors=VehicleErrors(seed=seed, fleet=codes))
    rng = np.random.default_rng([seed, 14])
    wear = RailWear(rng.uniform(0.3e-3, 0.7e-3), rng.uniform(-1e-3, 3e-3), rng.uniform(22e-3, 28e-3))
    gauge = float(rng.choice([-1.0, 1.0]) * rng.uniform(1e-3, 2e-3))
    rails: tuple[tuple[RailWear | None, float], ...] = ((None, 0.0), (wear, 0.0), (None, gauge), (None, 0.0))
    return tuple(
        BenchSection(on_section(fleet, place, runs, *of_rails, surveyed=surveyed), of_rails != (None, 0.0))
        for place, (runs, of_rails) in enumerate(zip(RUNS, rails, strict=True))
    )


def on_section(
    fleet: Scenario, place: int, runs: Sequence[str], wear: RailWear | None, gauge: float, *, surveyed: bool
) -> Scenario:
    """Return a fleet as it runs on one of several sections.

    Args:
        place: Number of the section, from 0.
        wear, gauge: Of its rails; m.
    """
    recipe = fleet.section.recipe
    assert recipe is not None
    section = replace(
        fleet.section,
        code=f"S{place}",
        number=fleet.section.number + place,
        name=f"Section {place}",
        recipe=replace(recipe, gauge_offset=gauge),
        rail_wear=(wear, wear),
        surveyed=surveyed,
    )
    later = KM_BETWEEN * place * 1e3
    sessions = replace(
        fleet.sessions,
        start_ns=fleet.sessions.start_ns + round(later / fleet.sessions.distance_per_day * DAY_NS),
        first_odometer=fleet.sessions.first_odometer + later,
    )
    return replace(
        fleet,
        seed=fleet.seed + TRACK_SEEDS * place,
        section=section,
        sessions=sessions,
        vehicles=tuple(one for one in fleet.vehicles if one.code in runs),
    )


def reference_wheel(scenario: Scenario, amplitude: FloatArray) -> FloatArray:
    """Return the true conicity (k,) of the wheel as designed on the rails of a section, at its gauge.

    Args:
        amplitude: (k,) m.
    """
    section = scenario.section
    assert section.recipe is not None
    left, right, inclination = rails_of(section)
    wheel = wheel_profile(scenario.vehicles[0].wheelsets[0].wheel_profile)
    gauge = section.nominal_gauge + section.recipe.gauge_offset
    wheelset = WheelsetOnTrack(wheel, wheel, left, right, inclination, gauge)
    curve = radius_difference_curve(wheelset, 0.05e-3 * np.arange(-240, 241))
    return equivalent_conicity(curve.displacement, curve.difference, amplitude)

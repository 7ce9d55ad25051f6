"""Rails that wear with the traffic over years, in the rails bench: what is found of the trend of their excess.

Two sections, one with known rails: the head of the other wears with its traffic, which is on file; the wheels wear too.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from api.comparison.trial import ESTIMATION, copied, opened, run_jobs
from bench.rails_case import received
from bench.rails_sections import KNOWN, TEMPLATE, BenchSection, on_section, reference_wheel
from estimation.contact.wear import RailWear
from estimation.jobs import refresh_rails
from estimation.jobs.settings import KnownSection, RailsSettings
from estimation.values.opinions import SECTION_RAILS
from estimation.values.quantities import Estimate
from estimation.values.units import DAY_NS
from ingest.simulator.axle_motion import section_at
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario, VehiclePlan
from ingest.simulator.scenario_file import load_scenario

CAMPAIGNS = 5
DAYS_BETWEEN = 200.0  # every campaign is in a period of its own
KM_BETWEEN = 40_000.0
TONNAGE = 30.0  # million gross tonnes a year
WHEELS_WEAR = (0.05e-11, 0.2e-11)  # depth by distance: 0.02 to 0.08 mm from one campaign to the next
RAILS_WEAR = (0.3e-3, 1.0e-3)  # m by 100 million gross tonnes
FIRST_DEPTH = 0.1e-3  # m
CENTRE = (-2e-3, -0.5e-3)  # m: bands whose growth raises the conicity; others move a contact jump, which is no trend
VEHICLES = ("V0", "V1")
Scored = dict[str, Any]


def worn_for_years(seed: int) -> tuple[BenchSection, BenchSection]:
    """Return two sections of a fleet, with campaigns over years.

    Args:
        seed: Of the fleet, and of how fast wheels and rails wear.
    """
    fleet, rng = replace(with_seed(load_scenario(TEMPLATE), seed), drawn=None), np.random.default_rng([seed, 15])
    sessions = replace(
        fleet.sessions,
        campaigns=CAMPAIGNS,
        distance_between=KM_BETWEEN * 1e3,
        distance_per_day=KM_BETWEEN * 1e3 / DAYS_BETWEEN,
    )
    fleet = replace(fleet, sessions=sessions, vehicles=tuple(_wearing(one, rng) for one in fleet.vehicles))
    wear = RailWear(FIRST_DEPTH, rng.uniform(*CENTRE), rng.uniform(22e-3, 28e-3))
    known = on_section(fleet, 0, VEHICLES, None, 0.0, surveyed=True)
    worn = on_section(fleet, 1, VEHICLES, wear, 0.0, surveyed=True)
    growing = replace(worn.section, rail_growth=rng.uniform(*RAILS_WEAR), tonnage=TONNAGE)
    return BenchSection(known, worn=False), BenchSection(replace(worn, section=growing), worn=True)


def _wearing(vehicle: VehiclePlan, rng: np.random.Generator) -> VehiclePlan:
    rates = rng.uniform(*WHEELS_WEAR, len(vehicle.wheelsets))
    wheelsets = zip(vehicle.wheelsets, rates, strict=True)
    return replace(vehicle, wheelsets=tuple(replace(one, rate_left=rate, rate_right=rate) for one, rate in wheelsets))


def score_trend(seed: int, cache: Path) -> Scored:
    """Return the trend of the section whose rails wear, beside the truth, as JSON values."""
    sections = worn_for_years(seed)
    with tempfile.TemporaryDirectory(prefix="treadwatch-rails-") as folder:
        settings = copied(received(sections, cache), Path(folder))
        with opened(settings) as (storage, context):
            known = replace(context.settings, rails=RailsSettings(_looked_at(sections[0].scenario)))
            run_jobs(replace(context, settings=known), (*ESTIMATION, refresh_rails.JOB))
            with storage.read() as unit:
                found = unit.results.latest(SECTION_RAILS, sections[1].plan.code)
    trend = None if found is None or found.value is None else found.value.trend
    if trend is None:
        return {"seed": seed, "amplitude": None}
    per_year = _true_slope(sections[1].scenario, trend.amplitude)
    return {
        "seed": seed,
        "amplitude": trend.amplitude,
        "periods": trend.periods,
        "true_per_year": per_year,
        "per_year": _interval(trend.per_year),
        "true_per_100_mgt": per_year * 100.0 / TONNAGE,
        "per_100_mgt": _interval(trend.per_100_mgt),
    }


def _looked_at(scenario: Scenario) -> frozenset[KnownSection]:
    """Return the known section with a day of every campaign: its rails are looked at again and again."""
    days = (round(campaign * DAYS_BETWEEN) * DAY_NS for campaign in range(CAMPAIGNS))
    return frozenset(KnownSection(KNOWN, scenario.sessions.start_ns + day_ns) for day_ns in days)


def _true_slope(scenario: Scenario, amplitude: float) -> float:
    """Return how fast the conicity of the wheel as designed grows on the section, 1/year, by its campaigns."""
    odometers = [scenario.odometer(campaign) for campaign in range(CAMPAIGNS)]
    rails = [replace(scenario, section=section_at(scenario, at)) for at in odometers]
    conicity = [float(reference_wheel(one, np.array([amplitude]))[0]) for one in rails]
    years = DAYS_BETWEEN / 365.25 * np.arange(CAMPAIGNS)
    return float(np.polyfit(years, conicity, 1)[0])


def _interval(one: Estimate) -> list[float | None]:
    return [one.value, one.low, one.high]

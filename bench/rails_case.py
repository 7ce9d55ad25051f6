"""One fleet of the rails bench: simulate its sections, ingest, all jobs; what is published, against the truth."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from api.comparison.trial import ESTIMATION, deploy, opened, receive, record, register, run_jobs
from api.settings import Settings
from bench.scores import AMPLITUDES, compared_at, withheld_at
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.profiles import wheel_profile
from estimation.jobs import refresh_rails
from estimation.jobs.job import JobContext
from estimation.jobs.settings import KnownSection, RailsSettings
from estimation.storage import Storage, UnitOfWork
from estimation.values.arrays import FloatArray
from estimation.values.opinions import SECTION_RAILS, WHEELSET_RAILS
from estimation.values.quantities import Estimate
from estimation.values.units import DAY_NS
from ingest.simulator.axle_motion import rails_of, section_at, truth_of, wear_at, worn_contact
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import DrawnFleet, Scenario, SectionPlan, VehicleErrors, VehiclePlan
from ingest.simulator.scenario_file import load_scenario
from ingest.simulator.section import WornRails

TEMPLATE = Path(__file__).parent / "rails_scenarios" / "sections.toml"
KNOWN = "S0"
KM_BETWEEN_SECTIONS = 25.0  # between a run on one section and that on the next
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


def sections_of(seed: int, *, drawn: bool = False) -> tuple[BenchSection, ...]:
    """Return the sections of a seed: rails as on file, worn heads, another gauge, rails as new that nobody knows."""
    fleet = replace(with_seed(load_scenario(TEMPLATE), seed), drawn=None)
    if drawn:
        codes = tuple(vehicle.code for vehicle in fleet.vehicles)
        fleet = replace(fleet, vehicle_errors=VehicleErrors(seed=seed, fleet=codes))
    rng = np.random.default_rng([seed, 14])
    depth, centre, half_width = rng.uniform(0.3e-3, 0.7e-3), rng.uniform(-1e-3, 3e-3), rng.uniform(22e-3, 28e-3)
    wear = WornRails(depth, centre=centre, half_width=half_width)
    gauge = float(rng.choice([-1.0, 1.0]) * rng.uniform(1e-3, 2e-3))
    rails: tuple[tuple[WornRails | None, float], ...] = ((None, 0.0), (wear, 0.0), (None, gauge), (None, 0.0))
    return tuple(
        BenchSection(on_section(fleet, place, runs, *of_rails), of_rails != (None, 0.0))
        for place, (runs, of_rails) in enumerate(zip(RUNS, rails, strict=True))
    )


def on_section(fleet: Scenario, place: int, runs: Sequence[str], wear: WornRails | None, gauge: float) -> Scenario:
    """Return a fleet as it runs on one of several sections."""
    recipe = fleet.section.recipe
    assert recipe is not None
    section = replace(
        fleet.section,
        code=f"S{place}",
        number=fleet.section.number + place,
        name=f"Section {place}",
        recipe=replace(recipe, gauge_offset=gauge),
        rail_wear=wear,
        surveyed=True,
    )
    later = KM_BETWEEN_SECTIONS * place * 1e3
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


ANCHORS: Mapping[str, tuple[str, ...]] = {
    "known rails": (KNOWN,),
    "none": (),
    "two measured wheels": (),
    "three measured wheels": (),
}
MEASURED: Mapping[int, tuple[str, ...]] = {  # wheelsets whose profiles are on file, and what may then hold the level
    0: ("known rails", "none"),
    2: ("two measured wheels",),
    3: ("three measured wheels",),
}
Scored = dict[str, Any]


def score(seed: int, *, drawn: bool = False) -> list[Scored]:
    """Return a score for each way to hold the level, as JSON values."""
    sections = sections_of(seed, drawn=drawn)
    found: list[Scored] = []
    with tempfile.TemporaryDirectory(prefix="treadwatch-rails-") as folder:
        settings = received(sections, Path(folder))
        for measured, anchors in MEASURED.items():
            if measured:
                register(whole_fleet(sections, measured), settings, Path(folder) / f"measured-{measured}")
            with opened(settings) as (storage, context):
                run_jobs(context, ESTIMATION)
                found += [_scored(seed, sections, anchor, storage, context) for anchor in anchors]
    return found


def _scored(seed: int, sections: Sequence[BenchSection], anchor: str, storage: Storage, context: JobContext) -> Scored:
    begin_ns = sections[0].scenario.sessions.start_ns
    known = frozenset(KnownSection(code, begin_ns) for code in ANCHORS[anchor])
    settings = replace(context.settings, rails=RailsSettings(known))
    run_jobs(replace(context, settings=settings), (refresh_rails.JOB,))
    with storage.read() as unit:
        return {"seed": seed, "anchor": anchor} | _stored(unit, sections)


def received(sections: Sequence[BenchSection], folder: Path) -> Settings:
    """Return a new deployment in a folder that has received and estimated the runs on all sections."""
    first = whole_fleet(sections)
    settings = deploy(first, folder)
    for one in sections[1:]:
        register(replace(first, section=one.plan, seed=one.scenario.seed), settings, folder / one.plan.code)
    for one in sections:
        receive(record(one.scenario, folder / "recordings", workers=1), settings)
    with opened(settings) as (_, context):
        run_jobs(context, ESTIMATION)
    return settings


def whole_fleet(sections: Sequence[BenchSection], measured: int = 0) -> Scenario:
    """Return the scenario of the first section with the vehicles of all, as the registry has them."""
    vehicles: dict[str, VehiclePlan] = {vehicle.code: vehicle for one in sections for vehicle in one.scenario.vehicles}
    drawn = DrawnFleet(pairs=(), profiles_measured=measured)
    ordered = tuple(vehicles[code] for code in sorted(vehicles))
    return replace(sections[0].scenario, vehicles=ordered, drawn=drawn if measured else None)


def _stored(unit: UnitOfWork, sections: Sequence[BenchSection]) -> Scored:
    of_sections = []
    for one in sections:
        stored, true = unit.results.latest(SECTION_RAILS, one.plan.code), reference_wheel(one.scenario, AMPLITUDES)
        found = None if stored is None else stored.value
        part = None if found is None else found.periods[-1]
        of_sections.append(
            {
                "section": one.plan.code,
                "worn": one.worn,
                "exceeded": None if found is None else found.exceeded,
                "wheel": []
                if part is None or found is None
                else compared_at(AMPLITUDES, true, np.array(found.amplitude), part.reference_wheel),
            }
        )
    wheelsets = []
    for serial, true in sorted(_true_wheels(sections).items()):
        apart, geometry = unit.results.latest(WHEELSET_RAILS, serial), unit.geometries.current(serial)
        found_wheels = None if apart is None else apart.value
        now = None if geometry is None else geometry.geometry
        wheelsets.append(
            {
                "apart": []
                if found_wheels is None
                else compared_at(AMPLITUDES, true, np.array(found_wheels.amplitude), found_wheels.part.conicity),
                "withheld": ["no_answer"] * len(AMPLITUDES)
                if found_wheels is None
                else withheld_at(AMPLITUDES, np.array(found_wheels.amplitude), found_wheels.part.conicity),
                "today": [] if now is None else compared_at(AMPLITUDES, true, now.amplitude, now.conicity),
            }
        )
    return {"sections": of_sections, "wheelsets": wheelsets}


def _true_wheels(sections: Sequence[BenchSection]) -> dict[str, FloatArray]:
    """Return by serial the true conicity (k,) on rails as on file."""
    found: dict[str, FloatArray] = {}
    known = sections[0].plan
    for plan in whole_fleet(sections).vehicles:
        for wheelset in plan.wheelsets:
            contact = worn_contact(wheelset, wear_at(wheelset, 0.0), known, np.array([0.0]), 12e-3)
            true = truth_of(contact)
            found[wheelset.serial] = np.interp(AMPLITUDES, true.amplitude, true.equivalent_conicity)
    return found


CAMPAIGNS = 5
DAYS_BETWEEN = 200.0  # every campaign is in a period of its own
KM_BETWEEN = 40_000.0
TONNAGE = 30.0  # million gross tonnes a year
WHEELS_WEAR = (0.05e-11, 0.2e-11)  # depth by distance: 0.02 to 0.08 mm from one campaign to the next
RAILS_WEAR = (0.3e-3, 1.0e-3)  # m by 100 million gross tonnes
FIRST_DEPTH = 0.1e-3  # m
CENTRE = (-2e-3, -0.5e-3)  # m: bands whose growth raises the conicity; others move a contact jump, which is no trend
VEHICLES = ("V0", "V1")


def worn_for_years(seed: int) -> tuple[BenchSection, BenchSection]:
    """Return two sections of a fleet, with campaigns over years."""
    fleet, rng = replace(with_seed(load_scenario(TEMPLATE), seed), drawn=None), np.random.default_rng([seed, 15])
    sessions = replace(
        fleet.sessions,
        campaigns=CAMPAIGNS,
        distance_between=KM_BETWEEN * 1e3,
        distance_per_day=KM_BETWEEN * 1e3 / DAYS_BETWEEN,
    )
    fleet = replace(fleet, sessions=sessions, vehicles=tuple(_wearing(one, rng) for one in fleet.vehicles))
    wear = WornRails(FIRST_DEPTH, centre=rng.uniform(*CENTRE), half_width=rng.uniform(22e-3, 28e-3))
    known = on_section(fleet, 0, VEHICLES, None, 0.0)
    worn = on_section(fleet, 1, VEHICLES, wear, 0.0)
    growing = replace(worn.section, rail_wear=replace(wear, growth=rng.uniform(*RAILS_WEAR)), tonnage=TONNAGE)
    return BenchSection(known, worn=False), BenchSection(replace(worn, section=growing), worn=True)


def _wearing(vehicle: VehiclePlan, rng: np.random.Generator) -> VehiclePlan:
    rates = rng.uniform(*WHEELS_WEAR, len(vehicle.wheelsets))
    wheelsets = zip(vehicle.wheelsets, rates, strict=True)
    return replace(vehicle, wheelsets=tuple(replace(one, rate_left=rate, rate_right=rate) for one, rate in wheelsets))


def score_trend(seed: int) -> Scored:
    """Return the trend of the section whose rails wear, beside the truth, as JSON values."""
    sections = worn_for_years(seed)
    with tempfile.TemporaryDirectory(prefix="treadwatch-rails-") as folder:
        settings = received(sections, Path(folder))
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

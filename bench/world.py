"""Other people's track and fleets: ``python -m bench world [--seeds 0-2] [--rows known_line,...] ...``.

Every row is a scenario file in ``bench/world_scenarios``; every seed of it is simulated, ingested and estimated by the
scheduled jobs (``fleet_case``). With ``--measured FOLDER`` two rows have the measured wheels of that folder
(``world_measured``).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from pathlib import Path

import numpy as np

from bench.conicities import Conicities, Reach, by_row, published_of
from bench.coverage import Verdict, verdict_of
from bench.fleet_case import cases_of, fleet_options, scored, summary_line
from bench.report import Columns, ResultTable, say
from bench.scores import AMPLITUDES
from bench.study import Case, Key, Study
from bench.wheelset_motion import wheelset_motion
from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table, radius_difference_curve
from estimation.errors import ContactError, ProfileError, ScenarioError
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.axle_motion import DerailmentError, contact_of, rails_of, wheel_in
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.drawn_fleet import with_seed, with_wheelset
from ingest.simulator.scenario import Scenario, SectionPlan, Stream, generator
from ingest.simulator.scenario_file import load_scenario
from ingest.simulator.track import TrackTruth

MEASURED_ROWS = ("measured_known", "measured_unknown")
PARTNERS = 3  # other wheels with which each one runs
DISPLACEMENT = np.arange(-240, 241) * 0.05e-3  # m
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


SCENARIOS = Path(__file__).parent / "world_scenarios"
SURVEY_RIGHT = "survey_confirmed"


WRONG = ("survey_unrelated",)
ROWS: Mapping[str, Reach] = {
    "known_alike": Reach(p95=0.015),
    "known_alike_gauge": Reach(p95=0.02),
    "known_wide_gauge": Reach(p95=0.02),
    "known_line_alike": Reach(p95=0.02),
    "known_line": Reach(p95=0.015),
    "known_diverse_gauge": Reach(p95=0.02),
    "survey_shifted": Reach(covers_above=True),
    "survey_scaled": Reach(covers_above=True),
    "survey_mirrored": Reach(covers_above=True),
    "survey_of_another_section": Reach(covers_above=True),
    "gauge_of_another_section": Reach(covers_above=True),
    "gauge_scaled": Reach(covers_above=True),
    "unknown_long_gauge": Reach(p95=0.05),
    "unknown_alike_02": Reach(covers_above=True),
    "unknown_alike_05": Reach(covers_above=True),
    "unknown_alike_08": Reach(covers_above=True),
    "measured_known": Reach(p95=0.01),
    "measured_unknown": Reach(p95=0.02),
}
SURVEYS: Mapping[str, tuple[str, ...]] = {  # verdicts that are right; of other known track it is confirmed
    "survey_shifted": ("survey_displaced",),
    "survey_scaled": ("survey_unit", *WRONG),
    "survey_mirrored": ("survey_mirrored", *WRONG),
    "survey_of_another_section": WRONG,
    "gauge_of_another_section": ("survey_gauge_unrelated",),
    "gauge_scaled": ("survey_gauge_unit",),
}


def right_verdicts(row: str) -> tuple[str, ...]:
    """Return the verdicts on the survey that are right; none where no survey is on file."""
    return SURVEYS.get(row, () if row.endswith("unknown") or row.startswith(UNKNOWN) else (SURVEY_RIGHT,))


WIDTH_TITLE = "Intervals of the conicity against the diversity of the fleet, rows on unknown track"
DIVERSITIES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, math.inf)  # limits of the lines
UNKNOWN = "unknown"  # how the names of the rows on unknown track begin


def run_case(row: str, seed: int, wheels: tuple[WheelPair, ...] = ()) -> Case:
    """Return the score of a row for one seed; with measured wheels also which of them cannot run in it."""
    scenario, left_out = scenario_of(row, seed, wheels)
    return scored(scenario) | {"left_out": left_out}


def scenario_of(row: str, seed: int, wheels: tuple[WheelPair, ...] = ()) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario of a row for one seed, and the measured wheelsets that cannot run in it."""
    scenario = with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed)
    return with_wheels(scenario, wheels) if row in MEASURED_ROWS else (scenario, ())


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case | None]:
    rows = [row for row in options.rows if row not in MEASURED_ROWS or options.measured is not None]
    if options.measured is None and not rows:
        raise SystemExit(f"{', '.join(MEASURED_ROWS)} need --measured")
    for case in cases_of(partial(run_case, wheels=_measured_wheels(options.measured)), options, done, rows):
        for line in () if case is None else case["left_out"]:
            say(f"  left out: {line}")
        yield case


def _measured_wheels(folder: Path | None) -> tuple[WheelPair, ...]:
    """Return the wheelsets of the rows with measured wheels, and print what is left out."""
    if folder is None:
        return ()
    template = load_scenario(SCENARIOS / f"{MEASURED_ROWS[0]}.toml")
    found = measured_wheels(folder, with_seed(template, 0).section)
    for line in (f"{len(found.pairs)} wheelsets of measured wheels", *(f"left out: {one}" for one in found.left_out)):
        say(line)
    return found.pairs


def _right(name: str, cases: Sequence[Case]) -> int:
    return sum(case["survey"] in right_verdicts(name) for case in cases)


def _met(name: str, cases: Sequence[Case]) -> Verdict:
    survey = verdict_of(not right_verdicts(name) or _right(name, cases) == len(cases))
    return Verdict.all([survey, ROWS[name].verdict(cases)])


def _without_intervals(cases: Sequence[Case]) -> str:
    """Return how many fleets have no published conicity."""
    return str(sum(Conicities.of([case]).published == 0 for case in cases))


COLUMNS: Columns = {
    "row": lambda name, _: name,
    "seeds": lambda _, cases: str(len(cases)),
    "nothing published": lambda _, cases: _without_intervals(cases),
    "survey right": lambda name, cases: f"{_right(name, cases)} of {len(cases)}" if right_verdicts(name) else "",
    "error: median / 95 %": lambda _, cases: Conicities.of(cases).error,
    "covers": lambda _, cases: Conicities.of(cases).cover,
    "half width": lambda _, cases: Conicities.of(cases).width,
    "diversity": lambda _, cases: f"{np.median([case['diversity'] for case in cases]):.2f}",
    "reach": lambda name, _: str(ROWS[name]),
    "met": lambda name, cases: str(_met(name, cases)),
}
WIDTH_COLUMNS: Columns = {
    "diversity": lambda name, _: name,
    "fleets": COLUMNS["seeds"],
    "nothing published": COLUMNS["nothing published"],
    "covers": COLUMNS["covers"],
    "half width: median": COLUMNS["half width"],
    "error: median": lambda _, cases: _median(Conicities.of(cases).errors),
}


def _median(errors: Sequence[float]) -> str:
    return f"{np.median(errors):.4f}" if errors else ""


def _by_diversity(cases: Sequence[Case]) -> list[tuple[str, list[Case]]]:
    """Return the fleets on unknown track by range of diversity; the unsolved last."""
    unknown = [case for case in cases if case["row"].startswith(UNKNOWN)]
    lines = [
        (
            f"{low:g} to {high:g}" if math.isfinite(high) else f"above {low:g}",
            [case for case in unknown if low < case["diversity"] <= high],
        )
        for low, high in pairwise(DIVERSITIES)
    ]
    lines.append(("none", [case for case in unknown if not case["diversity"] > 0.0]))
    return [(name, within) for name, within in lines if within]


def tables(cases: Sequence[Case]) -> list[ResultTable]:
    """Return the tables; that of the intervals where there are fleets on unknown track."""
    found = [ResultTable.of(COLUMNS, by_row(cases, ROWS).items(), range(1, len(COLUMNS) - 2))]
    widths = _by_diversity(cases)
    if widths:
        found.append(ResultTable.of(WIDTH_COLUMNS, widths, range(1, len(WIDTH_COLUMNS)), WIDTH_TITLE))
    return found


def _options(parser: argparse.ArgumentParser) -> None:
    fleet_options(parser)
    parser.add_argument("--measured", type=Path, default=None, help="folder of measured wheels, for two rows more")


main = Study(
    name="world",
    title="Other track and other fleets",
    about=__doc__ or "",
    cases=_cases,
    parts=tables,
    line=summary_line,
    published=published_of,
    rows=ROWS,
    options=_options,
).run

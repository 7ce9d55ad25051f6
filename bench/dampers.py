"""Lateral dampers: ``python -m bench dampers [--seeds 0-4] [--rows "coach"] [--write-docs]``.

Every seed is a vehicle off its class, with dampers of a known share. The motion is the simulator's, the sensors its
nodes (``adhesion_fleet``). Every parameter that the class states with a standard deviation is drawn by that, each by
itself; the class on file stays.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bench.adhesion_fleet import class_of, simulate
from bench.coverage import Coverage
from bench.report import BenchRow, Part, ResultTable, row_table
from bench.scores import Cluster
from bench.study import Case, Key, Study
from estimation.adhesion.creep_forces import gear_segments
from estimation.dampers.damper import DamperParameters, gear_damper, window_damper
from estimation.motion.integration import SignalParameters
from estimation.values.arrays import FloatArray
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import (
    AXLES_OF_A_BOGIE,
    BogieParameters,
    ClassOnFile,
    VehicleClass,
    VehicleParameters,
)
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario, WeakDamper
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"
ROWS: Mapping[str, str] = {
    "soft bogie": "soft_known",
    "soft bogie, axle boxes vibrate": "vibration_5",
    "soft bogie, all faults of sensors and track": "all_faults",
    "coach": "coach_known",
    "single wheelset": "paper_known",
}
SHARES = (1.0, 0.5, 0.2)
CAMPAIGNS = 4
CAMPAIGN_S = 120.0
DRAWN = ("_mass", "_inertia", "_stiffness", "_damping")
P = TypeVar("P", VehicleParameters, BogieParameters)


def _reversed(window: Window) -> Window:
    return replace(window, mass_lateral_acceleration=-window.mass_lateral_acceleration) if window.axle % 2 else window


def _dead(window: Window) -> Window:
    dead = replace(window, mass_lateral_acceleration=0.0 * window.mass_lateral_acceleration)
    return dead if window.axle % 2 else window


def _late(window: Window) -> Window:
    return replace(window, mass_lateral_acceleration=np.roll(window.mass_lateral_acceleration, 2))


BAD: Mapping[str, Callable[[Window], Window]] = {
    "sensor above reversed": _reversed,
    "sensor above dead": _dead,
    "sensors above 8 ms late": _late,
}
OTHER_CLASS = "judged as the coach"


@dataclass(frozen=True, slots=True)
class DamperScore:
    """One running gear; None where nothing is published."""

    row: str
    bad: str  # what is wrong with the input; empty for nothing
    seed: int
    share: float  # true
    value: float | None
    low: float | None
    high: float | None
    weak: bool | None
    reason: str
    windows: int
    cpu_s: float  # of what windows say
    running_s: float  # of wheelsets


def scores(row: str, seed: int, share: float) -> Iterator[DamperScore]:
    """Yield the scores of the running gears of one vehicle."""
    on_file = _scenario(row, seed, share)
    vehicle_class = class_of(on_file)
    windows = [one.window for one in simulate(_off_its_class(on_file, vehicle_class, seed)).windows]
    yield from _judged((row, "", seed, share), windows, vehicle_class)
    if row != next(iter(ROWS)) or share != SHARES[0]:
        return
    for bad, spoilt in BAD.items():
        yield from _judged((row, bad, seed, share), [spoilt(window) for window in windows], vehicle_class)
    yield from _judged((row, OTHER_CLASS, seed, share), windows, class_of(_scenario("coach", seed, share)))


def _scenario(row: str, seed: int, share: float) -> Scenario:
    scenario = with_seed(load_scenario(SCENARIOS / f"{ROWS[row]}.toml"), seed)
    first = replace(scenario.vehicles[0], weak_damper=WeakDamper(share))
    sessions = replace(scenario.sessions, campaigns=CAMPAIGNS, duration=CAMPAIGN_S)
    return replace(scenario, vehicles=(first,), sessions=sessions)


def _off_its_class(scenario: Scenario, vehicle_class: VehicleClass, seed: int) -> Scenario:
    """Return the scenario with its vehicle drawn; dampers that are looked for have the share on file exactly."""
    rng = np.random.default_rng((seed, 7))
    bogie, looked_for = scenario.bogie, "lateral_damping"
    if bogie is not None:
        looked_for = "secondary_lateral_damping"
        bogie = _drawn(bogie, vehicle_class, looked_for, rng)
    parameters = _drawn(scenario.parameters, vehicle_class, looked_for, rng)
    return replace(scenario, parameters=parameters, bogie=bogie, vehicle_errors=None)


def _drawn(given: P, vehicle_class: VehicleClass, looked_for: str, rng: np.random.Generator) -> P:
    drawn = {
        item.name: getattr(given, item.name) * (1.0 + vehicle_class.std_of(item.name) * rng.standard_normal())
        for item in fields(given)
        if item.name.endswith(DRAWN) and item.name != looked_for
    }
    return replace(given, **drawn)


def _judged(
    of: tuple[str, str, int, float], windows: Sequence[Window], vehicle_class: VehicleClass
) -> Iterator[DamperScore]:
    gears: dict[int, dict[int, list[Window]]] = defaultdict(lambda: defaultdict(list))
    for window in windows:
        gear = (window.axle - 1) // AXLES_OF_A_BOGIE if vehicle_class.bogie is not None else window.axle
        gears[gear][window.start_ns].append(window)
    on_file = ClassOnFile(vehicle_class, 0)
    for times in gears.values():
        began = time.process_time()
        found = [
            window_damper(gear[0], "", gear_segments(gear, vehicle_class, SignalParameters()), on_file)
            for gear in times.values()
        ]
        spent = time.process_time() - began
        damper = gear_damper(found, DamperParameters())
        share = damper.share
        running = sum(1e-9 * window.length_ns for gear in times.values() for window in gear)
        reason = "" if share.reason is None else str(share.reason.code)
        value = (share.value, share.low, share.high, damper.weak)
        yield DamperScore(*of, *value, reason, damper.windows, spent, running)


def errors_of(found: Sequence[Mapping[str, float]]) -> FloatArray:
    """Return the errors (n,) of published shares."""
    return np.array([one["value"] - one["share"] for one in found])


TITLE = "Lateral dampers"
HEADER = ("vehicle", "share", "gears", "published", "rms error", "95 % of errors", "intervals cover", "found weak")


def bench_rows(found: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield what was to be reached."""
    good = [one for one in found if not one["bad"]]
    published = [one for one in good if one["value"] is not None]
    covered = defaultdict[tuple[Any, ...], list[bool]](list)
    for one in published:
        covered[one["row"], one["seed"], one["share"]].append(one["low"] <= one["share"] <= one["high"])
    weak, whole = ([one for one in good if one["share"] == share] for share in (SHARES[-1], SHARES[0]))
    hits, false = sum(one["weak"] is True for one in weak), sum(one["weak"] is True for one in whole)
    yield BenchRow("dampers with a share of 0.2 found weak", f"{hits} of {len(weak)}", "95 %", hits >= 0.95 * len(weak))
    yield BenchRow("whole dampers found weak", f"{false} of {len(whole)}", "0", not false)
    cover = Coverage.of([(len(of_vehicle), sum(of_vehicle)) for of_vehicle in covered.values()])
    yield BenchRow("intervals cover", f"{cover} of {len(published)}", "92-98 %", cover.verdict())
    refused = sum(one["value"] is None for one in found if one["bad"])
    bad = sum(bool(one["bad"]) for one in found)
    yield BenchRow("bad input without a number", f"{refused} of {bad}", "all", refused == bad)
    cpu, running = (sum(one[name] for one in good) for name in ("cpu_s", "running_s"))
    factor = running / max(cpu, 1e-9)
    yield BenchRow("real-time factor per wheelset and core", f"{factor:,.0f}", "1,000", factor >= 1000.0)


def table(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return the rows of good input, by vehicle and share."""
    rows = []
    for row in ROWS:
        for share in SHARES:
            own = [one for one in found if (one["row"], one["share"], one["bad"]) == (row, share, "")]
            if own:
                rows.append((row, f"{share:g}", *_cells(own)))
    return rows


def _cells(own: Sequence[Case]) -> tuple[str, ...]:
    published = [one for one in own if one["value"] is not None]
    weak = f"{sum(one['weak'] is True for one in own)}"
    if not published:
        return str(len(own)), "0", "", "", "", weak
    errors = errors_of(published)
    covered = sum(one["low"] <= one["share"] <= one["high"] for one in published)
    rms, largest = float(np.sqrt(np.mean(errors**2))), float(np.quantile(np.abs(errors), 0.95))
    return str(len(own)), str(len(published)), f"{rms:.3f}", f"{largest:.3f}", f"{covered} of {len(published)}", weak


def bad_table(found: Sequence[Case]) -> list[tuple[str, str, str, str]]:
    """Return the rows of bad input."""
    rows = []
    for bad in (*BAD, OTHER_CLASS):
        own = [one for one in found if one["bad"] == bad]
        codes = Counter(one["reason"] for one in own if one["reason"])
        published = sum(one["value"] is not None for one in own)
        rows.append((bad, str(len(own)), str(published), ", ".join(f"`{code}` {n}" for code, n in codes.most_common())))
    return rows


def parts(found: Sequence[Case]) -> list[Part]:
    """Return the page of results."""
    seeds = sorted({one["seed"] for one in found})
    refused = Counter(one["reason"] for one in found if not one["bad"] and one["reason"])
    reasons = ", ".join(f"`{code}` {count}" for code, count in refused.most_common()) or "none"
    head = (
        f"Seeds {', '.join(map(str, seeds))}: each vehicle has masses, springs and other dampers drawn by the standard"
        " deviations of its class, and 8 windows of 60 s. The share is that of the damping on file which is left."
    )
    return [
        head,
        row_table(bench_rows(found)),
        ResultTable(HEADER, table(found), range(1, 8)),
        f"Refused with good input: {reasons}.",
        "Bad input, of whole dampers:",
        ResultTable(("input", "gears", "published", "refused"), bad_table(found), (1, 2)),
    ]


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for seed, row, share in product(options.seeds, options.rows, SHARES):
        if (row, seed, share) not in done:
            yield {"row": row, "seed": seed, "share": share, "gears": [asdict(one) for one in scores(row, seed, share)]}


def _published(case: Case) -> Cluster:
    """Return the shares of the running gears of a vehicle with good input, which share what it is off its class."""
    good = [gear for gear in case["gears"] if not gear["bad"]]
    numbers = [
        (one["value"] - one["share"], 0.5 * (one["high"] - one["low"]), one["low"] <= one["share"] <= one["high"])
        for one in good
        if one["value"] is not None
    ]
    return Cluster.read(numbers, [one["reason"] for one in good if one["value"] is None])


main = Study(
    name="dampers",
    title="Lateral dampers",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: parts([gear for case in cases for gear in case["gears"]]),
    line=lambda case: f"{case['row']}, seed {case['seed']}, share {case['share']}: done",
    published=_published,
    rows=ROWS,
    separator=";",
    seeds="0-4",
    key=("row", "seed", "share"),
).run

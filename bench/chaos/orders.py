"""Windows of a small fleet stored in any order and in any pieces, with the jobs run in between: one final state."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from api.comparison.trial import copied, deploy, opened, receive, record
from api.settings import Settings
from bench.chaos.final_state import OF_HISTORY, final_state
from bench.chaos.part import ChaosSettings
from bench.report import BenchRow
from estimation.errors import TreadwatchError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import JobContext, run_job
from estimation.values.runs import JobTrigger
from estimation.values.windows import Window
from fleet_db.storage import SqlStorage
from ingest.simulator.scenario_file import read_scenario

FLEET = """\
name = "ORDERS"
description = "two vehicles of three wheelsets, three campaigns of 40 days"
seed = 5
[fleet]
code = "O"
name = "Fleet O"
[section]
code = "O-1"
number = 1
name = "Section O-1"
length_m = 2400.0
surveyed = {surveyed}
[speed]
lowest_m_s = 14.0
highest_m_s = 22.0
[sensors]
kind = "mems"
[bus]
recorder_clock_offset_s = 1.5
[position]
largest_offset_m = {offset}
largest_scale_percent = 0.1
[sessions]
start = 2024-01-08T05:30:00Z
campaigns = 3
minutes_each = 1.55
first_odometer_km = 1000.0
km_between = 20000.0
km_per_day = 500.0
start_within_m = 150.0
"""
VEHICLE = """\
[[vehicles]]
code = "O-{name}"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [2.0, 4.5, 16.5]
"""
WHEELSET = """\
[[vehicles.wheelsets]]
serial = "O-{name}{axle}"
initial_wear_mm = {worn}
wear_mm_per_100000_km = {wear}
"""
WORN = {"A": ((0.1, 0.9), (0.9, 0.4), (0.5, 0.2)), "B": ((1.2, 1.0), (0.3, 0.1), (0.7, 0.6))}
WINDOW_S = 30
MOST_RUNS = 8
"""Runs of all jobs after which they must have come to rest."""


@dataclass(frozen=True, slots=True)
class _Case:
    """A deployment without windows, and the windows that it is to get, each with its mileage, by time."""

    name: str
    settings: Settings
    windows: Sequence[tuple[Window, float]]


@dataclass(frozen=True, slots=True)
class _Played:
    state: Mapping[str, str]
    epochs: int  # computed
    rest: bool


def _case(settings: ChaosSettings, *, surveyed: bool) -> _Case:
    """Return the windows of simulated recordings, and a deployment whose registry knows their fleet."""
    name = "surveyed" if surveyed else "unsurveyed"
    folder = settings.folder / name
    folder.mkdir()
    parts = [FLEET.format(surveyed=str(surveyed).lower(), offset=3.0 if surveyed else 20.0)]
    for code, wheelsets in WORN.items():
        parts.append(VEHICLE.format(name=code))
        parts += [WHEELSET.format(name=code, axle=i, worn=a, wear=b) for i, (a, b) in enumerate(wheelsets, start=1)]
    file = folder / "scenario.toml"
    file.write_text("".join(parts), encoding="utf-8")
    scenario = read_scenario(file)
    recorded = record(scenario, folder / "recordings", workers=1)
    empty = deploy(scenario, folder / "empty").model_copy(update={"window_length_s": WINDOW_S})
    full = copied(empty, folder / "full")
    receive(recorded, full)
    with opened(full) as (storage, _), storage.read() as unit:
        records = [one for wheelset in unit.registry.wheelsets() for one in unit.windows.list(wheelset.serial)]
        ordered = sorted(records, key=lambda one: (one.start_ns, one.wheelset))
        windows = [(unit.windows.load(one.wheelset, one.start_ns), one.mileage_km) for one in ordered]
    return _Case(name, empty, windows)


def _play(case: _Case, folder: Path, pieces: Sequence[Sequence[tuple[Window, float]]]) -> _Played:
    """Return the state after the pieces have been stored one after the other, the jobs run after each."""
    with opened(copied(case.settings, folder)) as (storage, context):
        epochs = 0
        for piece in pieces:
            with storage.write() as unit:
                for window, mileage_km in piece:
                    unit.windows.put(window, mileage_km, context.clock.now_ns())
            epochs += _run(context)
        runs = 0
        while (changed := _digest(storage)) and runs < MOST_RUNS:
            epochs += _run(context)
            runs += 1
            if _digest(storage) == changed:
                break
        state = {name: digest for name, digest in final_state(storage).items() if name not in OF_HISTORY}
        return _Played(state, epochs, runs < MOST_RUNS)


def _run(context: JobContext) -> int:
    """Run all jobs once; return how many epochs were computed."""
    epochs = 0
    for job in ALL_JOBS:
        done = run_job(job, context, JobTrigger.CLI)
        if done.error is not None:
            raise TreadwatchError(f"job {job.name} failed: {done.error}")
        epochs += done.counts.get("epochs", 0)
    return epochs


def _digest(storage: SqlStorage) -> str:
    return repr(sorted(final_state(storage).items()))


def _pieces(case: _Case, rng: random.Random, *, late: bool) -> list[list[tuple[Window, float]]]:
    """Return the windows in another order, cut somewhere; where ``late``, some of them come after all others."""
    order = list(case.windows)
    if late:
        held = set(rng.sample(range(len(order)), rng.randint(1, len(order) // 2)))
        order = [one for i, one in enumerate(order) if i not in held] + [order[i] for i in sorted(held)]
    else:
        rng.shuffle(order)
    cuts = sorted(rng.sample(range(1, len(order)), rng.randint(1, 4)))
    return [order[a:b] for a, b in zip([0, *cuts], [*cuts, len(order)], strict=True)]


def _by_campaign(case: _Case) -> list[list[tuple[Window, float]]]:
    pieces: list[list[tuple[Window, float]]] = []
    for window, mileage_km in case.windows:
        if not pieces or window.start_ns - pieces[-1][-1][0].start_ns > 3600 * 10**9:
            pieces.append([])
        pieces[-1].append((window, mileage_km))
    return pieces


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield how many final states there are, and how many epochs were computed for data that came in order.

    Args:
        settings: Rounds are shared by the surveyed and the unsurveyed fleet.
    """
    for surveyed in (False, True):
        case = _case(settings, surveyed=surveyed)
        campaigns = _by_campaign(case)
        at_once = _play(case, settings.folder / f"{case.name}-once", [list(case.windows)])
        in_order = _play(case, settings.folder / f"{case.name}-order", campaigns)
        measured = f"{in_order.epochs} for {len(campaigns)} campaigns"
        yield BenchRow(
            f"{case.name}: epochs computed for data in order", measured, "one each", in_order.epochs <= len(campaigns)
        )
        rng = random.Random(settings.seed)  # noqa: S311 - of orders
        played = [at_once, in_order]
        for number in range(settings.size // 2):
            pieces = _pieces(case, rng, late=number % 2 == 1)
            played.append(_play(case, settings.folder / f"{case.name}-{number}", pieces))
        states = Counter(repr(sorted(one.state.items())) for one in played)
        differ = sorted({name for one in played for name in one.state if one.state[name] != at_once.state[name]})
        measured = f"{len(states)} of {len(played)} rounds" + (f"; {', '.join(differ)}" if differ else "")
        yield BenchRow(f"{case.name}: final states", measured, "1", len(states) == 1)
        at_rest = sum(one.rest for one in played)
        yield BenchRow(
            f"{case.name}: rounds whose jobs came to rest",
            f"{at_rest} of {len(played)}",
            "all",
            at_rest == len(played),
        )

"""Many workers, killed, stopped and cut off from the database while they work: nothing lost, nothing doubled."""

from __future__ import annotations

import random
import shutil
import signal
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field

from api.comparison.trial import Recorded, receive
from api.factory import open_store, raw_store
from api.pipeline import job_context
from bench.chaos.part import ChaosSettings
from bench.chaos.small_deployment import PASSWORD
from bench.chaos.worker_faults import HERE, ON_DASK, ON_SERVER, Strike
from bench.chaos.worker_fleet import WorkerFleet, come_to_rest, compared_state, stored_twice, worker_fleet
from bench.chaos.worker_services import DASK_WORKERS, PROCESSES, services
from bench.report import BenchRow
from fleet_db.keeping.checks import check_deep
from fleet_db.storage import SqlStorage
from tests.postgres_server import SAFE, stoppable_server

VEHICLES, CAMPAIGNS = 2, 4
AT_REST_S = 300.0
LOOK_S = 0.5
SHORT = 3
"""Faults up to which the run is short: a small fleet, and no workers of Dask, which tests of their own harm."""


@dataclass(frozen=True, slots=True)
class _Half:
    """Workers of one kind on one database, and what happens to them."""

    name: str
    fleet: WorkerFleet
    faults: Sequence[Strike]
    dask: bool


@dataclass
class _Tally:
    """What the rounds of one half came to."""

    faults: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    twice: int = 0
    states: set[tuple[tuple[str, str], ...]] = field(default_factory=set)
    set_aside: int = 0
    rest_s: list[float] = field(default_factory=list)
    leaked: int = 0


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield for each kind of workers what faults did to their results.

    Args:
        settings: ``size`` is the number of faults, of all kinds of workers together.
    """
    rng = random.Random(settings.seed)  # noqa: S311 - drawn moments, not secrets
    short = settings.size <= SHORT
    extent = (1, 2) if short else (VEHICLES, CAMPAIGNS)
    with stoppable_server(SAFE) as server:
        on_server = worker_fleet(settings.folder, *extent, server.url)
        halves = [_Half(f"{PROCESSES} processes, postgresql", on_server, ON_SERVER, dask=False)]
        if not short:
            halves.insert(0, _Half(f"{DASK_WORKERS} Dask workers, postgresql", on_server, ON_DASK, dask=True))
            embedded = worker_fleet(settings.folder, *extent)
            halves.append(_Half(f"{PROCESSES} processes, sqlite", embedded, HERE, dask=False))
        for number, half in enumerate(halves):
            faults = (settings.size + number) // len(halves)
            yield from _harmed(half, settings, rng, faults)


def _harmed(half: _Half, settings: ChaosSettings, rng: random.Random, faults: int) -> Iterator[BenchRow]:
    tally, order = _Tally(), [half.faults[n % len(half.faults)] for n in range(faults)]
    rng.shuffle(order)
    while order:
        left = len(order)
        _round(half, settings, rng, tally, order)
        if len(order) == left:
            raise RuntimeError(f"{half.name}: nobody was at work for {order[-1].__name__}")
    named = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in sorted(tally.faults.items()))
    what = f"{half.name}, {tally.faults.total()} faults ({named})"
    measured = f"{len(tally.wrong)} {', '.join(sorted(set(tally.wrong)))[:300]}".strip()
    met = not tally.wrong and tally.twice == 0 and len(tally.states) == 1
    yield BenchRow(
        f"{what}: lost or other than undisturbed; tables stored twice; final states",
        f"{measured}; {tally.twice}; {len(tally.states)}",
        "0; 0; 1",
        met,
    )
    worst = max(tally.rest_s)
    what = f"{half.name}: until all is done by itself after the last fault, longest"
    yield BenchRow(what, f"{worst:.1f} s", f"< {AT_REST_S:g} s", worst < AT_REST_S)
    what = f"{half.name}: set aside after three ends, and done when they were tried again"
    yield BenchRow(what, str(tally.set_aside), "any", met=True)
    yield BenchRow(f"{half.name}: password in the logs", str(tally.leaked), "0", tally.leaked == 0)


def _round(half: _Half, settings: ChaosSettings, rng: random.Random, tally: _Tally, order: list[Strike]) -> None:
    """Let recordings come in, with a fault after each, and compare the state at rest; faults done leave ``order``."""
    folder = settings.folder / "round"
    deployed = half.fleet.copy(folder)
    undisturbed = half.fleet.undisturbed
    with closing(open_store(deployed)) as storage:
        with services(storage, deployed, folder, dask=half.dask) as running:
            for recording in half.fleet.recordings:
                receive(Recorded((recording,), recording[1]), deployed)
                if order and order[-1](running, rng):
                    tally.faults[order.pop().__name__] += 1
            begin_s = time.monotonic()
            while compared_state(storage) != undisturbed and time.monotonic() - begin_s < AT_REST_S:
                _try_again(storage, tally)
                time.sleep(LOOK_S)
            tally.rest_s.append(time.monotonic() - begin_s)
            running.end_scheduler(signal.SIGTERM)
            tally.leaked += running.said().count(PASSWORD)
        come_to_rest(storage, job_context(deployed, storage))
        state = compared_state(storage)
        tally.states.add(tuple(sorted(state.items())))
        tally.wrong += [name for name in state if state[name] != undisturbed[name]]
        tally.wrong += [
            str(one)
            for one in check_deep(storage, raw_store(deployed), lambda _done, _total: None).findings
            if not one.harmless
        ]
        tally.twice += stored_twice(storage)
    shutil.rmtree(folder)


def _try_again(storage: SqlStorage, tally: _Tally) -> None:
    """Let what was set aside be tried again, as whoever looks at the quarantine does."""
    with storage.write() as unit:
        tally.set_aside += sum(one.due_ns > one.last_ns for one in unit.quarantine.retry())

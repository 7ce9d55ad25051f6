"""Many workers, killed, stopped and cut off from the database while they work: nothing lost, nothing doubled."""

from __future__ import annotations

import os
import random
import shutil
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from sqlalchemy import text

from api.comparison.trial import Recorded, opened, receive
from api.factory import open_store
from api.pipeline import job_context
from bench.chaos.final_state import come_to_rest, compared_state
from bench.chaos.run import ChaosSettings
from bench.chaos.small_deployment import PASSWORD, damaged
from bench.chaos.worker_services import DASK_WORKERS, LEASE_S, PROCESSES, Cut, Services, services
from bench.report import BenchRow
from bench.small_fleets import FOUR_AXLES, Workload, cars, deployed, small_fleet
from fleet_db.storage import SqlStorage
from tests.postgres_server import SAFE, stoppable_server

WINDOW_S = 10.0
STORED = "chaos_stored_tables"
NOTED = (
    "NEW.wheelset || '@' || NEW.start_ns || ' ' || NEW.window_digest || ' ' || NEW.parameter_key || ' ' ||"
    " COALESCE(NEW.track_version, 0) || ' ' || NEW.content_digest"
)
NOTE = f"INSERT INTO {STORED} VALUES ({NOTED});"  # noqa: S608 - our own words
TRIGGER = f"CREATE TRIGGER {STORED}_noted BEFORE INSERT ON window_bin_tables"
FUNCTION = f"CREATE FUNCTION {STORED}_note() RETURNS trigger LANGUAGE plpgsql"
COUNTED = {
    "sqlite": (f"{TRIGGER} BEGIN {NOTE} END",),
    "postgresql": (
        f"{FUNCTION} AS $$ BEGIN {NOTE} RETURN NEW; END $$",
        f"{TRIGGER} FOR EACH ROW EXECUTE FUNCTION {STORED}_note()",
    ),
}
"""Notes each table that is stored in the same transaction; also where the same one is there already."""
TIMES = f"SELECT COUNT(*) AS times FROM {STORED} GROUP BY what"  # noqa: S608 - the same
DOUBLED = f"SELECT COALESCE(SUM(times - 1), 0) FROM ({TIMES}) AS each_one"  # noqa: S608 - the same


@dataclass(frozen=True, slots=True)
class WorkerFleet:
    """Recordings by time, a deployment that has received none of them, and what they come to undisturbed."""

    load: Workload
    undisturbed: Mapping[str, str]


def worker_fleet(folder: Path, vehicles: int, campaigns: int, server: str | None = None) -> WorkerFleet:
    """Return the fleet, with what one process makes of its recordings when nobody disturbs it.

    The server is PostgreSQL's; None for SQLite.
    """
    scenario = small_fleet(
        "W", cars(vehicles, wear=0.8), FOUR_AXLES, 2.0, campaigns=campaigns, surveyed=False, seed=11,
        km_between=20_000.0, position_m=3.0,
    )  # fmt: skip
    load = deployed(folder, scenario, server, PASSWORD, workers=1)
    load = replace(load, received=load.received.model_copy(update={"window_length_s": WINDOW_S}))
    with closing(open_store(load.received)) as storage, storage.write() as unit:
        unit.connection.execute(text(f"CREATE TABLE {STORED} (what TEXT NOT NULL)"))
        for statement in COUNTED[unit.connection.dialect.name]:
            unit.connection.execute(text(statement))
    alone = load.copy(load.received.data_dir.parent / "undisturbed")
    receive(load.recorded, alone)
    with opened(alone) as (storage, context):
        _, rest = come_to_rest(storage, context)
        assert rest
        return WorkerFleet(load, compared_state(storage))


def stored_twice(storage: SqlStorage) -> int:
    """Return how many tables of windows were stored although the same one had been."""
    with storage.read() as unit:
        return int(unit.connection.execute(text(DOUBLED)).scalar_one())


Strike = Callable[[Services, int, random.Random], bool]
"""Does harm to a process that is at work, or to others while it is, and mends it; returns whether it was any."""
LONGEST_DELAY_S = 0.3
"""Between the moment at which somebody is seen at work, and the harm, s."""


def killed(_services: Services, pid: int, _rng: random.Random) -> bool:
    """Kill a worker."""
    return _signal([pid], signal.SIGKILL)


def stood_still(_services: Services, pid: int, rng: random.Random) -> bool:
    """Stop a worker for longer than its lease, and wake it."""
    _signal([pid], signal.SIGSTOP)
    time.sleep(LEASE_S * rng.uniform(1.2, 2.5))
    return _signal([pid], signal.SIGCONT)


def all_stood_still(services: Services, _pid: int, rng: random.Random) -> bool:
    """Stop the scheduler with all its workers for longer than their leases, as a machine that is suspended."""
    family = services.family()
    _signal(family, signal.SIGSTOP)
    time.sleep(LEASE_S * rng.uniform(1.2, 2.5))
    return _signal(rng.sample(family, len(family)), signal.SIGCONT)


def refused(services: Services, pid: int, rng: random.Random) -> bool:
    """Close the connections of a worker to the database and refuse new ones."""
    return _cut_off(services, pid, rng, Cut.CLOSED)


def unreachable(services: Services, pid: int, rng: random.Random) -> bool:
    """Let nothing through between a worker and the database; what was sent arrives when the link is mended."""
    return _cut_off(services, pid, rng, Cut.SILENT)


def scheduler_killed(services: Services, _pid: int, rng: random.Random) -> bool:
    """Kill the process that hands out the work, and start it again."""
    services.end_scheduler(signal.SIGKILL)
    time.sleep(rng.uniform(0.0, LEASE_S))
    services.start_scheduler()
    return True


def dask_scheduler_killed(services: Services, _pid: int, rng: random.Random) -> bool:
    """Kill the scheduler of Dask, and start it again."""
    assert services.cluster is not None
    services.cluster.kill("scheduler")
    time.sleep(rng.uniform(0.0, 2.0 * LEASE_S))
    services.cluster.start_scheduler()
    return True


HERE: Sequence[Strike] = (killed, stood_still, all_stood_still, scheduler_killed)
"""On one machine, whatever the database."""
ON_SERVER: Sequence[Strike] = (*HERE, refused, unreachable)
"""With a database that a worker can be cut off from."""
ON_DASK: Sequence[Strike] = (killed, stood_still, refused, unreachable, scheduler_killed, dask_scheduler_killed)


def _strike(strike: Strike, services: Services, rng: random.Random) -> bool:
    """Strike after a drawn delay where somebody is at work; return whether somebody was harmed."""
    at_work = services.at_work()
    if not at_work:
        return False
    time.sleep(rng.uniform(0.0, LONGEST_DELAY_S))
    return strike(services, rng.choice(at_work), rng)


def _cut_off(services: Services, pid: int, rng: random.Random, how: Cut) -> bool:
    assert services.link is not None
    had = services.link.cut_off(pid, how)
    time.sleep(rng.uniform(0.5, 3.0 * LEASE_S))
    services.link.restore(pid)
    return had > 0


def _signal(pids: Sequence[int], number: signal.Signals) -> bool:
    for pid in pids:
        with suppress(ProcessLookupError):  # it has ended by itself, or was replaced
            os.kill(pid, number)
    return True


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

    ``size`` is the number of faults, of all kinds of workers together.
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
    deployed = half.fleet.load.copy(folder)
    undisturbed = half.fleet.undisturbed
    with closing(open_store(deployed)) as storage:
        with services(storage, deployed, folder, dask=half.dask) as running:
            for recording in half.fleet.load.recordings:
                receive(Recorded((recording,), recording[1]), deployed)
                if order and _strike(order[-1], running, rng):
                    tally.faults[order.pop().__name__] += 1
            begin_s = time.monotonic()
            while compared_state(storage) != undisturbed and time.monotonic() - begin_s < AT_REST_S:
                _try_again(storage, tally)
                time.sleep(LOOK_S)
            tally.rest_s.append(time.monotonic() - begin_s)
            running.end_scheduler(signal.SIGTERM)
            tally.leaked += running.said().count(PASSWORD)
        _, rest = come_to_rest(storage, job_context(deployed, storage))
        tally.wrong += [] if rest else ["no rest"]
        state = compared_state(storage)
        tally.states.add(tuple(sorted(state.items())))
        tally.wrong += [name for name in state if state[name] != undisturbed[name]]
        tally.wrong += damaged(deployed, storage)
        tally.twice += stored_twice(storage)
    shutil.rmtree(folder)


def _try_again(storage: SqlStorage, tally: _Tally) -> None:
    """Let what was set aside be tried again, as whoever looks at the quarantine does."""
    with storage.write() as unit:
        tally.set_aside += sum(one.due_ns > one.last_ns for one in unit.quarantine.retry())

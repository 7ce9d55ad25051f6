"""A fleet for many workers: recordings, deployments that count every table that is stored, the state at rest."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from sqlalchemy import text

from api.comparison.trial import opened, receive
from api.factory import open_store
from bench.chaos.final_state import OF_HISTORY, final_state
from bench.chaos.small_deployment import PASSWORD
from bench.counting import run
from bench.small_fleets import FOUR_AXLES, Workload, cars, deployed, small_fleet
from estimation.errors import TreadwatchError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import JobContext
from fleet_db.storage import SqlStorage

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
MOST_RUNS = 8
"""Runs of all jobs after which they must have come to rest."""


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
        folder, "W", cars(vehicles, wear=0.8), FOUR_AXLES, 2.0, campaigns=campaigns, surveyed=False, seed=11,
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
        come_to_rest(storage, context)
        return WorkerFleet(load, compared_state(storage))


def compared_state(storage: SqlStorage) -> Mapping[str, str]:
    """Return digests of what does not depend on the history."""
    return {name: digest for name, digest in final_state(storage).items() if name not in OF_HISTORY}


def stored_twice(storage: SqlStorage) -> int:
    """Return how many tables of windows were stored although the same one had been."""
    with storage.read() as unit:
        return int(unit.connection.execute(text(DOUBLED)).scalar_one())


def come_to_rest(storage: SqlStorage, context: JobContext) -> None:
    """Run the jobs here until nothing changes any more."""
    for _ in range(MOST_RUNS):
        before = compared_state(storage)
        for job in ALL_JOBS:
            run(job, context)
        if compared_state(storage) == before:
            return
    raise TreadwatchError("the jobs do not come to rest")

"""A fleet for many workers: recordings, deployments that count every table that is stored, the state at rest."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import psycopg
import sqlalchemy
from psycopg import sql
from sqlalchemy import text

from api.comparison.trial import Recorded, copied, deploy, opened, receive, record, register
from api.factory import open_store
from api.settings import Settings
from bench.chaos.final_state import OF_HISTORY, final_state
from bench.chaos.small_deployment import PASSWORD
from estimation.errors import TreadwatchError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import JobContext, run_job
from estimation.values.runs import JobTrigger
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
from ingest.simulator.scenario_file import read_scenario

WINDOW_S = 10.0
FLEET = """\
name = "WORKERS"
description = "vehicles of four wheelsets on a section that nobody has surveyed"
seed = 11
[fleet]
code = "W"
name = "Fleet W"
[section]
code = "W-1"
number = 1
name = "Section W-1"
length_m = 2700.0
surveyed = false
[speed]
lowest_m_s = 14.0
highest_m_s = 22.0
[sensors]
kind = "mems"
[bus]
recorder_clock_offset_s = 1.5
[position]
largest_offset_m = 3.0
largest_scale_percent = 0.1
[sessions]
start = 2024-01-08T05:30:00Z
campaigns = {campaigns}
minutes_each = 2.0
first_odometer_km = 1000.0
km_between = 20000.0
km_per_day = 500.0
"""
VEHICLE = """\
[[vehicles]]
code = "W-{vehicle}"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [2.0, 4.5, 14.0, 16.5]
"""
WHEELSET = """\
[[vehicles.wheelsets]]
serial = "W-{vehicle}{axle}"
initial_wear_mm = {worn}
wear_mm_per_100000_km = 0.8
"""
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
    """Recordings by time, a deployment that has received none of them, and what they come to undisturbed.

    ``server`` is the URL of a PostgreSQL server on which the database ``empty`` is copied; None for SQLite.
    """

    recordings: Sequence[tuple[str, Path]]
    empty: Settings
    server: str | None
    undisturbed: Mapping[str, str]

    def copy(self, folder: Path) -> Settings:
        """Return a deployment of its own, in a new folder."""
        settings = copied(self.empty, folder)
        if self.server is None:
            return settings.model_copy(update={"database_url": None})
        name = f"d{uuid.uuid4().hex[:12]}"
        with psycopg.connect(self.server, autocommit=True) as connection:
            connection.execute(sql.SQL("CREATE DATABASE {} TEMPLATE empty").format(sql.Identifier(name)))
        return settings.model_copy(update={"database_url": _database(self.server, name)})


def worker_fleet(folder: Path, vehicles: int, campaigns: int, server: str | None = None) -> WorkerFleet:
    """Return the fleet, with what one process makes of its recordings when nobody disturbs it.

    Args:
        vehicles, campaigns: How many vehicles of four wheelsets, and journeys of each.
        server: URL of a PostgreSQL server; None for SQLite.
    """
    parts = [FLEET.format(campaigns=campaigns)]
    for number, vehicle in enumerate("ABCDEF"[:vehicles]):
        parts.append(VEHICLE.format(vehicle=vehicle))
        parts += [WHEELSET.format(vehicle=vehicle, axle=i, worn=round(0.2 * i + 0.1 * number, 2)) for i in range(1, 5)]
    file = folder / "scenario.toml"
    file.write_text("".join(parts), encoding="utf-8")
    scenario = read_scenario(file)
    recorded = record(scenario, folder / "recordings", workers=1)
    home = folder / ("sqlite" if server is None else "postgresql")
    empty = deploy(scenario, home).model_copy(update={"window_length_s": WINDOW_S})
    if server is not None:
        with psycopg.connect(server, autocommit=True) as connection:
            connection.execute("CREATE DATABASE empty")
        empty = empty.model_copy(update={"database_url": _database(server, "empty")})
        upgrade(empty.url)
        register(scenario, empty, home / "registered")
    with closing(open_store(empty)) as storage, storage.write() as unit:
        unit.connection.execute(text(f"CREATE TABLE {STORED} (what TEXT NOT NULL)"))
        for statement in COUNTED[unit.connection.dialect.name]:
            unit.connection.execute(text(statement))
    fleet = WorkerFleet(recorded.recordings, empty, server, {})
    alone = fleet.copy(home / "undisturbed")
    receive(Recorded(tuple(fleet.recordings), recorded.truth), alone)
    with opened(alone) as (storage, context):
        come_to_rest(storage, context)
        return replace(fleet, undisturbed=compared_state(storage))


def compared_state(storage: SqlStorage) -> Mapping[str, str]:
    """Return digests of what does not depend on the history."""
    return {name: digest for name, digest in final_state(storage).items() if name not in OF_HISTORY}


def stored_twice(storage: SqlStorage) -> int:
    """Return how many tables of windows were stored although the same one had been."""
    with storage.read() as unit:
        return int(unit.connection.execute(text(DOUBLED)).scalar_one())


def come_to_rest(storage: SqlStorage, context: JobContext) -> None:
    """Run the jobs here until nothing changes any more.

    Raises:
        TreadwatchError: A job failed, or they do not come to rest.
    """
    for _ in range(MOST_RUNS):
        before = compared_state(storage)
        for job in ALL_JOBS:
            done = run_job(job, context, JobTrigger.CLI)
            if done.error is not None:
                raise TreadwatchError(f"job {job.name} failed: {done.error}")
        if compared_state(storage) == before:
            return
    raise TreadwatchError("the jobs do not come to rest")


def _database(server: str, name: str) -> str:
    """Return the URL of a database of a server, with a password, which must be in no log."""
    parsed = sqlalchemy.make_url(server).set(drivername="postgresql", database=name, password=PASSWORD)
    return parsed.render_as_string(hide_password=False)

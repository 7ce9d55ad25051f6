"""Recordings of a few vehicles for workers to estimate, and a deployment that has received the first of them."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import psycopg
import sqlalchemy
from psycopg import sql

from api.comparison.trial import copied, deploy, receive, record, register
from api.settings import Settings
from fleet_db.migrate import upgrade
from ingest.simulator.scenario_file import read_scenario

LARGEST_SPEED = 22.0  # m/s
FLEET = """\
name = "WORKERS"
description = "vehicles of four wheelsets on one section"
seed = 3
[fleet]
code = "K"
name = "Fleet K"
[section]
code = "K-1"
number = 1
name = "Section K-1"
length_m = {length}
surveyed = {surveyed}
[speed]
lowest_m_s = 14.0
highest_m_s = {speed}
[sensors]
kind = "mems"
[bus]
recorder_clock_offset_s = 1.5
[sessions]
start = 2024-01-08T05:30:00Z
campaigns = {campaigns}
minutes_each = {minutes}
first_odometer_km = 1000.0
km_between = 300.0
km_per_day = 500.0
"""
VEHICLE = """\
[[vehicles]]
code = "K-{vehicle}"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [2.0, 4.5, 14.0, 16.5]
"""
WHEELSET = """\
[[vehicles.wheelsets]]
serial = "K-{vehicle}{axle}"
initial_wear_mm = {worn}
"""


@dataclass(frozen=True, slots=True)
class Workload:
    """A deployment that has received little, and the recordings that it is to get while workers are there.

    ``received`` is copied for each measurement; its database is one of ``server`` where there is one.
    """

    received: Settings
    recordings: Sequence[tuple[str, Path]]
    server: str | None = None

    def copy(self, folder: Path) -> Settings:
        """Return a deployment of its own, in an empty folder."""
        settings = copied(self.received, folder)
        if self.server is None:
            return settings
        name = f"d{uuid.uuid4().hex[:12]}"
        with psycopg.connect(self.server, autocommit=True) as connection:
            connection.execute(sql.SQL("CREATE DATABASE {} TEMPLATE received").format(sql.Identifier(name)))
        return settings.model_copy(update={"database_url": _database(self.server, name)})


def fleet(vehicles: int, minutes: float, *, campaigns: int = 2, surveyed: bool = True) -> str:
    """Return the scenario of vehicles of four wheelsets on one section.

    Args:
        vehicles, minutes, campaigns: How many, how long a journey takes, and how many journeys each makes.
    """
    length, known = LARGEST_SPEED * 60.0 * minutes + 100.0, str(surveyed).lower()
    parts = [FLEET.format(minutes=minutes, speed=LARGEST_SPEED, length=length, campaigns=campaigns, surveyed=known)]
    for vehicle in range(1, vehicles + 1):
        parts.append(VEHICLE.format(vehicle=vehicle))
        parts += [WHEELSET.format(vehicle=vehicle, axle=axle, worn=0.2 * axle) for axle in range(1, 5)]
    return "".join(parts)


def workload(
    folder: Path, vehicles: int, minutes: float, server: str | None = None, *, surveyed: bool = True
) -> Workload:
    """Return two journeys of each of some vehicles of four wheelsets, of which the first is received already.

    Args:
        server: URL of a PostgreSQL server; None for SQLite.
    """
    file = folder / "scenario.toml"
    file.write_text(fleet(vehicles, minutes, surveyed=surveyed), encoding="utf-8")
    scenario = read_scenario(file)
    recorded = record(scenario, folder / "recordings", workers=2)
    settings = deploy(scenario, folder / "deployed")
    if server is not None:
        with psycopg.connect(server, autocommit=True) as connection:
            connection.execute("CREATE DATABASE received")
        settings = settings.model_copy(update={"database_url": _database(server, "received")})
        upgrade(settings.url)
        register(scenario, settings, folder / "registered")
    receive(replace(recorded, recordings=recorded.recordings[:1]), settings)
    return Workload(settings, recorded.recordings[1:], server)


def _database(server: str, name: str) -> str:
    """Return the URL of a database of a server."""
    return sqlalchemy.make_url(server).set(drivername="postgresql", database=name).render_as_string()

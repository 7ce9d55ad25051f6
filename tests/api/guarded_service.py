"""A small service that asks for keys, in a folder of its own, for tests of access."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import api_fleet
import httpx
from running_service import running

from api.access.keys import Wanted, make_key
from api.factory import open_store
from api.settings import Settings
from estimation.values.registry import FleetRecord, WheelsetRecord
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage

EVERYTHING = frozenset({"read", "act", "ingest", "admin"})


@dataclass(frozen=True)
class Guarded:
    """The service, its storage, and how to make keys."""

    client: httpx.Client
    storage: SqlStorage

    def key(self, owner: str = "planner", *, without: str = "", fleet: str | None = None) -> dict[str, str]:
        """Return the headers of a new key."""
        fleets = None if fleet is None else frozenset({fleet})
        with self.storage.write() as unit:
            _, token = make_key(unit, Wanted(owner, EVERYTHING - {without}, fleets, None), "a test", time.time_ns())
        return {"Authorization": f"Bearer {token}"}

    def alert(self) -> str:
        """Return the path of a new alert of fleet ``alpha``."""
        return f"/v1/alerts/{api_fleet.raised(self.storage, 'WS-A').alert_id}"


def settings_in(folder: Path, **changed: object) -> Settings:
    """Return the settings of a service that asks for keys."""
    given: dict[str, object] = {"data_dir": folder, "database_url": None, "port": 0, "log_level": "error"}
    return Settings(**{**given, "access": "keys", "_env_file": None, **changed})  # type: ignore[arg-type]


@contextmanager
def guarded_service(folder: Path, **changed: object) -> Iterator[Guarded]:
    """Yield a service with two fleets of one wheelset."""
    settings = settings_in(folder, **changed)
    upgrade(settings.url)
    storage = open_store(settings)
    with storage.write() as unit:
        for fleet, serial in (("alpha", "WS-A"), ("beta", "WS-B")):
            unit.registry.add_fleet(FleetRecord(fleet, fleet))
            unit.registry.add_wheelset(WheelsetRecord(serial, fleet, "P8", 0.46, None))
    with running(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
        yield Guarded(client, storage)
    storage.close()

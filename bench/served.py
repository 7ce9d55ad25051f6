"""A service over a database of its own, and a key that may everything."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from api.access.keys import EVERYTHING, Wanted, make_key
from api.factory import open_store
from api.settings import Settings
from bench.large_fleet import FleetSize, populate
from bench.report import say
from bench.services import START_S, answers, environment_of, free_port, new_database, started_program, until
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage

WORKERS, SEED = 2, 2010
GENEROUS = {
    "log_level": "warning",
    "requests_per_s": 1e6,
    "requests_burst": 1_000_000,
    "streams_per_key": 1000,
    "failed_keys_per_minute": 6e4,
    "docs": "open",
}


def new_key(storage: SqlStorage) -> str:
    """Make a key that may everything, and return the header line that carries it."""
    wanted = Wanted(owner="bench", scopes=EVERYTHING, fleets=None, expires_ns=None)
    with storage.write() as unit:
        _, token = make_key(unit, wanted, "bench", time.time_ns())
    return f"Authorization: Bearer {token}"


@contextmanager
def served(folder: Path, database_url: str | None, workers: int = WORKERS) -> Iterator[str]:
    """Yield the URL of a running service over a migrated database; None for SQLite in the folder."""
    port = free_port()
    settings = Settings.model_validate({"data_dir": folder, "database_url": database_url, **GENEROUS})
    command = ["-m", "uvicorn", "--factory", "api.asgi:app", "--port", str(port), "--workers", str(workers)]
    command += ["--no-access-log", "--log-level", "warning"]
    environment = environment_of(settings) | {"TREADWATCH_ACCESS": "keys"}  # also where it is open for the bench itself
    process = started_program(command, environment, folder / "service.log")
    url = f"http://127.0.0.1:{port}"
    try:
        if until(lambda: answers(f"{url}/readyz") or process.poll() is not None, START_S) is None or process.poll():
            raise RuntimeError((folder / "service.log").read_text())
        yield url
    finally:
        process.terminate()
        process.wait(30)


@contextmanager
def filled_database(kind: str, size: FleetSize | None = None) -> Iterator[tuple[Path, str | None, str]]:
    """Yield folder and URL of a migrated database, with a large fleet where its size is given, and a key."""
    with new_database(kind) as (folder, url):
        settings = Settings(data_dir=folder, database_url=url, _env_file=None)
        upgrade(settings.url)
        with closing(open_store(settings)) as storage:
            if size is not None:
                took = populate(storage, size, SEED, time.time_ns())
                say(f"{kind}: {size.wheelsets} wheelsets, {size.days} days, filled in {took:.0f} s")
            key = new_key(storage)
        yield folder, url, key

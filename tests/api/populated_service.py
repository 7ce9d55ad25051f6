"""A service over a fleet of its own, for tests that change the registry or count everything that is there."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import httpx
import populated_fleet
import psycopg
import sqlalchemy
from running_service import Service, running

from api.factory import open_store
from api.settings import Settings
from fleet_db.migrate import upgrade


@contextmanager
def populated_service(kind: str, folder: Path, postgres_server_url: str) -> Iterator[Service]:
    """Yield a service over a populated database that nothing else uses.

    Args:
        kind: ``sqlite`` or ``postgresql``.
    """
    with new_database(postgres_server_url) if kind == "postgresql" else nullcontext() as url:
        settings = Settings(data_dir=folder, database_url=url, port=0, log_level="warning", _env_file=None)
        upgrade(settings.url)
        storage = open_store(settings)
        populated_fleet.populate(storage)
        with running(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
            yield Service(address, client, storage)
        storage.close()


@contextmanager
def new_database(server_url: str) -> Iterator[str]:
    """Yield the URL of an empty database that nothing else uses."""
    name = f"api_{uuid.uuid4().hex}"
    with psycopg.connect(server_url, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
        yield sqlalchemy.make_url(server_url).set(database=name).render_as_string(hide_password=False)
        connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')

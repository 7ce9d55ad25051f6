"""The real service for the API's tests: a server on a port, over SQLite and over PostgreSQL."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from pathlib import Path

import api_fleet
import httpx
import psycopg
import pytest
import sqlalchemy
from running_service import Service, running

from api.factory import open_store
from api.settings import Settings
from fleet_db.migrate import upgrade


@pytest.fixture(scope="session")
def api_postgres_url(postgres_server_url: str) -> Iterator[str]:
    """Yield a migrated database that all tests of the API share."""
    name = f"api_{uuid.uuid4().hex}"
    with psycopg.connect(postgres_server_url, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
        url = sqlalchemy.make_url(postgres_server_url).set(database=name).render_as_string(hide_password=False)
        upgrade(url)
        yield url
        connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


@pytest.fixture(scope="session", params=["sqlite", "postgresql"])
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """Yield the service over a populated database; tests that change something bring alerts of their own."""
    data_dir: Path = tmp_path_factory.mktemp("data")
    url = None
    if request.param == "postgresql":
        url = request.getfixturevalue("api_postgres_url")
    settings = Settings(data_dir=data_dir, database_url=url, port=0, log_level="warning", _env_file=None)
    upgrade(settings.url)
    storage = open_store(settings)
    api_fleet.populate(storage)
    with running(settings) as address, httpx.Client(base_url=address, timeout=30.0) as client:
        yield Service(address, client, storage)
    storage.close()


@pytest.fixture
def client(service: Service) -> httpx.Client:
    """Return the client alone."""
    return service.client

"""The real service for the API's tests: a server on a port, over SQLite and over PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from one_database import in_turn
from populated_service import populated_service
from running_service import Service
from webhook_deployment import Deployment, of_two_fleets
from webhook_receiver import Receiver, receiving

from fleet_db.storage import SqlStorage


@pytest.fixture(scope="session", params=in_turn)
def service(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, postgres_server_url: str
) -> Iterator[Service]:
    """Yield the service over a populated database; tests that change something bring alerts of their own."""
    with populated_service(request.param, tmp_path_factory.mktemp("data"), postgres_server_url) as found:
        yield found


@pytest.fixture
def client(service: Service) -> httpx.Client:
    """Return the client alone."""
    return service.client


@pytest.fixture
def deployment(storage: SqlStorage) -> Deployment:
    """Return a deployment, once on each database."""
    return of_two_fleets(storage)


@pytest.fixture
def embedded(sqlite_storage: SqlStorage) -> Deployment:
    """Return one for what does not depend on the database."""
    return of_two_fleets(sqlite_storage)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as found:
        yield found

"""Fixtures of the tests of registry files and topics."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from kafka_cluster import MockCluster, mock_cluster
from scenario_text import SMALL
from vehicle_bus import register

from fleet_db.storage import SqlStorage
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import read_scenario
from ingest.topic import consuming


@pytest.fixture
def cluster() -> Iterator[MockCluster]:
    with mock_cluster() as found:
        yield found


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a consumer look at what else waits, and try again, all the time."""
    monkeypatch.setattr(consuming, "LOOK_EVERY_S", 0.1)
    monkeypatch.setattr(consuming, "FIRST_DELAY_S", 0.02)


@pytest.fixture
def registered(storage: SqlStorage) -> SqlStorage:
    with storage.write() as unit:
        register(unit)
    return storage


@pytest.fixture
def registry(tmp_path: Path) -> Path:
    """Return the registry file of a simulated fleet."""
    (tmp_path / "small.toml").write_text(SMALL)
    return prepare(read_scenario(tmp_path / "small.toml"), tmp_path / "out")

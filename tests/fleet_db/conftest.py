"""Storages that already know a fleet."""

from __future__ import annotations

import pytest
import stored_values as make

from fleet_db.storage import SqlStorage


@pytest.fixture
def fleet(storage: SqlStorage) -> SqlStorage:
    """Return a storage with two vehicles and three wheelsets, once on each database."""
    make.populate(storage)
    return storage

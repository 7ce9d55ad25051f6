"""Scenarios of tables that are made or changed, as their files have them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ingest.file_value import read_value
from ingest.input_file import InputFile
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import ScenarioTable

Tables = Mapping[str, Any]


def scenario_of(tables: Tables, path: Path = Path("made.toml")) -> Scenario:
    """Return the scenario that a file with these tables would have."""
    return read_value(InputFile(path, tables), ScenarioTable).scenario()


def changed_scenario(path: Path, changes: Tables) -> Scenario:
    """Return the scenario of a file some of whose keys are others, those of its tables key by key."""
    tables: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    for name, change in changes.items():
        tables[name] = {**tables.get(name, {}), **change} if isinstance(change, Mapping) else change
    return scenario_of(tables, path)

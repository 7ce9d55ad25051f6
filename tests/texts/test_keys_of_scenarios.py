"""The documents name every key, and give an example that works."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.file_value import table_of
from ingest.registry_file import RegistryObject
from ingest.simulator.scenario_file import ScenarioTable

DOCS = Path(__file__).parents[2] / "docs"


def keys_of(model: type[BaseModel]) -> set[str]:
    """Return every key of a schema and of the tables within."""
    keys: set[str] = set()
    for name, item in model.model_fields.items():
        keys.add(item.alias or name)
        if (inner := model_in(item.annotation)) is not None:
            keys |= keys_of(inner)
    return keys


def model_in(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for item in get_args(annotation) if (found := model_in(item))), None)


def undocumented(keys: set[str], documents: tuple[str, ...]) -> set[str]:
    assert len(keys) > 20
    text = "".join((DOCS / document).read_text() for document in documents)
    return {key for key in keys if not re.search(rf"[`.\[\"*]{key}[`\].\"*]", text)}


@pytest.mark.parametrize(
    ("schema", "documents"),
    [
        (
            table_of(ScenarioTable),
            ("scenarios.md", "scenario-section.md", "scenario-fleet.md", "scenario-running.md", "scenario-sensors.md"),
        ),
        (table_of(RegistryObject), ("registry.md", "registry-changes.md")),
    ],
)
def test_every_key_of_a_schema_is_documented(schema: type[BaseModel], documents: tuple[str, ...]) -> None:
    assert undocumented(keys_of(schema), documents) == set()


def test_parameters_of_the_dynamics_are_documented() -> None:

    text = (DOCS / "scenario-fleet.md").read_text()
    assert [item.name for item in fields(VehicleParameters) if f"`{item.name}`" not in text] == []

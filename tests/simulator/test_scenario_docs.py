"""The documents name every key, and give an example that works."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from estimation.vehicle.equations_of_motion import VehicleParameters

DOCS = Path(__file__).parents[2] / "docs"
INGEST = Path(__file__).parents[2] / "ingest"


@pytest.mark.parametrize(
    ("source", "document"),
    [
        ("simulator/scenario_file.py", "scenarios.md"),
        ("simulator/section_file.py", "compare.md"),
        ("registry_file.py", "registry.md"),
    ],
)
def test_every_key_is_documented(source: str, document: str) -> None:
    asked = r"\.(?:text|integer|number|flag|numbers|moment_ns|optional_moment_ns|table|tables|objects|optional_object)"
    keys = set(re.findall(asked + r'\(\s*"(\w+)"', (INGEST / source).read_text()))
    assert len(keys) > 20
    text = (DOCS / document).read_text()
    assert {key for key in keys if not re.search(rf"[`.\[\"*]{key}[`\].\"*]", text)} == set()


def test_parameters_of_the_dynamics_are_documented() -> None:

    text = (DOCS / "scenarios.md").read_text()
    assert [item.name for item in fields(VehicleParameters) if f"`{item.name}`" not in text] == []

"""The numbers of a tiny fleet, from frames to REST, are those of the stored reference: a refactoring changes none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench.digests import brief, differences, run

REFERENCE = Path(__file__).with_name("digests_tiny.json")
RELATIVE = {"geometry": 5e-6, "trend": 1e-6, "alerts": 1e-6, "windows": 1e-9, "tracks": 5e-4}
"""Without AVX2 and FMA geometry differs by up to 3e-7 and positions by 9e-5 of an offset of 48 mm; where the same
machine has run both commits, ``bench/digests.py --against`` compares every bit."""


@pytest.fixture(scope="module")
def tiny() -> object:
    return brief(run("tiny"))


@pytest.mark.parametrize("group", sorted(RELATIVE))
def test_the_numbers_are_those_of_the_reference(tiny: dict[str, object], group: str) -> None:
    reference = json.loads(REFERENCE.read_text(encoding="utf-8"))["tiny"]
    assert list(differences(reference[group], tiny[group], relative=RELATIVE[group])) == []


def test_a_changed_number_a_lost_key_and_a_changed_state_are_reported_with_their_path() -> None:
    expected = {"a": [1.0, 2.0], "b": "estimated", "c": 3}
    assert list(differences(expected, expected)) == []
    assert list(differences(expected, {"a": [1.0, 2.0 + 1e-8], "b": "estimated", "c": 3}, relative=1e-7)) == []
    found = list(differences(expected, {"a": [1.0, 2.002], "b": "refused"}, relative=1e-7))
    assert [line.partition(":")[0] for line in found] == ["/a/1", "/b", "/c"]
    assert "relative difference 1.0e-03" in found[0]
